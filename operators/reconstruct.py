# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that reconstruct a dataset, or the demo dataset, into a run folder."""

# pyright: reportInvalidTypeForm=false

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..core.errors import InputError
from ..irgspp_addon import shared_properties as shared
from ..irgspp_addon.importer.capture_file import read_capture
from ..irgspp_addon.importer.mask_image import save_masks
from ..irgspp_addon.importer.object_sphere import bound_settings, cut_settings
from ..irgspp_addon.importer.photographs import find_bare_photographs
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs import result_import
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.properties import beside
from ..irgspp_addon.translations import translated
from .blocking import IMPORT, SKIP, WAIT, Queued, refusing, run_to_end
from .capture import start_cut, use_capture
from .command_words import capture_words, set_words

# Properties of the operator that a reconstruction after a cut is started with again.
OPTIONS = ("dataset", "run", "preset", "materials", "device", "seed", "settings", "resume", "overwrite", "import_result")


class IRGSPP_OT_reconstruct(bpy.types.Operator):
    """Reconstruct a relightable object from photographs or a video, in the background. Missing options are taken from the IRGS++ panel."""

    bl_idname = "irgspp.reconstruct"
    bl_label = "Reconstruct"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    dataset: StringProperty(
        name="Photographs",
        description="Folder of photographs, or a video; cameras that are not known are found",
        subtype="DIR_PATH",
        options=SKIP,
    )
    run: StringProperty(
        name="Run Folder",
        description="Folder for the results. Empty: next to the photographs' folder, with its name and _irgspp",
        subtype="DIR_PATH",
        options=SKIP,
    )
    preset: EnumProperty(**shared.PRESET, options=SKIP)
    materials: EnumProperty(**shared.MATERIAL, options=SKIP)
    device: EnumProperty(**shared.DEVICE, options=SKIP)
    seed: IntProperty(name="Seed", description="Seed of all random numbers", min=0, options=SKIP)
    settings: StringProperty(name="Settings", description="Single settings, as key=value separated by spaces", options=SKIP)
    resume: BoolProperty(name="Resume", description="Continue the run in the folder, with its own settings", options=SKIP)
    overwrite: BoolProperty(name="Overwrite", description="Replace the run in the folder", options=SKIP)
    import_result: BoolProperty(**IMPORT)
    wait: BoolProperty(**WAIT)
    was_cut: BoolProperty(description="The object has just been cut out by its sphere", options={"SKIP_SAVE", "HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Run as a button does: queue a job; ask before a run is replaced.

        Args:
            context: of the button or menu.
            event: that the dialog is opened with.
        """
        self.wait = bpy.app.background
        if self.overwrite and not self.wait:
            words = {"title": "Reconstruct again?", "message": "The run in the folder is replaced", "confirm_text": "Replace"}
            return context.window_manager.invoke_confirm(self, event, icon="WARNING", **words)
        return self.execute(context)

    @refusing(RuntimeError)
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the reconstruction as a job."""
        self._take_from_scene(context.scene)
        cut = self._start_cut(context.scene)
        if cut is not None and not self.wait:
            self.report({"INFO"}, translated("{job}: {state}; the reconstruction follows", job=cut.title, state=translated(cut.state)))
            return {"FINISHED"}
        if cut is not None:
            if (ended := run_to_end(self, cut)) != {"FINISHED"}:
                return ended
            use_capture(context.scene, cut, wait=True)
        job = self._start(context.scene)
        if not self.wait:
            self.report({"INFO"}, f"{job.title}: {translated(job.state)}")
            return {"FINISHED"}
        ended = run_to_end(self, job)
        if ended == {"FINISHED"} and self.import_result:
            return import_now(context.scene, job.folder)
        return ended

    def _take_from_scene(self, scene: bpy.types.Scene) -> None:
        """Take the options that the caller did not give from the panel."""
        panel, given = scene.irgspp, self.properties.is_property_set
        for name in ("preset", "materials", "device", "seed", "import_result"):
            if not given(name):
                setattr(self, name, getattr(panel, name))
        if not given("settings"):
            self.settings = panel.overrides
        if not given("dataset"):
            self.dataset = str(panel.dataset_path() or "")
            self.run = self.run if given("run") else bpy.path.abspath(panel.run)

    def _folders(self) -> tuple[Path, Path]:
        """Return dataset and run folder; raise InputError where there is no dataset."""
        if not self.dataset:
            raise InputError("photographs", "no folder is chosen", "choose one in the panel, or give dataset=")
        dataset = Path(bpy.path.abspath(self.dataset)).absolute()
        if not dataset.exists():
            raise InputError(dataset, "no such folder", "it may have been moved; choose it again")
        return dataset, Path(bpy.path.abspath(self.run)).absolute() if self.run else beside(dataset, "_irgspp")

    def _start_cut(self, scene: bpy.types.Scene) -> Job | None:
        """Start the job that cuts the object of a capture out again, after which this one follows; None where its sphere was not moved.

        A run that is resumed goes on with the object that it began with.
        """
        dataset, run = self._folders()
        moved = [] if self.was_cut or self._resumes(run) else cut_settings(scene, dataset, read_capture(dataset))
        if not moved:
            return None
        self._arguments(scene, dataset, run)  # raises InputError where the reconstruction would be refused
        options = {name: getattr(self, name) for name in OPTIONS}
        return start_cut(scene, dataset.resolve(), moved, None if self.wait else "reconstruct_cut", {"options": options})

    def _resumes(self, run: Path) -> bool:
        return self.resume and (run / "run.json").is_file()

    def _start(self, scene: bpy.types.Scene) -> Job:
        dataset, run = self._folders()
        place = result_import.place_of(scene, scene.irgspp.source, scene.irgspp.pack)
        on_done = "import_result" if self.import_result and not self.wait else None
        save_masks()  # else the reconstruction would read them without what was painted last
        return jobs.start(
            "reconstruct", translated("Reconstruct {name}", name=dataset.name), run, self._arguments(scene, dataset, run), on_done, place
        )

    def _arguments(self, scene: bpy.types.Scene, dataset: Path, run: Path) -> list[str]:
        words = ["reconstruct", str(dataset), "-o", str(run)]
        if self._resumes(run):
            return [*words, "--resume"]  # with the settings that it was started with
        if (run / "run.json").is_file() and not self.overwrite:
            raise InputError(run, "holds another run", "resume it, overwrite it, or name another folder")
        words += ["--preset", self.preset, "--materials", self.materials, "--device", self.device, "--seed", str(self.seed)]
        panel = scene.irgspp
        words += capture_words(panel.capture_marker, panel.capture_turntable) if find_bare_photographs(dataset) else []
        words += [word for setting in bound_settings(scene, dataset) for word in ("--set", setting)]
        return words + set_words(self.settings) + (["--overwrite"] if self.overwrite else [])


def reconstruct_cut(job: Job) -> None:
    """Reconstruct a capture whose object was cut out for it."""
    with result_import.started_from(job, f"reconstruct {job.folder} there") as scene:
        use_capture(scene, job, wait=False)
        bpy.ops.irgspp.reconstruct("EXEC_DEFAULT", True, was_cut=True, wait=False, **job.data["options"])


class IRGSPP_OT_demo(Queued, bpy.types.Operator):
    """Reconstruct the small dataset that comes with the extension, to check that everything works."""

    bl_idname = "irgspp.demo"
    bl_label = "Run Demonstration"

    folder: StringProperty(name="Run Folder", description="Folder for the results", subtype="DIR_PATH", options=SKIP)
    preset: EnumProperty(**{**shared.PRESET, "items": shared.PRESETS[:2], "default": "draft"}, options=SKIP)
    settings: StringProperty(name="Settings", description="Single settings, as key=value separated by spaces", options=SKIP)
    import_result: BoolProperty(**IMPORT)
    wait: BoolProperty(**WAIT)

    @refusing(RuntimeError)
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the reconstruction as a job."""
        panel = context.scene.irgspp
        run = Path(bpy.path.abspath(self.folder)).absolute() if self.folder else demo_folder()
        words = ["demo", "-o", str(run), "--preset", self.preset, *set_words(self.settings)]
        on_done = "import_result" if self.import_result and not self.wait else None
        place = result_import.place_of(context.scene, panel.source, panel.pack)
        job = jobs.start("demo", translated("Demonstration"), run, words, on_done, place)
        if not self.wait:
            return {"FINISHED"}
        ended = run_to_end(self, job)
        if ended == {"FINISHED"} and self.import_result:
            return import_now(context.scene, run)
        return ended


def demo_folder() -> Path:
    """Return the default run folder of the demo."""
    return jobs.jobs_folder().parent / "demo"


def import_now(scene: bpy.types.Scene, run: Path) -> set[str]:
    """Import a finished run with the options of the panel, and return the status of that operator.

    Args:
        scene: with the panel's settings.
        run: run folder.
    """
    return bpy.ops.irgspp.import_run(directory=str(run), material=scene.irgspp.source, pack=scene.irgspp.pack)


def register() -> None:
    """Register the function that a finished cut calls."""
    jobs.ON_DONE["reconstruct_cut"] = reconstruct_cut


def unregister() -> None:
    """Unregister it."""
    jobs.ON_DONE.pop("reconstruct_cut", None)
