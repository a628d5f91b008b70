# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator that marks the reconstructed object as an asset, with a relit preview image."""

# pyright: reportInvalidTypeForm=false

import hashlib
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ..core.assets.options import LEVELS
from ..core.errors import InputError, IrgsppError
from ..core.scene.camera import Camera, look_at
from ..core.scene.camera_files import load_run_cameras
from ..core.scene.similarity import moved_points
from ..irgspp_addon import shared_properties as shared
from ..irgspp_addon.importer.asset_collection import asset_collection, marked_asset, replace_hulls, replace_levels
from ..irgspp_addon.importer.asset_mark import AssetDetails, check_local, details_of, mark_asset, missing_images, set_preview
from ..irgspp_addon.importer.mesh_origin import mesh_to_run
from ..irgspp_addon.importer.run_frame import albedo_scale, frame_of, run_object
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.jobs.result_import import place_of, started_from
from ..irgspp_addon.relight.session import RelightRequest, session_of
from ..irgspp_addon.translations import translated
from ..irgspp_addon.user_folder import user_folder
from ..irgspp_addon.windows import redraw
from .blocking import RUN, SKIP, refuse, refusing, run_to_end
from .result import named_run

PREVIEW = 256  # side of the preview image in pixels
AWAY = 4.0  # distance of its camera in radii of the object
FILLED = 0.92  # fraction of the image's side that the object fills


