# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstruction: images -> Gaussians (first stage) -> surface -> light and materials (second stage) -> textured mesh -> files."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from .assets.blend_file import write_blend
from .assets.fitted_textures import fitted_textures, texture_line
from .assets.mesh_files import save_mesh_files
from .capture.chosen_sphere import chosen_sphere
from .capture.second_cut import MAX_CUTS, cut_again, edges_settled, support_plane_of
from .capture.source import needs_capture
from .datasets.demo import DEMO_DATA, DEMO_OVERRIDES  # noqa: F401 (offered to callers of `reconstruct`)
from .datasets.load import load_dataset
from .detail.albedo_detail import detailed_by_dataset
from .errors import InputError
from .evaluation.contact_sheet import contact_sheet
from .evaluation.view_metrics import radiance_psnr
from .io.run_files import CAPTURE, check_claim
from .machine.blender_process import NoBlender
from .machine.compilation import compilation_announced
from .machine.cpu_memory import check_texture_memory
from .machine.devices import ChosenDevice, computing_on
from .machine.disk_space import check_disk_space
from .machine.job_time import estimate_seconds, in_words, record_job
from .machine.peak_memory import peak_memory, reset_peak_memory
from .machine.texture_size import TextureSize, check_textures, choose_texture_size
from .progress.protocol import Progress, Silent
from .progress.recorder import ProgressRecorder
from .relight.backends import best_backend, open_relighter
from .relight.relight_settings import RelightSettings
from .rendering.gbuffer_cache import GBufferCache
from .rendering.trusted_device import trusted_device
from .run_folder import RunFolder, read_run
from .scene.camera_files import save_cameras
from .scene.dataset import Dataset
from .scene.reconstruction import Reconstruction
from .scene.surface import Surface
from .settings import overrides
from .settings.schema import Settings, paced
from .settings.sizes import with_sizes, with_texture_size
from .stages.common.memory_layout import MemoryLayout, fit_into_memory
from .stages.common.pixel_rays import with_needed_rays
from .stages.common.preview import surface_shape
from .stages.common.time_budget import AFTER_FUSION_RATIO
from .stages.first.quick_fit import quick_renderings
from .stages.first.train import train
from .stages.phase_results import FIRST_STAGE, GEOMETRY, MASKS, UNWRAP, PhaseResults
from .stages.second.joint.solve import check_joint, has_moved
from .stages.second.solve import solve_second_stage
from .stages.second.solver.transfer_tracing import rays_at_a_time
from .surface.extraction import extract_geometry
from .surface.normal_source import run_normal_source
from .surface.texturing import textured_mesh
from .surface.unwrap_process import UnwrapProcess

SPHERE_FIX = "cut a capture out again by irgspp capture DATASET --sphere; of other datasets set data.centre, data.radius"
NO_MASKS = "no masks: the surroundings are reconstructed, too; irgspp capture DATASET -o NEW cuts the object out first"
COMPILING = "compiles kernels for this processor, once per version"


def reconstruct(
    dataset: Path, run: Path, settings: Settings, *, resume: bool = False, overwrite: bool = False, progress: Progress | None = None
) -> Path:
    """Reconstruct a dataset into a run folder and return the folder; its run.json records the outcome, errors included.

    Args:
        dataset: folder or file of posed images; or bare photographs or a video, which are captured into the run folder first.
        run: folder to write.
        settings: of the job.
        resume: continue the run in the folder from its last checkpoints; the result is that of an uninterrupted run.
        overwrite: replace the run in the folder.
        progress: receives the progress and may cancel the job; None for neither.

    Raises:
        InputError: bad input, before anything is written.
        Cancelled: `progress.cancelled` turned True.
        IrgsppError: any other failure.
    """
    watcher = progress or Silent()
    overrides.check(settings)
    chosen = trusted_device(settings.device, watcher.message)
    check_claim(run, resume, overwrite)
    began = time.monotonic()
    reset_peak_memory()
    bare = needs_capture(dataset)
    check_textures(run, settings)  # before photographs are read or captured, which takes minutes
    recorded = _recorded_size(run) if resume else None
    ready = None if bare else _read(dataset, run, settings, chosen, watcher, recorded)  # bad input is refused before anything is written
    if bare:
        chosen_sphere(settings.capture)
    elif settings.capture.centre is not None or settings.capture.radius is not None:
        raise InputError("capture.centre, capture.radius", "are for photographs without cameras, which this dataset has", SPHERE_FIX)
    recut = partial(_recut, dataset, run, settings, watcher)
    folder = RunFolder.open(run, settings, str(dataset.resolve()), resume=resume, overwrite=overwrite, recut=recut)
    settings = paced(settings)
    try:
        with folder.job():
            folder.state["computed_on"] = {"device": str(chosen.device), "why": chosen.why}
            recorder, earlier = ProgressRecorder(folder, watcher), folder.spent
            if bare:
                _capture(dataset, folder, settings, recorder)
            data, memory, size = ready or _read(run / CAPTURE, run, settings, chosen, recorder, _recorded_size(run))
            folder.state.setdefault("textures", {"size": size.size, "why": size.why})
            recorder.message(size.line())
            if not (data.has_alpha or data.format == "capture"):
                recorder.message(NO_MASKS)
            plain = min(settings.surface.tile_texels, size.size)
            settings = with_sizes(settings, data.object_pixels if data.has_alpha else None)
            settings = with_texture_size(settings, size.size)
            timed = chosen.device.type == "cpu" and not earlier  # GPUs were not measured, and a resumed job has done a part before
            if timed and (seconds := estimate_seconds(settings, data)) is not None:
                recorder.message(f"takes about {in_words(seconds)}")
            announced = compilation_announced(lambda: recorder.message(COMPILING))
            with computing_on(chosen, resumable=True), rays_at_a_time(memory.rays), announced:
                deadline = None if settings.time is None else began + settings.time - earlier
                folder.record("read", time.monotonic() - began - (folder.spent - earlier), peak_memory(), finished=True)
                results = PhaseResults(folder, chosen.device)
                job = Job(data, folder, settings, recorder, results, deadline, memory.resident, plain)
                job.run()
            if timed:
                _keep_time(settings, data, folder.spent - folder.seconds("capture"), recorder)
    finally:
        folder.close()
    return run


