# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that relight a run: preview that follows the scene, World as environment map, views as image files."""

# pyright: reportInvalidTypeForm=false

import json
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..core.errors import InputError
from ..core.run_folder import read_run
from ..core.scene.lamps import Lamp, lamp_records
from ..irgspp_addon import shared_properties as shared
from ..irgspp_addon.importer.run_frame import chosen_run, frame_of, run_object
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.properties import RELATIVE
from ..irgspp_addon.relight import preview
from ..irgspp_addon.relight.left_out import seen_objects
from ..irgspp_addon.relight.live_image import Follower
from ..irgspp_addon.relight.session import session_of
from ..irgspp_addon.translations import translated
from ..irgspp_addon.world.scene_lamps import scene_lamps
from ..irgspp_addon.world.world_light import save_light, world_light
from .blocking import RUN, SKIP, WAIT, Queued, StartedByButton, refusing, run_to_end

MAP_ROWS = 256  # of an environment map


class IRGSPP_OT_relight_preview(StartedByButton, bpy.types.Operator):
    """Relight the object with this scene's World in the image "IRGS++ Relight", updated while you work; scripts get a finished image."""

    bl_idname = "irgspp.relight_preview"
    bl_label = "Relight Preview"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    run: StringProperty(**RUN)
    samples: IntProperty(**shared.SAMPLES, options=SKIP)
    denoise: BoolProperty(**shared.DENOISE, options=SKIP)
    backend: EnumProperty(**shared.BACKEND, options=SKIP)
    eye: EnumProperty(**shared.EYE, options=SKIP)
    use_world: BoolProperty(**shared.USE_WORLD, options=SKIP)
    use_lamps: BoolProperty(**shared.USE_LAMPS, options=SKIP)
    resolution: IntProperty(
        name="Resolution", description="Longest side of the image, in pixels", min=16, max=16384, default=256, options=SKIP
    )

    @refusing()
    def start(self, context: bpy.types.Context) -> set[str]:
        """Start the preview and show its image, without waiting for it."""
        self._follow(context)
        preview.show_image()
        return {"FINISHED"}

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Render the image and return when it is finished."""
        follower = self._follow(context)
        try:
            follower.finish()
        finally:
            preview.stop_preview()
        return {"FINISHED"}

    def _follow(self, context: bpy.types.Context) -> Follower:
        """Start the preview of the run with the given keywords, and return its follower."""
        scene = context.scene
        run = _run(context, self.run)
        session_of(run)  # raises at once where the engine is missing
        given, panel = self.properties.is_property_set, preview.settings_of(scene)
        # A value equal to the panel's follows the panel from now on.
        fixed: dict[str, Any] = {name: getattr(self, name) for name in panel if given(name) and getattr(self, name) != panel[name]}
        eye = self.eye if given("eye") and self.eye != scene.irgspp.relight_eye else None
        resolution = self.resolution if given("resolution") and self.resolution != scene.irgspp.preview_resolution else None
        area = context.area if context.area is not None and context.area.type == "VIEW_3D" else None
        return preview.start_preview(scene, run, fixed, resolution, eye, area)


class IRGSPP_OT_relight_stop(bpy.types.Operator):
    """Stop updating the image; it stays as it is."""

    bl_idname = "irgspp.relight_stop"
    bl_label = "Stop Preview"
    bl_options = {"REGISTER"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where a preview is running."""
        if not preview.preview_running():
            cls.poll_message_set(translated("No preview is running"))
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Stop the preview."""
        preview.stop_preview()
        return {"FINISHED"}


class IRGSPP_OT_world_to_map(bpy.types.Operator):
    """Save the World, whatever its nodes, as a lat-long environment map (.exr or .npy) that `irgspp render --environment` reads."""

    bl_idname = "irgspp.world_to_map"
    bl_label = "World to Light Map"
    bl_options = {"REGISTER"}  # noqa: RUF012

    filepath: StringProperty(name="File", subtype="FILE_PATH", options=SKIP | RELATIVE)
    height: IntProperty(name="Height", description="Rows of the map; it has twice as many columns", default=MAP_ROWS, min=2, max=8192)
    filter_glob: StringProperty(default="*.exr;*.npy", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where the scene has a World."""
        if context.scene.world is None:
            cls.poll_message_set(translated("The scene has no World"))
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file.

        Args:
            context: of the button or menu.
            event: ignored.
        """
        self.filepath = self.filepath or "//light.exr"
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the environment map."""
        if not self.filepath:
            raise InputError("world_to_map", "no file is named", "give filepath=")
        path = Path(bpy.path.abspath(self.filepath)).absolute()
        save_light(world_light(context.scene.world, context.scene.frame_current), path, self.height)
        self.report({"INFO"}, translated("The World is saved as {name}", name=path.name))
        return {"FINISHED"}


