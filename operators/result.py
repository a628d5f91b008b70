# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators on a finished run: bake its textures again, export its parts as files."""

# pyright: reportInvalidTypeForm=false

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from mathutils import Matrix

from ..core.assets.options import SUFFIXES, UNTURNED, AssetOptions
from ..core.errors import InputError, IrgsppError
from ..irgspp_addon import shared_properties as shared
from ..irgspp_addon.importer.edited_mesh import save_edited
from ..irgspp_addon.importer.materials import source_of
from ..irgspp_addon.importer.mesh_origin import mesh_to_run
from ..irgspp_addon.importer.ownership import Owner
from ..irgspp_addon.importer.run_frame import run_object, transform_of
from ..irgspp_addon.importer.run_root import run_of
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs import result_import
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.translations import translated
from .blocking import IMPORT, RUN, SKIP, WAIT, Queued, refuse, refusing, run_to_end

ENDINGS = f"{', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"


class IRGSPP_OT_bake(Queued, bpy.types.Operator):
    """Bake a run again: other textures, fewer triangles or an edited mesh. Smaller textures are made at once from the last bake."""

    bl_idname = "irgspp.bake"
    bl_label = "Bake Again"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    run: StringProperty(**RUN)
    size: IntProperty(
        name="Texture Size",
        description="Width and height of the textures, or of each UDIM tile, in texels; 0: as in the last bake",
        default=0,
        min=0,
        max=16384,
    )
    bits: EnumProperty(**shared.TEXTURE_BITS)
    udim: IntProperty(**shared.UDIM)
    triangles: IntProperty(**shared.TRIANGLES)
    mesh: StringProperty(
        name="Edited Mesh",
        description="Name of a mesh object, edited or newly modelled, that replaces the run's mesh; its UVs are kept",
        options=SKIP,
    )
    quads: IntProperty(**shared.QUADS)
    height: BoolProperty(**shared.HEIGHT)
    import_result: BoolProperty(**IMPORT)
    wait: BoolProperty(**WAIT)

    @refusing(RuntimeError)
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the baking as a job."""
        run = named_run(context, self.run)
        arguments, data = self._arguments(context, run), self._data(context, run)
        on_done = "import_bake" if self.import_result and not self.wait else None
        job = jobs.start("bake", translated("Bake {name}", name=run.name), run, arguments, on_done, data)
        ended = run_to_end(self, job) if self.wait else {"FINISHED"}
        if self.wait and self.import_result and ended == {"FINISHED"}:
            import_bake(job)
        return ended

    def _arguments(self, context: bpy.types.Context, run: Path) -> list[str]:
        words = ["bake", str(run)]
        words += ["--size", str(self.size)] if self.size else []
        words += ["--bits", self.bits] if self.bits != "0" else []
        words += ["--udim", str(self.udim)] if self.udim else []
        words += ["--triangles", str(self.triangles)] if self.triangles else []
        words += ["--quads", str(self.quads)] if self.quads else []
        words += ["--height"] if self.height else []
        if self.mesh:
            thing = context.scene.objects.get(self.mesh)
            if thing is None:
                raise InputError(self.mesh, "no such object in the scene", "name a mesh object")
            words += ["--mesh", str(save_edited(context, thing, run))]
        return words

    def _data(self, context: bpy.types.Context, run: Path) -> dict:
        panel, own = context.scene.irgspp, Owner(run).find(bpy.data.objects, "mesh")
        source = source_of(own.active_material) if own is not None and own.active_material else None
        return {**result_import.place_of(context.scene, source or panel.source, panel.pack), "mesh": self.mesh, "run": str(run)}


def import_bake(job: Job) -> None:
    """Update the run's object; an edited mesh already includes its modifiers and transform, so these are cleared."""
    with result_import.started_from(job, f"import the result by File > Import > IRGS++ Run from {job.folder}") as scene:
        own, edited = Owner(job.folder).find(bpy.data.objects, "mesh"), scene.objects.get(job.data["mesh"])
        if own is not None and own == edited:
            own.modifiers.clear()
            own.matrix_parent_inverse = Matrix()
            own.matrix_basis = mesh_to_run(own)
        result_import.import_result(job)
        if edited is not None and edited != own and edited.data.uv_layers and not edited.data.materials:
            edited.data.materials.append(Owner(job.folder).find(bpy.data.materials, "material"))