def _keep_time(settings: Settings, data: Dataset, seconds: float, progress: Progress) -> None:
    """Keep how long the job took for the estimates of the next ones; a disk that refuses costs no finished job."""
    try:
        record_job(settings, data, seconds)
    except OSError as error:
        progress.message(f"the time of this job is not kept for later estimates: {error}")


def _recut(photographs: Path, run: Path, settings: Settings, progress: Progress) -> None:
    """Cut the object of a captured run out again by another sphere; the poses are kept."""
    from .capture.capture import capture

    if (run / CAPTURE).exists():  # else the run was stopped before it
        capture(photographs, run / CAPTURE, settings.capture, settings.seed, progress)


def _capture(photographs: Path, folder: RunFolder, settings: Settings, progress: ProgressRecorder) -> None:
    """Run the phase that captures photographs without cameras into the run folder."""
    from .capture.capture import capture  # COLMAP and the readers of videos and raw images, which other jobs do without

    def work() -> None:
        capture(photographs, folder.path / CAPTURE, settings.capture, settings.seed, progress)

    folder.run_phase("capture", work, progress)


def _recorded_size(run: Path) -> TextureSize | None:
    """Return the texture size that an earlier start of a run chose, which may have had more memory; None where run.json has none."""
    textures = read_run(run).get("textures") if (run / "run.json").is_file() else None
    return TextureSize(textures["size"], textures["why"]) if textures else None


def _read(
    dataset: Path, run: Path, settings: Settings, device: ChosenDevice, progress: Progress, size: TextureSize | None
) -> tuple[Dataset, MemoryLayout, TextureSize]:
    """Load a dataset, choose the texture size unless it is given, and check that the job fits on the disk and into memory."""
    data = load_dataset(dataset, settings.data, progress)
    settings = with_sizes(settings, data.object_pixels if data.has_alpha else None)
    if settings.second.solver != "closed":
        check_joint(data)
    size = size or choose_texture_size(settings, data, run)
    settings = with_texture_size(settings, size.size)
    check_disk_space(run, settings, data.pixels(distorted=True))
    memory = fit_into_memory(data, settings, device, progress)
    check_texture_memory(settings.surface.texels, data.pixels(), data.full_size_pixels)
    return data, memory, size


