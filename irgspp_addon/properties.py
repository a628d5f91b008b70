# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene remembers of its dataset, run and relighting, and the list of jobs that the panel shows."""

# pyright: reportInvalidTypeForm=false

from collections.abc import Sequence
from pathlib import Path

import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

# From Blender 4.5 on a property must say that it understands paths that begin with the .blend's folder, `//`.
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set()

UP_AXES = [
    ("AS_IS", "As It Is", "Upright as the engine found it", 0),
    ("Y_UP", "+Y Up", "The dataset's Y axis becomes Blender's Z", 1),
    ("NEG_Y_UP", "-Y Up", "The dataset's Y axis points down, as in COLMAP", 2),
    ("X_UP", "+X Up", "The dataset's X axis becomes Blender's Z", 3),
    ("NEG_X_UP", "-X Up", "The dataset's X axis points down", 4),
    ("NEG_Z_UP", "-Z Up", "The dataset stands on its head", 5),
    ("Z_UP", "+Z Up", "The dataset's own axes, unchanged", 6),
]
PRESETS = [
    ("draft", "Draft", "A first look: photographs reduced to 320 pixels, few steps; a minute or two", 0),
    ("balanced", "Balanced", "For most objects: photographs reduced to 640 pixels; several minutes on a CPU", 1),
    ("paper", "Paper", "The published schedule: 50,000 steps, photographs of 800 pixels; hours, for a GPU", 2),
]
MATERIALS = [
    ("auto", "Find Out", "Try both kinds briefly and keep the one that explains views held back better", 0),
    ("low-gloss", "Low Gloss", "Cloth, wood, plaster, plastic: the object mirrors nothing", 1),
    ("glossy", "Glossy", "Metal, glaze, lacquer: the object mirrors its surroundings", 2),
]
DEVICES = [
    ("auto", "Best", "A graphics card where the engine can use one, the processor otherwise", 0),
    ("cpu", "CPU", "The processor", 1),
    ("cuda", "CUDA", "An NVIDIA graphics card", 2),
]
SOURCES = [
    ("textures", "Textures", "The material reads images through the UV map", 0),
    ("attributes", "Attributes", "The material reads values at the mesh's vertices", 1),
]
BACKENDS = [
    ("mesh", "Mesh", "Shadows and reflections among the object's parts are traced on its mesh: fast", 0),
    ("gaussian", "Gaussians", "They are traced through the Gaussians themselves: slower, and as they were fitted", 1),
]
EYES = [
    ("camera", "Camera", "See the object from the scene's camera", 0),
    ("view", "3D View", "See the object as this 3D View shows it", 1),
]


def _forget_inspection(settings: "IRGSPP_SceneSettings", context: bpy.types.Context) -> None:
    settings.inspected = ""  # it was said of another folder


def _is_mesh(settings: "IRGSPP_SceneSettings", thing: bpy.types.Object) -> bool:
    return thing.type == "MESH"


