# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene properties of the extension (dataset, reconstruction, result, relighting) and the list of jobs in the panel."""

# pyright: reportInvalidTypeForm=false

from collections.abc import Callable, Sequence
from pathlib import Path

import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from . import shared_properties as shared

# From Blender 4.5 on, a property must declare that it accepts paths relative to the .blend file (`//`).
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set()

VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")  # suffixes of videos that the engine reads


CHOSEN: list[Callable[[bpy.types.Scene], None]] = []  # called with the scene where the user chooses other photographs

_quiet = False  # True while `set_quietly` sets a property


def _choose(settings: "IRGSPP_SceneSettings", context: bpy.types.Context) -> None:
    if _quiet:
        return
    settings.inspected = ""  # it describes another folder
    for listener in CHOSEN:
        listener(settings.id_data)


def set_quietly(settings: "IRGSPP_SceneSettings", name: str, value: str) -> None:
    """Set a property without what follows where the user sets it: it names the same folder at another place.

    Args:
        settings: of the scene.
        name: of the property.
        value: of the property.
    """
    global _quiet
    _quiet = True
    try:
        setattr(settings, name, value)
    finally:
        _quiet = False


def _is_mesh(settings: "IRGSPP_SceneSettings", thing: bpy.types.Object) -> bool:
    return thing.type == "MESH"


class IRGSPP_SceneSettings(bpy.types.PropertyGroup):
    """Settings stored in the .blend as `scene.irgspp`; settings of the machine are in the preferences."""

    # Dataset
    dataset: StringProperty(
        name="Photographs",
        description="Folder of photographs, or a video. Known cameras (transforms.json, COLMAP, ...) are used, others are found",
        subtype="DIR_PATH",
        options=RELATIVE,
        update=_choose,
    )
    saved_in: StringProperty(description="Folder of the .blend file when it was saved last", options={"HIDDEN"})
    inspected: StringProperty(description="Description of the dataset by the engine, as JSON", options={"HIDDEN"})
    up_axis: EnumProperty(**shared.UP_AXIS, default="AS_IS")
    scale: FloatProperty(
        name="Scale",
        description="Scale of imported objects in Blender, relative to the dataset's own units",
        default=1.0,
        min=1e-6,
        max=1e6,
        soft_min=0.01,
        soft_max=100.0,
    )
    recentre: BoolProperty(**shared.RECENTRE, default=False)
    with_photographs: BoolProperty(
        name="Photographs Behind Cameras", description="Each camera shows its photograph when you look through it", default=True
    )
    with_points: BoolProperty(name="Point Cloud", description="Import the dataset's point cloud, if it has one", default=True)
    capture_marker: FloatProperty(
        name="Marker (m)",
        description="Side of the black square of a printed ArUco or AprilTag marker in the photographs, in metres; the object then gets "
        "its true size. 0: no marker",
        default=0.0,
        min=0.0,
        soft_max=1.0,
        step=0.1,
        precision=4,
    )
    capture_distance: FloatProperty(
        name="Distance (m)", description="True distance of the two measured points, in metres", default=0.0, min=0.0, precision=4
    )
    capture_turntable: EnumProperty(**shared.TURNED, default="auto")

    # Reconstruct
    run: StringProperty(
        name="Run Folder",
        description="Folder for the reconstruction's results. Empty: next to the photographs' folder, with its name and _irgspp",
        subtype="DIR_PATH",
        options=RELATIVE,
    )
    preset: EnumProperty(**shared.PRESET)
    materials: EnumProperty(**shared.MATERIAL, default="auto")
    device: EnumProperty(**shared.DEVICE, default="auto")
    seed: IntProperty(
        name="Seed", description="Seed of all random numbers: the same seed on the same machine gives the same result", default=0, min=0
    )
    overrides: StringProperty(
        name="Settings",
        description="Settings that replace those of the preset, as key=value separated by spaces, such as surface.texture=2048",
    )
    live_shape: BoolProperty(
        name="Show While Running",
        description="Show what the reconstruction has found so far in the 3D View: points at first, then the surface",
        default=True,
    )
    import_result: BoolProperty(name="Import When Done", description="Import the object into this scene when it is finished", default=True)

    # Result
    source: EnumProperty(**shared.SOURCE, default="textures")
    pack: BoolProperty(
        name="Pack",
        description="Keep textures and light inside the .blend instead of linking to the run folder",
        default=True,
    )
    texture_size: EnumProperty(**shared.TEXTURE_SIZE)
    texture_bits: EnumProperty(**shared.TEXTURE_BITS)
    udim_tiles: IntProperty(**shared.UDIM)
    triangles: IntProperty(**shared.TRIANGLES, max=100_000_000, soft_max=200_000)
    bake_quads: IntProperty(**shared.QUADS, max=10_000_000, soft_max=50_000)
    bake_height: BoolProperty(**shared.HEIGHT)
    edited_mesh: PointerProperty(
        name="Edited Mesh",
        description="Mesh that you edited or modelled, to bake the textures onto. Empty: the run's own mesh",
        type=bpy.types.Object,
        poll=_is_mesh,
    )

    export_lods: BoolProperty(**shared.LODS)
    export_collision: BoolProperty(**shared.COLLISION)
    export_textures: EnumProperty(**shared.TEXTURES, default="auto")
    export_occlusion: BoolProperty(**shared.OCCLUSION)
    export_as_placed: BoolProperty(**shared.AS_PLACED)
    export_normal_map: EnumProperty(**shared.NORMAL_MAP, default="opengl")

    # Relight
    use_world: BoolProperty(**shared.USE_WORLD)
    use_lamps: BoolProperty(**shared.USE_LAMPS)
    ground_shadow: BoolProperty(
        name="Ground Shadow",
        description="The object casts its shadow on an invisible level ground at its foot: the shadow is in the image's alpha",
        default=False,
    )
    relight_samples: IntProperty(**shared.SAMPLES)
    relight_denoise: BoolProperty(**shared.DENOISE)
    relight_backend: EnumProperty(**shared.BACKEND, default="mesh")
    relight_eye: EnumProperty(**shared.EYE, default="view")
    preview_resolution: IntProperty(
        name="Resolution", description="Longest side of the preview in pixels", default=256, min=16, max=4096, soft_min=64, soft_max=1024
    )

    def dataset_path(self) -> Path | None:
        """Return the absolute path of the folder of photographs, or None if none is chosen."""
        return Path(bpy.path.abspath(self.dataset)) if self.dataset else None

    def run_path(self) -> Path | None:
        """Return the absolute path of the run folder: the chosen one, or the default next to the dataset; None without either."""
        if self.run:
            return Path(bpy.path.abspath(self.run))
        dataset = self.dataset_path()
        return beside(dataset, "_irgspp") if dataset else None