class IRGSPP_OT_mark_asset(bpy.types.Operator):
    """Mark the object, or its collection, as an asset of the Asset Browser with preview image, author, licence, tags and catalogue."""

    bl_idname = "irgspp.mark_asset"
    bl_label = "Mark as Asset"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    run: StringProperty(**RUN)
    kind: EnumProperty(**shared.ASSET_KIND)
    lods: BoolProperty(**shared.LODS)
    collision: BoolProperty(**shared.COLLISION)
    author: StringProperty(name="Author", description="Who made the object")
    licence: StringProperty(name="Licence", description="Licence under which the object may be used, such as CC-BY 4.0")
    description: StringProperty(name="Description", description="What the object is", options=SKIP)
    tags: StringProperty(name="Tags", description="Words to search by, separated by commas", default="reconstruction")
    catalogue: StringProperty(
        name="Catalogue",
        description="Path of its catalogue in the asset library, such as Reconstructions/Toys. Empty: none",
        default="Reconstructions",
    )
    picture: StringProperty(
        name="Preview", description="Image file for the preview. Empty: the relit object", subtype="FILE_PATH", options=SKIP
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the details.

        Args:
            context: of the button.
            event: ignored.
        """
        if bpy.app.background:
            return self.execute(context)
        try:
            self.take_details(run_object(context.scene, named_run(context, self.run)))
        except IrgsppError as error:
            return refuse(self, error)
        return context.window_manager.invoke_props_dialog(self, width=400, confirm_text=self.bl_label)

    def take_details(self, thing: bpy.types.Object | None) -> None:
        """Begin with the details of an object that is an asset already; without a saved file there is no catalogue."""
        marked = marked_asset(thing) if thing is not None else None
        if marked is not None:
            self.kind = "OBJECT" if marked == thing else "COLLECTION"
        known = details_of(marked) if marked is not None else None
        if known is not None:
            self.author, self.licence, self.description = known.author, known.licence, known.description
            self.tags, self.catalogue = ", ".join(known.tags), known.catalogue
        if not bpy.data.filepath:
            self.catalogue = ""

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the details that the dialog asks for."""
        self.layout.use_property_split, self.layout.use_property_decorate = True, False
        self.layout.prop(self, "kind")
        if self.kind == "COLLECTION":
            self.layout.prop(self, "lods")
            self.layout.prop(self, "collision")
        for name in ("author", "licence", "description", "tags", "catalogue", "picture"):
            self.layout.prop(self, name)

    @refusing(RuntimeError)  # the latter is Blender's, for a file that is no image
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Mark the object or its collection; hulls come from a job of the engine."""
        run = named_run(context, self.run)
        thing = run_object(context.scene, run)
        if thing is None:
            raise InputError(run.name, "its object is not in this scene", "import the run")
        check_local(thing)
        words = tuple(dict.fromkeys(word.strip() for word in self.tags.split(",") if word.strip()))
        details = AssetDetails(self.author, self.licence, self.description, words, self.catalogue.strip())
        context.view_layer.update()
        block = thing if self.kind == "OBJECT" else asset_collection(thing)
        mark_asset(block, details)
        if (before := marked_asset(thing, other_than=block)) is not None:
            before.asset_clear()
        if missing := missing_images(thing):
            self.report(
                {"WARNING"},
                translated("{names}: not packed, and their files are missing: others will not find them", names=", ".join(missing)),
            )
        self._preview(block, thing, run)
        redraw("VIEW_3D", "FILE_BROWSER")  # the panel, and Asset Browsers
        return self._add_parts(context, thing, run) if self.kind == "COLLECTION" else {"FINISHED"}

    def _add_parts(self, context: bpy.types.Context, thing: bpy.types.Object, run: Path) -> set[str]:
        """Give the collection its levels at once, and start the job that makes its hulls."""
        replace_levels(thing, LEVELS if self.lods else ())
        replace_hulls(thing, None)
        if not self.collision:
            return {"FINISHED"}
        file = user_folder("hulls") / f"{hashlib.sha1(str(run).encode(), usedforsecurity=False).hexdigest()[:12]}.blend"
        data = {**place_of(context.scene), "run": str(run), "hulls": str(file)}
        words, wait = ["export", str(run), "-o", str(file), "--collision"], bpy.app.background
        job = jobs.start("export", translated("Hulls of {name}", name=run.name), run, words, None if wait else "add_hulls", data)
        ended = run_to_end(self, job) if wait else {"FINISHED"}
        if wait and ended == {"FINISHED"}:
            add_hulls(job)
        return ended

    def _preview(self, block: bpy.types.Object | bpy.types.Collection, thing: bpy.types.Object, run: Path) -> None:
        """Give the asset its preview image; without an engine, the one that Blender renders."""
        if self.picture:
            path = Path(bpy.path.abspath(self.picture))
            if not path.is_file():
                raise InputError(path, "no such file", "choose an image for the preview")
            with bpy.context.temp_override(id=block):
                bpy.ops.ed.lib_id_load_custom_preview(filepath=str(path))
            return
        try:
            set_preview(block, relit_preview(thing, run))
        except IrgsppError as error:
            self.report({"WARNING"}, translated("The preview is Blender's own: {error}", error=error))
            if not bpy.app.background:  # where Blender could crash without a graphics card
                block.asset_generate_preview()


def add_hulls(job: Job) -> None:
    """Add the hulls that a job has written to the asset that it was started for.

    Args:
        job: finished job.

    Raises:
        IrgsppError: if another file has been opened since, or the object or the hulls are gone.
    """
    with started_from(job, "mark the asset again") as scene:
        thing = run_object(scene, Path(job.data["run"]))
        if thing is None:
            raise InputError(job.title, "the object is not in the scene any more", "import the run and mark it again")
        replace_hulls(thing, Path(job.data["hulls"]))
    Path(job.data["hulls"]).unlink(missing_ok=True)
    redraw("VIEW_3D")


def relit_preview(thing: bpy.types.Object, run: Path) -> np.ndarray:
    """Return an image of the object under its recovered light, (PREVIEW, PREVIEW, 4) linear premultiplied.

    Args:
        thing: object of the run.
        run: run folder.

    Raises:
        IrgsppError: if there is no engine or it fails.
    """
    camera = preview_camera(thing, run)
    request = RelightRequest(camera, None, albedo_scale=albedo_scale(thing), progressive=False)
    return session_of(run).wait("asset", request)


def preview_camera(thing: bpy.types.Object, run: Path) -> Camera:
    """Return a camera, in the run's frame, from which the first photograph's side of the object fills a square image.

    Args:
        thing: object of the run.
        run: run folder.

    Raises:
        InputError: if the object has no vertices.
    """
    vertices = np.empty(3 * len(thing.data.vertices), np.float32)
    thing.data.vertices.foreach_get("co", vertices)
    points = moved_points(vertices.reshape(-1, 3).astype(float), np.array(mesh_to_run(thing), float))
    if not len(points):
        raise InputError(thing.name, "has no vertices", "import the run again")
    centre = (points.min(0) + points.max(0)) / 2
    cameras = load_run_cameras(run / "cameras.json")
    towards = cameras[0].camera.centre - centre if cameras else np.array([0.6, -0.7, 0.4])
    eye = centre + AWAY * float(np.linalg.norm(points - centre, axis=1).max()) * towards / np.linalg.norm(towards)
    to_world = look_at(eye, centre, frame_of(thing).rotation.T @ np.array([0.0, 0.0, 1.0]))
    pixels, _ = Camera(PREVIEW, PREVIEW, 1.0, 1.0, 0.0, 0.0, to_world).project(points)
    low, high = pixels.min(0), pixels.max(0)
    focal = FILLED * PREVIEW / max(float((high - low).max()), 1e-9)
    x, y = PREVIEW / 2 - focal * (low + high) / 2
    return Camera(PREVIEW, PREVIEW, focal, focal, float(x), float(y), to_world)


CLASSES = (IRGSPP_OT_mark_asset,)


def register() -> None:
    """Register the function that a finished job calls."""
    jobs.ON_DONE["add_hulls"] = add_hulls


def unregister() -> None:
    """Unregister it."""
    jobs.ON_DONE.pop("add_hulls", None)
