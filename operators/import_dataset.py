# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that inspect a dataset and import its cameras, photographs and points, also by drag and drop."""

# pyright: reportInvalidTypeForm=false

import json
from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from ..core.errors import InputError, IrgsppError
from ..irgspp_addon.engine import process as engine
from ..irgspp_addon.importer.dataset_import import build_dataset, checked, export_arguments, export_folder, is_fresh
from ..irgspp_addon.importer.photographs import problem_of
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs import result_import
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.properties import CHOSEN, set_quietly
from ..irgspp_addon.translations import translated
from .blocking import WAIT, Queued, refuse, refusing, run_to_end
from .import_run import select
from .placed_import import PlacedImport

SPLIT_FILES = ("transforms_train.json", "transforms_test.json", "transforms_val.json")
MODEL_FILES = ("cameras.bin", "images.bin", "points3D.bin")
OPTIONS = ("directory", "up_axis", "scale", "recentre", "photographs", "points")


class IRGSPP_OT_inspect_dataset(Queued, bpy.types.Operator):
    """Show what the engine reads of the photographs and their cameras, and any problems with them."""

    bl_idname = "irgspp.inspect_dataset"
    bl_label = "Inspect Dataset"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    directory: StringProperty(name="Dataset", description="Folder of photographs with known cameras", subtype="DIR_PATH")
    wait: BoolProperty(**WAIT)

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the inspection as a job."""
        dataset = checked(self.directory)
        data = {**result_import.place_of(context.scene), "dataset": str(dataset)}
        words = ["inspect", str(dataset), "--json"]
        job = jobs.start(
            "inspect", translated("Inspect {name}", name=dataset.name), None, words, None if self.wait else "show_inspection", data
        )
        ended = run_to_end(self, job) if self.wait else {"FINISHED"}
        if self.wait and ended == {"FINISHED"}:
            show_inspection(job)
        return ended


def inspect_chosen(scene: bpy.types.Scene) -> Job | None:
    """Inspect photographs as soon as they are chosen; return the job, None where there is nothing to inspect.

    Args:
        scene: in whose panel they are chosen.
    """
    dataset = scene.irgspp.dataset_path()
    if dataset is None or not engine.status().usable or problem_of(dataset):
        return None
    data = {**result_import.place_of(scene), "dataset": str(dataset.resolve())}
    for job in jobs.all_jobs():
        if not job.finished and job.on_done == "show_inspection":  # of photographs that were chosen before
            jobs.cancel(job)
    try:
        return jobs.start(
            "inspect", translated("Inspect {name}", name=dataset.name), None, ["inspect", str(dataset), "--json"], "show_inspection", data
        )
    except IrgsppError:  # the button Inspect tells why
        return None


def _chosen(scene: bpy.types.Scene) -> None:
    if not bpy.app.background:
        inspect_chosen(scene)


def show_inspection(job: Job) -> None:
    """Store the inspection in the scene that the job was started from, for the panel."""
    with result_import.started_from(job, "inspect the dataset again there") as scene:
        lines = job.output().strip().splitlines()
        if not lines:
            raise IrgsppError("the engine printed nothing about the dataset")
        _store(scene, Path(job.data["dataset"]), json.loads(lines[-1]))


def _store(scene: bpy.types.Scene, dataset: Path, facts: dict) -> None:
    settings = scene.irgspp
    chosen = settings.dataset_path()
    if chosen is None:
        set_quietly(settings, "dataset", str(dataset))
    if chosen is None or chosen.resolve() == dataset:  # else the user has chosen another one meanwhile
        settings.inspected = json.dumps(facts)


class IRGSPP_OT_import_dataset(PlacedImport, bpy.types.Operator):
    """Import the cameras, photographs and points of a dataset; they replace its last import."""

    bl_idname = "irgspp.import_dataset"
    bl_label = "Import IRGS++ Dataset"
    directory: StringProperty(name="Dataset", subtype="DIR_PATH", options={"SKIP_SAVE", "SKIP_PRESET"})
    photographs: BoolProperty(name="Photographs", description="Each camera shows its photograph when you look through it", default=True)
    points: BoolProperty(name="Point Cloud", description="Import the dataset's point cloud, if it has one", default=True)
    wait: BoolProperty(**WAIT)
    was_read: BoolProperty(description="The engine has just read the dataset for this import", options={"SKIP_SAVE", "HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the folder where none is given.

        Args:
            context: of the button or menu.
            event: ignored.
        """
        self.wait = bpy.app.background
        return super().invoke(context, event)

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Import the dataset, after a job that reads it where it has changed."""
        dataset = checked(self.directory)
        folder = export_folder(dataset)
        if not self.was_read and not is_fresh(dataset, folder):
            data = {**result_import.place_of(context.scene), "options": {name: getattr(self, name) for name in OPTIONS}}
            on_done = None if self.wait else "import_dataset"
            job = jobs.start(
                "inspect", translated("Import {name}", name=dataset.name), None, export_arguments(dataset, folder), on_done, data
            )
            ended = run_to_end(self, job) if self.wait else None
            if ended != {"FINISHED"}:
                return ended or {"FINISHED"}
        self._build(context, dataset, folder)
        return {"FINISHED"}

    def _build(self, context: bpy.types.Context, dataset: Path, folder: Path) -> None:
        imported = build_dataset(dataset, folder, self.placement(), self.photographs, self.points, context.scene)
        _store(context.scene, dataset, imported.facts)
        select(context, imported.root)


def import_when_read(job: Job) -> None:
    """Import the dataset that a job has read."""
    with result_import.started_from(job, "import the dataset again there"):
        bpy.ops.irgspp.import_dataset("EXEC_DEFAULT", True, was_read=True, **job.data["options"])


class IRGSPP_OT_import_dropped(bpy.types.Operator):
    """Import a dropped file: a dataset (transforms.json, a COLMAP model's cameras.bin) or a finished run (run.json)."""

    bl_idname = "irgspp.import_dropped"
    bl_label = "Import into IRGS++"
    bl_options = {"REGISTER", "INTERNAL"}  # noqa: RUF012 (Blender wants a plain set)

    filepath: StringProperty(name="File", subtype="FILE_PATH", options={"SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Import the file as a menu does.

        Args:
            context: of the button or menu.
            event: ignored.
        """
        return self._import("INVOKE_DEFAULT")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Import the file and return when it is done."""
        return self._import("EXEC_DEFAULT")

    def _import(self, context_name: str) -> set[str]:
        file = Path(bpy.path.abspath(self.filepath))
        try:
            if file.name == "run.json":
                return bpy.ops.irgspp.import_run(context_name, directory=str(file.parent))
            return bpy.ops.irgspp.import_dataset(context_name, directory=str(dataset_of(file)))
        except (InputError, RuntimeError) as error:  # the latter is what the other operator reported
            return refuse(self, error)


def dataset_of(file: Path) -> Path:
    """Return the dataset that a dropped file belongs to: its folder unless that is ambiguous. Raises InputError for an unknown file."""
    folder = file.parent
    if file.suffix.lower() == ".json" and file.name.startswith("transforms"):
        if (folder / "transforms_train.json").is_file():
            return folder if file.name in SPLIT_FILES else file
        others = any((folder / name).exists() for name in ("sparse", "colmap", "cameras.bin", "cameras.txt"))
        return folder if file.name == "transforms.json" and not others else file
    if file.name in MODEL_FILES:
        root = folder.parent.parent
        return root if folder.parent.name == "sparse" and not (root / "transforms_train.json").exists() else folder
    raise InputError(file, "is neither a dataset nor a run", "drop a transforms.json, a COLMAP model's cameras.bin, or a run.json")


class IRGSPP_FH_dropped(bpy.types.FileHandler):
    """Datasets and runs can be dropped into a 3D View or the Outliner."""

    bl_idname = "IRGSPP_FH_dropped"
    bl_label = "IRGS++ dataset or run"
    bl_import_operator = "irgspp.import_dropped"
    bl_file_extensions = ".json;.bin"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Return True in 3D Views and the Outliner."""
        return context.area is not None and context.area.type in {"VIEW_3D", "OUTLINER"}


def draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Add the entry to the menu File > Import.

    Args:
        self: menu.
        context: of the menu.
    """
    self.layout.operator(IRGSPP_OT_import_dataset.bl_idname, text="IRGS++ Dataset (folder of photographs with known cameras)")


CLASSES = (IRGSPP_OT_inspect_dataset, IRGSPP_OT_import_dataset, IRGSPP_OT_import_dropped, IRGSPP_FH_dropped)


def register() -> None:
    """Register the menu entry, and the functions that finished jobs call."""
    bpy.types.TOPBAR_MT_file_import.append(draw_import)
    CHOSEN.append(_chosen)
    jobs.ON_DONE.update(show_inspection=show_inspection, import_dataset=import_when_read)


def unregister() -> None:
    """Unregister them."""
    for name in ("show_inspection", "import_dataset"):
        jobs.ON_DONE.pop(name, None)
    CHOSEN.remove(_chosen)
    bpy.types.TOPBAR_MT_file_import.remove(draw_import)