def beside(photographs: Path, ending: str) -> Path:
    """Return the folder next to photographs with their name and an ending; the suffix of a video is dropped.

    Args:
        photographs: folder of photographs, or a video.
        ending: of the folder's name.
    """
    name = photographs.stem if photographs.suffix.lower() in VIDEOS else photographs.name
    return photographs.with_name(f"{name}{ending}")


class IRGSPP_JobItem(bpy.types.PropertyGroup):
    """Row of the list of jobs: `name` is the job's id, the panel reads everything else from the job itself."""


CLASSES = (IRGSPP_SceneSettings, IRGSPP_JobItem)


def show_jobs(ids: Sequence[str]) -> None:
    """Show these jobs, the newest first, in the panel's list.

    It is called when jobs are added or removed, because a panel must not write properties while it draws.
    """
    manager = bpy.context.window_manager
    if manager is None or [item.name for item in manager.irgspp_jobs] == list(ids):
        return
    chosen = manager.irgspp_jobs[manager.irgspp_job_index].name if 0 <= manager.irgspp_job_index < len(manager.irgspp_jobs) else ""
    newest_is_new = bool(ids) and ids[0] not in manager.irgspp_jobs
    manager.irgspp_jobs.clear()
    for job in ids:
        manager.irgspp_jobs.add().name = job
    manager.irgspp_job_index = 0 if newest_is_new or chosen not in ids else list(ids).index(chosen)


def register() -> None:
    """Add the properties to scenes and the window manager, after their classes are registered."""
    bpy.types.Scene.irgspp = PointerProperty(type=IRGSPP_SceneSettings)
    bpy.types.WindowManager.irgspp_jobs = CollectionProperty(type=IRGSPP_JobItem)
    bpy.types.WindowManager.irgspp_job_index = IntProperty(name="Job", description="The job whose details are shown", default=0, min=0)


def unregister() -> None:
    """Remove the properties, before their classes are unregistered."""
    del bpy.types.WindowManager.irgspp_job_index
    del bpy.types.WindowManager.irgspp_jobs
    del bpy.types.Scene.irgspp