class IRGSPP_SceneSettings(bpy.types.PropertyGroup):
    """Stored in the .blend as `scene.irgspp`; what belongs to the machine is in the preferences."""

    # Dataset
    dataset: StringProperty(
        name="Photographs",
        description="Folder of photographs with known cameras: transforms.json (NeRF, instant-ngp, nerfstudio) or a COLMAP model",
        subtype="DIR_PATH",
        options=RELATIVE,
        update=_forget_inspection,
    )
    inspected: StringProperty(description="What was understood of the dataset, as JSON", options={"HIDDEN"})
    up_axis: EnumProperty(name="Up", description="Which way the dataset's up is turned to Blender's Z", items=UP_AXES, default="AS_IS")
    scale: FloatProperty(
        name="Scale",
        description="Size of the imported things in Blender, relative to the dataset's own units",
        default=1.0,
        min=1e-6,
        max=1e6,
        soft_min=0.01,
        soft_max=100.0,
    )
    recentre: BoolProperty(name="Recentre", description="Move the object's middle to Blender's origin", default=False)
    with_photographs: BoolProperty(
        name="Photographs Behind Cameras", description="Each camera shows its photograph when you look through it", default=True
    )
    with_points: BoolProperty(name="Point Cloud", description="Import the points that the dataset knows of", default=True)

    # Reconstruct
    run: StringProperty(
        name="Run Folder",
        description="Folder that the reconstruction writes. Empty: beside the photographs, named like them with _irgspp",
        subtype="DIR_PATH",
        options=RELATIVE,
    )
    preset: EnumProperty(name="Preset", description="How much work is done", items=PRESETS, default="balanced")
    materials: EnumProperty(name="Material", description="What the object is made of", items=MATERIALS, default="auto")
    device: EnumProperty(name="Device", description="What computes", items=DEVICES, default="auto")
    seed: IntProperty(name="Seed", description="Of every random choice: same seed, same machine, same result", default=0, min=0)
    overrides: StringProperty(
        name="Settings",
        description="Single settings on top of the preset, as key=value with spaces between: surface.texture=2048",
    )
    import_result: BoolProperty(name="Import When Done", description="Put the object into this scene when it is finished", default=True)

    # Result
    source: EnumProperty(
        name="Material Reads",
        description="Where the object's material has its values from",
        items=SOURCES,
        default="textures",
    )
    pack: BoolProperty(
        name="Pack",
        description="Keep textures and light inside the .blend instead of linking to the run folder",
        default=True,
    )
    texture_size: IntProperty(
        name="Texture Size",
        description="Texels along a side of the baked textures",
        default=1024,
        min=16,
        max=16384,
        soft_min=256,
        soft_max=4096,
    )
    triangles: IntProperty(
        name="Triangles",
        description="Most triangles of the mesh; 0: as many as it has",
        default=0,
        min=0,
        max=100_000_000,
        soft_max=200_000,
    )
    edited_mesh: PointerProperty(
        name="Edited Mesh",
        description="A mesh that you edited or made anew, to bake onto. Empty: the run's own mesh",
        type=bpy.types.Object,
        poll=_is_mesh,
    )

    # Relight
    use_world: BoolProperty(
        name="Light from World",
        description="Light the object by this scene's World; otherwise by the light that was recovered",
        default=True,
    )
    relight_samples: IntProperty(
        name="Samples",
        description="Rays of light per pixel of the finished image: more rays, less noise",
        default=32,
        min=1,
        max=65536,
        soft_max=512,
    )
    relight_denoise: BoolProperty(name="Denoise", description="Smooth the noise of few samples without blurring edges", default=True)
    relight_backend: EnumProperty(name="Trace", description="What shadows and reflections are traced on", items=BACKENDS, default="mesh")
    relight_eye: EnumProperty(name="Seen From", description="Where the image is taken from", items=EYES, default="view")
    preview_resolution: IntProperty(
        name="Resolution", description="Longest side of the preview in pixels", default=256, min=16, max=4096, soft_min=64, soft_max=1024
    )

    def dataset_path(self) -> Path | None:
        """The folder of photographs, absolute; None where none is chosen."""
        return Path(bpy.path.abspath(self.dataset)) if self.dataset else None

    def run_path(self) -> Path | None:
        """The run folder, absolute: the chosen one, or the one beside the dataset; None where neither is chosen."""
        if self.run:
            return Path(bpy.path.abspath(self.run))
        dataset = self.dataset_path()
        return dataset.with_name(f"{dataset.name}_irgspp") if dataset else None


class IRGSPP_JobItem(bpy.types.PropertyGroup):
    """One row of the list of jobs: `name` is the job's id, all else is asked of the job itself."""


CLASSES = (IRGSPP_SceneSettings, IRGSPP_JobItem)


def show_jobs(ids: Sequence[str]) -> None:
    """Let the panel's list show these jobs, the newest first. Called when jobs come or go (a panel must not write while it draws)."""
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
    """Attach them, after their classes are registered."""
    bpy.types.Scene.irgspp = PointerProperty(type=IRGSPP_SceneSettings)
    bpy.types.WindowManager.irgspp_jobs = CollectionProperty(type=IRGSPP_JobItem)
    bpy.types.WindowManager.irgspp_job_index = IntProperty(name="Job", description="The job whose details are shown", default=0, min=0)


def unregister() -> None:
    """Take them off, before their classes go."""
    del bpy.types.WindowManager.irgspp_job_index
    del bpy.types.WindowManager.irgspp_jobs
    del bpy.types.Scene.irgspp