@dataclass
class Job:
    """Phases of one reconstruction; each reads its input from the run folder, so that a resumed run can start with any of them."""

    data: Dataset
    folder: RunFolder
    settings: Settings
    progress: ProgressRecorder
    results: PhaseResults
    deadline: float | None  # seconds on the monotonic clock
    resident: bool  # the training images stay on the device
    plain_texels: int  # along a side of textures without detail of the full-size photographs
    unwrapping: UnwrapProcess | None = None  # of the surface, beside the second stage

    def run(self) -> None:
        """Run all unfinished phases in order."""
        try:
            self._run_phases()
        finally:
            if self.unwrapping is not None:
                self.unwrapping.close()

    def _run_phases(self) -> None:
        for warning in self.data.warnings:
            self.progress.message(f"warning: {warning}")
        if self._masks_may_be_wrong():
            self.folder.run_phase("masks", self.masks, self.progress)
            self.data = self.results.with_masks(self.data)
        self.settings = with_needed_rays(self.settings, self.data, self.progress)
        self.folder.run_phase("first stage", self.first_stage, self.progress)
        self.folder.run_phase("geometry", self.geometry, self.progress)
        self.folder.run_phase("second stage", self.second_stage, self.progress)
        self.folder.run_phase("surface", self.surface, self.progress)
        self.folder.run_phase("scene", self.scene, self.progress)
        self.folder.run_phase("contact sheet", self.sheet, self.progress)

    def _masks_may_be_wrong(self) -> bool:
        """Return True for masks that a capture found, of an object that stands still on a support plane."""
        views = self.data.train
        wrong = all(view.alpha is not None and round(view.mask_error) >= 1 for view in views)
        return wrong and not self.data.turns and support_plane_of(self.data.surroundings) is not None

    def masks(self) -> None:
        """Cut the object out again, with the outlines and colours on which a quick fit finds the photographs to agree."""
        plane = support_plane_of(self.data.surroundings)
        assert plane is not None
        before = views = self.data.train
        for _ in range(MAX_CUTS):
            before = [replace(first, alpha=one.alpha) for first, one in zip(self.data.train, views, strict=True)]
            rendered = quick_renderings(replace(self.data, train=before), self.settings, self.progress)
            views = cut_again(before, rendered, plane, self.data.bound)
            if edges_settled(before, views):
                break
        kept = sum(after is one for after, one in zip(views, before, strict=True))
        if kept:
            self.progress.message(f"{kept} of {len(views)} masks are kept as they were: the second cut would change them too much")
        self.folder.save(MASKS, {view.name: (view.alpha, view.mask_error, view.cut_by_colours) for view in views})

    def first_stage(self) -> None:
        """Fit Gaussians, their radiance and initial materials and light to the training images."""
        fitted, scale = train(self.data, self.settings, self.progress, self.folder, self.deadline, self.results.device, self.resident)
        self.folder.state.setdefault("pace", {})["first"] = round(self.settings.pace * scale, 3)
        fitted.save(self.folder.path / FIRST_STAGE)
        self.folder.state["training"].update(self.progress.metrics)

    def geometry(self) -> None:
        """Extract a surface without textures from the Gaussians' depth."""
        surface = self._surface_of(self.results.first_stage)
        self.folder.save(GEOMETRY, surface.state())
        self.progress.shape(lambda: surface_shape(surface, self.data), at_once=True)

    def _surface_of(self, reconstruction: Reconstruction) -> Surface:
        """Fuse the depth of a reconstruction in all training views to a surface."""
        data = self.data
        masks = [view.alpha for view in data.train if view.alpha is not None] if data.has_alpha else None
        samples, views = reconstruction.surface_samples(), GBufferCache(reconstruction, [view.camera for view in data.train])
        return extract_geometry(views, samples, reconstruction.bound, self.settings.surface, self.progress, masks)

    def second_stage(self) -> None:
        """Solve the rendering equation, shadows and interreflections included, for materials and light."""
        deadline = None if self.deadline is None else self.deadline - AFTER_FUSION_RATIO * self.folder.seconds("geometry")
        first, surface, textures = self.results.first_stage, self.results.surface, self.settings.surface
        if self.settings.second.solver == "closed" and not self.folder.finished("surface"):  # the mesh stays as it is
            self.unwrapping = UnwrapProcess(surface, textures.texels, self.folder.path / UNWRAP, textures.udim_tiles)
        solved = solve_second_stage(first, surface, self.data, self.settings, self.progress, deadline, self.folder)
        self.folder.state.setdefault("pace", {})["second"] = round(self.settings.pace * solved.schedule_scale, 3)
        solved.save(self.folder.path)

    def surface(self) -> None:
        """Unwrap the surface, bake the Gaussians' materials onto it, and add the photographs' detail to its albedo."""
        solved, cameras = self.results.reconstruction, [view.camera for view in self.data.train]
        samples, views = solved.surface_samples(), GBufferCache(solved, cameras)
        moved = self.settings.second.solver != "closed" and has_moved(solved, self.results.first_stage)
        surface = self._surface_of(solved) if moved else self.results.surface
        normals = run_normal_source(self.folder.path, self.settings.surface.detail, cameras)
        mesh = textured_mesh(surface, views, samples, self.settings.surface, self.progress, self.unwrapping, normals)
        named = {view.name: view for view in self.data.train}
        mesh, report = detailed_by_dataset(mesh, solved, self.data.path, named, self.settings, self.progress)
        self.folder.state["albedo_detail"] = report.state()
        why = self.folder.state["textures"]["why"]
        mesh, self.folder.state["textures"] = fitted_textures(mesh, report, self.plain_texels, why, self.settings.surface.udim_tiles)
        self.progress.message(texture_line(self.folder.state["textures"]))
        save_mesh_files(mesh, self.folder.path, self.settings.surface.udim_tiles)

    def scene(self) -> None:
        """Write the Blender file: object, light, and cameras with their photographs."""
        save_cameras(self.folder.path / "cameras.json", self.data)
        self.progress.phase("scene", 0)
        try:
            write_blend(self.folder.path, self.folder.path / "scene.blend", self.settings.export.material, self.progress)
        except NoBlender as error:
            self.folder.skip("scene.blend", str(error))
            self.progress.message(f"no scene.blend: {error}")

    def sheet(self) -> None:
        """Measure the PSNR of the test views and draw the contact sheet."""
        solved, run = self.results.reconstruction, self.folder.path
        if self.data.test:
            self.folder.state["training"]["test_radiance_psnr"] = round(radiance_psnr(solved, self.data.test), 3)
        relighter = open_relighter(run, solved, best_backend(run), RelightSettings(samples="efficient"))
        contact_sheet(self.data, relighter, run / "contact_sheet.png", self.progress)