class IRGSPP_OT_render_views(Queued, bpy.types.Operator):
    """Render views of a run as image files, lit by this scene's World or the recovered light."""

    bl_idname = "irgspp.render_views"
    bl_label = "Render Views"
    bl_options = {"REGISTER"}  # noqa: RUF012

    run: StringProperty(**RUN)
    views: StringProperty(
        name="Views",
        description="DATASET or DATASET:train|test|all, or a number of views on a circle. Empty: the run's dataset",
        options=SKIP,
    )
    output: StringProperty(
        name="Output", description="Folder for the images. Empty: `relit` in the run folder", subtype="DIR_PATH", options=SKIP
    )
    samples: StringProperty(name="Samples", description="Light samples per pixel: hq, efficient or a number", default="hq", options=SKIP)
    denoise: BoolProperty(**shared.DENOISE, options=SKIP)
    backend: EnumProperty(**shared.BACKEND, options=SKIP)
    use_world: BoolProperty(**shared.USE_WORLD, options=SKIP)
    use_lamps: BoolProperty(**shared.USE_LAMPS, options=SKIP)
    wait: BoolProperty(**WAIT)

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the rendering as a job."""
        run = _run(context, self.run)
        output = Path(bpy.path.abspath(self.output)).absolute() if self.output else run / "relit"
        job = jobs.start(
            "render", translated("Render {name}", name=run.name), output, self._arguments(context, run, output), data={"run": str(run)}
        )
        return run_to_end(self, job) if self.wait else {"FINISHED"}

    def _arguments(self, context: bpy.types.Context, run: Path, output: Path) -> list[str]:
        words = ["render", str(run), "-o", str(output), "--samples", self.samples, "--backend", self.backend]
        if self.views.isdecimal():
            words += ["--orbit", self.views]
        else:
            views = bpy.path.abspath(self.views) if self.views else read_run(run).get("dataset", "")
            if not views:
                raise InputError(run, "does not name its photographs", "give views=")
            words += ["--views", views]
        words += [] if self.denoise else ["--no-denoise"]
        if self.use_world:
            words += ["--environment", str(self._map(context, run, output)), "--name", "world", "--layers", "rgba"]
        if self.use_lamps and (lamps := self._lamps(context, run)):
            words += ["--lamps", str(_written(output, "lamps.json", json.dumps(lamp_records(lamps))))]
        return words

    def _lamps(self, context: bpy.types.Context, run: Path) -> tuple[Lamp, ...]:
        """Return the scene's lamps in the run's frame."""
        thing = run_object(context.scene, run)
        return frame_of(thing).lamps(scene_lamps(seen_objects(context.scene), thing))

    def _map(self, context: bpy.types.Context, run: Path, output: Path) -> Path:
        """Write the World, rotated to the run's frame, next to the images, and return the file."""
        frame = frame_of(run_object(context.scene, run))
        light = world_light(context.scene.world, context.scene.frame_current).turned(frame.rotation)
        _make(output)
        save_light(light, output / "world.exr", MAP_ROWS)
        return output / "world.exr"


CLASSES = (IRGSPP_OT_relight_preview, IRGSPP_OT_relight_stop, IRGSPP_OT_world_to_map, IRGSPP_OT_render_views)


def _make(folder: Path) -> None:
    """Make a folder, if it is not there; raise InputError where it can't be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, f"can't be made ({error.strerror})", "name another folder") from error


def _written(folder: Path, name: str, text: str) -> Path:
    """Write a text file into a folder and return its path."""
    _make(folder)
    try:
        (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(folder / name, f"can't be written ({error.strerror})", "name another folder") from error
    return folder / name


def _run(context: bpy.types.Context, named: str) -> Path:
    """Return the named run, or the one chosen in the scene; raise InputError where it is not finished."""
    run = Path(bpy.path.abspath(named)).absolute() if named else chosen_run(context.scene)
    if not (run / "gaussians.ply").is_file():
        raise InputError(run, "is not a finished run folder (no gaussians.ply in it)", "it may have been moved; choose it again")
    return run.resolve()
