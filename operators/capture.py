# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for photographs without cameras: find their cameras, choose a video."""

# pyright: reportInvalidTypeForm=false

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..core.errors import InputError
from ..irgspp_addon import shared_properties as shared
from ..irgspp_addon.importer.capture_file import FILE, CaptureSummary, read_capture
from ..irgspp_addon.importer.dataset_import import checked
from ..irgspp_addon.importer.mask_image import save_masks
from ..irgspp_addon.importer.object_sphere import cut_settings
from ..irgspp_addon.importer.photographs import find_bare_photographs
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs import result_import
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.properties import VIDEOS, beside, set_quietly
from ..irgspp_addon.translations import translated
from .blocking import IMPORT, SKIP, WAIT, Queued, refusing, run_to_end
from .command_words import capture_words, set_words
from .file_dialog import FileDialog

NAMED = 3  # photographs left out that a report names


class IRGSPP_OT_capture(Queued, bpy.types.Operator):
    """Find the cameras of photographs or of a video, cut the object out, and import cameras, points and the object's sphere."""

    bl_idname = "irgspp.capture"
    bl_label = "Find Cameras"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    directory: StringProperty(
        name="Photographs",
        description="Folder of photographs, a video, a dataset with cameras and without masks, or a capture that was stopped",
        subtype="DIR_PATH",
        options=SKIP,
    )
    output: StringProperty(
        name="Captured Dataset",
        description="Folder for cameras, undistorted photographs and masks. Empty: next to the photographs, with their name and _capture",
        subtype="DIR_PATH",
        options=SKIP,
    )
    marker: FloatProperty(
        name="Marker", description="Side of the black square of a printed marker, in metres; 0: no marker", min=0.0, options=SKIP
    )
    turntable: EnumProperty(**shared.TURNED, options=SKIP)
    seed: IntProperty(name="Seed", description="Seed of all random numbers", min=0, options=SKIP)
    settings: StringProperty(name="Settings", description="Single settings, as capture.key=value separated by spaces", options=SKIP)
    import_result: BoolProperty(**IMPORT)
    wait: BoolProperty(**WAIT)

    @refusing(RuntimeError)
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the capture as a job."""
        self._take_from_scene(context.scene)
        job = self._start(context.scene)
        ended = run_to_end(self, job) if self.wait else {"FINISHED"}
        if self.wait and ended == {"FINISHED"} and self.import_result:
            use_capture(context.scene, job, wait=True)
            self.report({"INFO"}, found(read_capture(job.folder)))
        return ended

    def _take_from_scene(self, scene: bpy.types.Scene) -> None:
        """Take the options that the caller did not give from the panel."""
        panel, given = scene.irgspp, self.properties.is_property_set
        if not given("marker"):
            self.marker = panel.capture_marker
        if not given("turntable"):
            self.turntable = panel.capture_turntable
        if not given("seed"):
            self.seed = panel.seed
        if not given("settings"):
            self.settings = " ".join(word for word in panel.overrides.split() if word.startswith("capture."))
        if not given("directory"):
            self.directory = str(panel.dataset_path() or "")

    def _start(self, scene: bpy.types.Scene) -> Job:
        source = checked(self.directory)
        stopped = read_capture(source)
        if stopped is not None and stopped.status == "broken":
            raise InputError(source / FILE, "can't be read", "choose the photographs, and name another folder or delete this one")
        if moved := cut_settings(scene, source, stopped):
            return start_cut(scene, source, moved, "import_capture" if self.import_result and not self.wait else None)
        if stopped is not None:  # the folder of a capture that goes on
            source, folder = checked(stopped.source), source
        else:
            folder = Path(bpy.path.abspath(self.output)).absolute() if self.output else beside(source, "_capture")
        words = ["capture", str(source), "-o", str(folder), "--seed", str(self.seed)]
        words += [*capture_words(self.marker, self.turntable), *set_words(self.settings)]
        data = {**result_import.place_of(scene), "source": str(source), "run": str(folder)}
        on_done = "import_capture" if self.import_result and not self.wait else None
        title = "Find cameras of {name}" if find_bare_photographs(source) else "Cut out the object of {name}"
        return jobs.start("capture", translated(title, name=source.name), folder, words, on_done, data)


def start_cut(scene: bpy.types.Scene, folder: Path, moved: list[str], on_done: str | None, data: dict[str, Any] | None = None) -> Job:
    """Start the job that cuts the object of a finished capture out again, with the capture's own options but for the sphere.

    Args:
        scene: from which the job is started.
        folder: folder of the capture.
        moved: the sphere, see `cut_settings`.
        on_done: name of the function that the finished job calls; None for none.
        data: more data for that function.
    """
    options = [word for setting in moved for word in ("--set", setting)]
    return start_change(scene, folder, translated("Cut out the object of {name}", name=folder.name), options, on_done, data)


def start_change(
    scene: bpy.types.Scene, folder: Path, title: str, options: list[str], on_done: str | None, data: dict[str, Any] | None = None
) -> Job:
    """Start the job that makes a finished capture anew with other options.

    Args:
        scene: from which the job is started.
        folder: folder of the capture.
        title: of the job.
        options: those that change, as command-line words.
        on_done: name of the function that the finished job calls; None for none.
        data: more data for that function.
    """
    save_masks()  # what was painted is kept beside the new masks
    data = {**result_import.place_of(scene), "source": str(folder), "run": str(folder), **(data or {})}
    return jobs.start("capture", title, folder, ["capture", str(folder), *options], on_done, data)


def found(capture: CaptureSummary | None) -> str:
    """Return the outcome of a capture in one line: photographs used, and those left out with the reason."""
    if capture is None or capture.status != "done":
        return translated("no cameras were found")
    text = translated("cameras of {count} photographs found", count=capture.used)
    if not capture.left_out:
        return text
    named = "; ".join(f"{name}: {reason}" for name, reason in capture.left_out[:NAMED])
    more = translated("; and {count} more", count=len(capture.left_out) - NAMED) if len(capture.left_out) > NAMED else ""
    return text + translated(", {count} left out", count=len(capture.left_out)) + f" ({named}{more})"


def import_when_captured(job: Job) -> None:
    """Import a captured dataset into the scene that the job was started from."""
    with result_import.started_from(job, f"choose {job.folder} as photographs there") as scene:
        use_capture(scene, job, wait=False)


def use_capture(scene: bpy.types.Scene, job: Job, wait: bool) -> None:
    """Choose the captured dataset in the panel, unless the user has chosen another one meanwhile, and import it.

    Args:
        scene: with the panel's settings.
        job: finished capture.
        wait: return when it is imported.
    """
    panel = scene.irgspp
    chosen = panel.dataset_path()
    if chosen is None or chosen.resolve() in (Path(job.data["source"]), job.folder.resolve()):
        set_quietly(panel, "dataset", str(job.folder))  # the import below inspects it
        panel.inspected = ""
    options = {"up_axis": panel.up_axis, "scale": panel.scale, "recentre": panel.recentre}
    options |= {"photographs": panel.with_photographs, "points": panel.with_points, "wait": wait}
    bpy.ops.irgspp.import_dataset("EXEC_DEFAULT", True, directory=str(job.folder), **options)


class IRGSPP_OT_choose_video(FileDialog, bpy.types.Operator):
    """Choose a video of the object in place of a folder of photographs."""

    bl_idname = "irgspp.choose_video"
    bl_label = "Choose Video"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    filepath: StringProperty(name="Video", description="Video around the object", subtype="FILE_PATH", options=SKIP)
    filter_movie: BoolProperty(default=True, options={"HIDDEN"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN"})

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Choose the video."""
        video = checked(self.filepath)
        if not video.is_file() or video.suffix.lower() not in VIDEOS:
            raise InputError(video, "is not a video", f"choose one that ends with {', '.join(VIDEOS)}")
        context.scene.irgspp.dataset = str(video)
        return {"FINISHED"}


CLASSES = (IRGSPP_OT_capture, IRGSPP_OT_choose_video)


def register() -> None:
    """Register the function that a finished job calls."""
    jobs.ON_DONE["import_capture"] = import_when_captured


def unregister() -> None:
    """Unregister it."""
    jobs.ON_DONE.pop("import_capture", None)
