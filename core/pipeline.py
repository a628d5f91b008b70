# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job: photographs -> Gaussians -> surface -> light and materials -> textured mesh -> files, one phase after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from .assets.export import write_blend
from .datasets.load import load_dataset
from .errors import Cancelled, InputError, IrgsppError
from .evaluation.contact_sheet import contact_sheet
from .evaluation.metrics import on_black, psnr
from .machine.blender_process import NoBlender
from .machine.cpu_memory import MOST_RAYS, rays_that_fit
from .machine.devices import Chosen, choose, computing_on
from .machine.disk_space import check_disk_space
from .machine.gpu_memory import plan
from .machine.peak_memory import peak_memory, reset_peak_memory
from .progress.protocol import Progress, Silent
from .progress.recorder import ProgressRecorder
from .relight.backends import best_backend, open_relighter
from .relight.relighter import RelightSettings
from .rendering.gbuffer import render_gbuffer
from .rendering.gbuffer_cache import GBufferCache
from .run_folder import RunFolder, check_claim
from .scene.camera_files import save_cameras
from .scene.dataset import Dataset, View
from .scene.glb import save_glb
from .scene.mesh_ply import save_mesh_ply
from .scene.reconstruction import Reconstruction
from .scene.surface import Surface
from .scene.textures import save_textures
from .settings import overrides
from .settings.schema import Settings
from .stages.common.time_budget import FUSED
from .stages.first.train import train
from .stages.second.radiance_transfer import rays_at_a_time
from .stages.second.solve import solve_second_stage
from .surface.extraction import extract_geometry
from .surface.texturing import textured_mesh

CPU = torch.device("cpu")
FIRST_STAGE = Path("checkpoint", "first")  # in the run folder: what the first stage found, until the job is done
GEOMETRY = "geometry"  # checkpoint of the bare surface
SHEET_SAMPLES = "efficient"

DEMO_DATA = Path(__file__).parent / "demo_data"
# What 64x64 images can carry.
DEMO_OVERRIDES = ("first.gaussians=10000", "surface.voxels=96", "surface.triangles=10000", "surface.texture=512")


def reconstruct(
    dataset: Path, run: Path, settings: Settings, *, resume: bool = False, overwrite: bool = False, progress: Progress | None = None
) -> Path:
    """Reconstruct a dataset into a run folder and return the folder.

    `resume` goes on with the run that is there: finished phases are not done again, the others start from their last checkpoint,
    and the result is that of a run never stopped. `overwrite` replaces it.

    Raises InputError for bad input, before anything is written; Cancelled where `progress.cancelled` turned True; IrgsppError for
    what else can't be done. run.json says the same afterwards.
    """
    watcher = progress or Silent()
    overrides.check(settings)
    chosen = choose(settings.device)
    check_claim(run, resume, overwrite)
    began = time.monotonic()
    reset_peak_memory()
    data = load_dataset(dataset, settings.data, watcher)
    check_disk_space(run, settings, data.pixels(distorted=True))
    resident = keeps_photographs(data, settings, chosen)
    rays = rays_that_fit(settings, data.pixels()) if chosen.device.type == "cpu" else MOST_RAYS
    if rays < MOST_RAYS:
        watcher.message(f"memory is short: {rays} rays are at work at a time instead of {MOST_RAYS}, which takes longer")
    folder = RunFolder.open(run, settings, str(dataset.resolve()), resume=resume, overwrite=overwrite)
    try:
        with folder.job(), computing_on(chosen, resumable=True), rays_at_a_time(rays):
            folder.state["computed_on"] = {"device": str(chosen.device), "why": chosen.why}
            ends = None if settings.time is None else began + settings.time - folder.spent
            folder.record("read", time.monotonic() - began, peak_memory(), finished=True)
            Job(data, folder, settings, ProgressRecorder(folder, watcher), ends, chosen.device, resident).run()
    finally:
        folder.close()
    return run


def keeps_photographs(data: Dataset, settings: Settings, chosen: Chosen) -> bool:
    """Whether they stay on the device during the first stage. Raises InputError where a GPU's memory is too little for the job."""
    if chosen.device.type == "cpu":
        return True
    width, height = (max(getattr(view.camera, side) for view in data.train) for side in ("width", "height"))
    return plan(settings, len(data.train), width, height, chosen.free).targets


