# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs to a run folder: as a job from the panel, to its end from scripts."""

# pyright: reportInvalidTypeForm=false

import shlex
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..core.errors import InputError, IrgsppError
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs import result_import
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.properties import DEVICES, MATERIALS, PRESETS
from .blocking import IMPORT, SKIP, WAIT, Queued, refuse, run_to_end


class IRGSPP_OT_reconstruct(bpy.types.Operator):
    """Make a relightable object out of the photographs, in the background. What is not given is taken from the scene's IRGS++ panel"""

    bl_idname = "irgspp.reconstruct"
    bl_label = "Reconstruct"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    dataset: StringProperty(name="Photographs", description="Folder of photographs with known cameras", subtype="DIR_PATH", options=SKIP)
    run: StringProperty(
        name="Run Folder",
        description="Folder to write; empty: beside the photographs, named like them with _irgspp",
        subtype="DIR_PATH",
        options=SKIP,
    )
    preset: EnumProperty(name="Preset", description="How much work is done", items=PRESETS, default="balanced", options=SKIP)
    materials: EnumProperty(name="Material", description="What the object is made of", items=MATERIALS, options=SKIP)
    device: EnumProperty(name="Device", description="What computes", items=DEVICES, options=SKIP)
    seed: IntProperty(name="Seed", description="Of every random choice", min=0, options=SKIP)
    settings: StringProperty(name="Settings", description="Single settings, as key=value with spaces between", options=SKIP)
    resume: BoolProperty(name="Resume", description="Go on with the run in the folder, with its own settings", options=SKIP)
    overwrite: BoolProperty(name="Overwrite", description="Replace the run in the folder", options=SKIP)
    import_result: BoolProperty(**IMPORT)
    wait: BoolProperty(**WAIT)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.wait = bpy.app.background
        if self.overwrite and not self.wait:
            words = {"title": "Reconstruct again?", "message": "The run in the folder is replaced", "confirm_text": "Replace"}
            return context.window_manager.invoke_confirm(self, event, icon="WARNING", **words)
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        self._take_from_scene(context.scene)
        try:
            job = self._start(context.scene)
            if not self.wait:
                self.report({"INFO"}, f"{job.title}: {job.state}")
                return {"FINISHED"}
            ended = run_to_end(self, job)
            if ended == {"FINISHED"} and self.import_result:
                return import_now(context.scene, job.folder)
            return ended
        except (IrgsppError, RuntimeError) as error:
            return refuse(self, error)

    def _take_from_scene(self, scene: bpy.types.Scene) -> None:
        """What the caller didn't say is as the panel says."""
        panel, given = scene.irgspp, self.properties.is_property_set
        for name in ("preset", "materials", "device", "seed", "import_result"):
            if not given(name):
                setattr(self, name, getattr(panel, name))
        if not given("settings"):
            self.settings = panel.overrides
        if not given("dataset"):
            self.dataset = str(panel.dataset_path() or "")
            self.run = self.run if given("run") else bpy.path.abspath(panel.run)

    def _start(self, scene: bpy.types.Scene) -> Job:
        if not self.dataset:
            raise InputError("photographs", "no folder is chosen", "choose one in the panel, or give dataset=")
        dataset = Path(bpy.path.abspath(self.dataset)).absolute()
        if not dataset.exists():
            raise InputError(dataset, "no such folder", "it may have been moved; choose it again")
        run = Path(bpy.path.abspath(self.run)).absolute() if self.run else dataset.with_name(f"{dataset.name}_irgspp")
        place = result_import.place_of(scene, scene.irgspp.source, scene.irgspp.pack)
        wish = "import_result" if self.import_result and not self.wait else None
        return jobs.start("reconstruct", f"Reconstruct {dataset.name}", run, self._words(dataset, run), wish, place)

    def _words(self, dataset: Path, run: Path) -> list[str]:
        words = ["reconstruct", str(dataset), "-o", str(run)]
        if self.resume and (run / "run.json").is_file():
            return [*words, "--resume"]  # with the settings that it was started with
        if (run / "run.json").is_file() and not self.overwrite:
            raise InputError(run, "holds another run", "resume it, overwrite it, or name another folder")
        words += ["--preset", self.preset, "--materials", self.materials, "--device", self.device, "--seed", str(self.seed)]
        return words + set_words(self.settings) + (["--overwrite"] if self.overwrite else [])


class IRGSPP_OT_demo(Queued, bpy.types.Operator):
    """Reconstruct the small dataset that comes with the extension, to see that everything works"""

    bl_idname = "irgspp.demo"
    bl_label = "Run Demonstration"

    folder: StringProperty(name="Run Folder", description="Folder to write", subtype="DIR_PATH", options=SKIP)
    settings: StringProperty(name="Settings", description="Single settings, as key=value with spaces between", options=SKIP)
    import_result: BoolProperty(**IMPORT)
    wait: BoolProperty(**WAIT)

    def execute(self, context: bpy.types.Context) -> set[str]:
        panel = context.scene.irgspp
        try:
            run = Path(bpy.path.abspath(self.folder)).absolute() if self.folder else demo_folder()
            words = ["demo", "-o", str(run), *set_words(self.settings)]
            wish = "import_result" if self.import_result and not self.wait else None
            place = result_import.place_of(context.scene, panel.source, panel.pack)
            job = jobs.start("demo", "Demonstration", run, words, wish, place)
            if not self.wait:
                return {"FINISHED"}
            ended = run_to_end(self, job)
            if ended == {"FINISHED"} and self.import_result:
                return import_now(context.scene, run)
            return ended
        except (IrgsppError, RuntimeError) as error:
            return refuse(self, error)


def set_words(settings: str) -> list[str]:
    """The command line's words for `key=value key=value`. Raises InputError where quotation marks don't match."""
    try:
        return [word for setting in shlex.split(settings) for word in ("--set", setting)]
    except ValueError as error:
        raise InputError(f"settings {settings!r}", f"can't be read ({error})", "write key=value, with spaces between") from error


def demo_folder() -> Path:
    """Where the demonstration goes by itself."""
    return jobs.jobs_folder().parent / "demo"


def import_now(scene: bpy.types.Scene, run: Path) -> set[str]:
    """The result into the scene, as the panel says."""
    return bpy.ops.irgspp.import_run(directory=str(run), material=scene.irgspp.source, pack=scene.irgspp.pack)