class IRGSPP_OT_export(bpy.types.Operator):
    """Write a finished run's asset (.glb, .usdc, .usdz, .fbx, .obj), Blender scene (.blend), Gaussian splats (.ply) or light (.exr)."""

    bl_idname = "irgspp.export"
    bl_label = "Export IRGS++ Result"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    run: StringProperty(**RUN)
    filepath: StringProperty(name="File", description=f"Ends with {ENDINGS}", subtype="FILE_PATH", options=SKIP)
    filter_glob: StringProperty(default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"})
    lods: BoolProperty(**shared.LODS, options=SKIP)
    collision: BoolProperty(**shared.COLLISION, options=SKIP)
    textures: EnumProperty(**shared.TEXTURES, options=SKIP)
    normal_map: EnumProperty(**shared.NORMAL_MAP, options=SKIP)
    occlusion: BoolProperty(**shared.OCCLUSION, options=SKIP)
    as_placed: BoolProperty(**shared.AS_PLACED, options=SKIP)
    check_existing: BoolProperty(default=True, options={"HIDDEN"})
    wait: BoolProperty(**WAIT)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file.

        Args:
            context: of the button or menu.
            event: ignored.
        """
        self.wait = bpy.app.background
        try:
            run = named_run(context, self.run)
        except IrgsppError as error:
            return refuse(self, error)
        self.run, self.filepath = str(run), self.filepath or str(run / f"{run.name}.glb")
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the export as a job."""
        run = named_run(context, self.run)
        if not self.filepath:
            raise InputError("filepath", "no file is named", f"name a file that ends with {ENDINGS}")
        target = Path(bpy.path.abspath(self.filepath)).absolute()
        words = ["export", str(run), "-o", str(target), "--material", context.scene.irgspp.source]
        words += ["--lods"] if self.lods else []
        words += ["--collision"] if self.collision else []
        words += ["--textures", self.textures, "--normal-map", self.normal_map]
        words += ["--occlusion"] if self.occlusion else []
        words += self._transform(context, run, target.suffix.lower())
        job = jobs.start("export", translated("Export {name}", name=target.name), run, words, data={"file": str(target), "run": str(run)})
        return run_to_end(self, job) if self.wait else {"FINISHED"}

    def _transform(self, context: bpy.types.Context, run: Path, suffix: str) -> list[str]:
        """Return the words that turn and scale the export as the object in the scene; none where it is not turned."""
        thing = run_object(context.scene, run)
        if not self.as_placed or thing is None or suffix == ".exr":
            return []
        context.view_layer.update()
        transform = transform_of(thing)
        AssetOptions(transform=transform).matrix(suffix)
        return ["--transform", *(f"{value:.9g}" for value in transform)] if transform != UNTURNED else []


def named_run(context: bpy.types.Context, path: str) -> Path:
    """Return a run folder: the given one, else the active object's, else the panel's.

    Args:
        context: with the active object.
        path: run folder, or empty.

    Raises:
        InputError: no run is chosen, or the folder is not a run.
    """
    run = Path(bpy.path.abspath(path)) if path else run_of(context.object) or context.scene.irgspp.run_path()
    if run is None:
        raise InputError("run", "none is chosen", "select the imported object, or give run=")
    if not (run / "run.json").is_file():
        raise InputError(run, "is not a run folder (no run.json in it)", "it may have been moved; choose it again")
    return run.resolve()


CLASSES = (IRGSPP_OT_bake, IRGSPP_OT_export)


def register() -> None:
    """Register the function that a finished job calls."""
    jobs.ON_DONE["import_bake"] = import_bake


def unregister() -> None:
    """Unregister it."""
    jobs.ON_DONE.pop("import_bake", None)