@dataclass
class Job:
    """The phases of one reconstruction. Each reads what the ones before left in the folder, so that each can be the first after a stop."""

    data: Dataset
    folder: RunFolder
    settings: Settings
    progress: ProgressRecorder
    ends: float | None = None  # seconds of the monotonic clock
    device: torch.device = CPU
    resident: bool = True  # photographs stay on the device

    def run(self) -> None:
        """All phases that are not done yet, in order."""
        for warning in self.data.warnings:
            self.progress.message(f"warning: {warning}")
        self._phase("first stage", self.fit)
        self._phase("geometry", self.shape)
        self._phase("second stage", self.separate)
        self._phase("surface", self.mesh)
        self._phase("scene", self.scene)
        self._phase("contact sheet", self.sheet)

    def fit(self) -> None:
        """First stage: Gaussians, their radiance and a first guess of materials and light from the photographs."""
        fitted, pace = train(self.data, self.settings, self.progress, self.folder, self.ends, self.device, self.resident)
        self.folder.state.setdefault("pace", {})["first"] = round(pace, 3)
        fitted.save(self.folder.path / FIRST_STAGE)
        self.folder.state["training"].update(self.progress.figures)

    def shape(self) -> None:
        """Gaussians to a bare surface."""
        samples, masks = self.first.surface_samples(), [view.alpha for view in self.data.train if view.alpha is not None]
        known = masks if self.data.has_alpha else None
        surface = extract_geometry(self._views(self.first), samples, self.first.bound, self.settings.surface, self.progress, known)
        self.folder.save(GEOMETRY, surface.state())

    def separate(self) -> None:
        """Second stage: materials and light, by all the light that reaches the surface."""
        after = FUSED * self.folder.seconds("geometry")
        ends = None if self.ends is None else self.ends - after
        solved, pace = solve_second_stage(self.first, self.surface, self.data, self.settings, self.progress, ends)
        self.folder.state.setdefault("pace", {})["second"] = round(pace, 3)
        solved.save(self.folder.path)

    def mesh(self) -> None:
        """Surface and Gaussians to a mesh with textures."""
        samples = self.reconstruction.surface_samples()
        mesh = textured_mesh(self.surface, self._views(self.reconstruction), samples, self.settings.surface, self.progress)
        save_mesh_ply(mesh, self.folder.path / "mesh.ply")
        save_textures(mesh.textures, self.folder.path / "textures")
        save_glb(mesh, self.folder.path / "asset.glb")

    def scene(self) -> None:
        """The Blender file: object, light, cameras with their photographs."""
        save_cameras(self.folder.path / "cameras.json", self.data)
        self.progress.phase("scene", 0)
        try:
            write_blend(self.folder.path, self.folder.path / "scene.blend", self.settings.export.material, self.progress)
        except NoBlender as error:
            self.folder.skip("scene.blend", str(error))
            self.progress.message(f"no scene.blend: {error}")

    def sheet(self) -> None:
        """One image that shows what came out, and how well the test views are met."""
        if self.data.test:
            self.folder.state["training"]["test_radiance_psnr"] = round(radiance_psnr(self.reconstruction, self.data.test), 3)
        backend, how = best_backend(self.folder.path), RelightSettings(samples=SHEET_SAMPLES)
        relighter = open_relighter(self.folder.path, self.reconstruction, backend, how)
        contact_sheet(self.data, relighter, self.folder.path / "contact_sheet.png", self.progress)

    # What the phases left on disk: read back even right after it, so that a resumed run goes on from the very same numbers.

    @cached_property
    def first(self) -> Reconstruction:
        """Of the first stage."""
        return Reconstruction.load(self.folder.path / FIRST_STAGE).to(self.device)

    @cached_property
    def surface(self) -> Surface:
        """The bare surface."""
        surface = self.folder.load(GEOMETRY, Surface.restored)
        if surface is None:
            raise InputError(self.folder.path / "checkpoint", f"lacks {GEOMETRY}.pt", "start anew with --overwrite")
        return surface

    @cached_property
    def reconstruction(self) -> Reconstruction:
        """Of both stages."""
        return Reconstruction.load(self.folder.path).to(self.device)

    def _views(self, reconstruction: Reconstruction) -> GBufferCache:
        return GBufferCache(reconstruction, [view.camera for view in self.data.train])

    def _phase(self, name: str, work: Callable[[], None]) -> None:
        if self.folder.finished(name):
            self.progress.message(f"{name}: done before")
            return
        if self.progress.cancelled:
            raise Cancelled(f"stopped before the phase {name}")
        try:
            with self.folder.timed(name):
                work()
        except IrgsppError as error:
            if self.progress.cancelled and not isinstance(error, Cancelled):  # Ctrl-C also ends child processes
                raise Cancelled(f"stopped in the phase {name}") from error
            raise


def radiance_psnr(reconstruction: Reconstruction, views: Sequence[View]) -> float:
    """Mean PSNR in dB of the Gaussians' own radiance against photographs, both encoded, on black by their own alpha."""
    values = []
    for view in views:
        rgba = render_gbuffer(reconstruction, view.camera).image
        alpha = 1.0 if view.alpha is None else view.alpha[..., None]
        values.append(psnr(on_black(rgba), np.clip(view.colour, 0, 1) * alpha))
    return float(np.mean(values))
