# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo detail: the albedo texture of a mesh from full-size photographs, with the low frequencies of the working solution."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.quantisation import bits_of, srgb_quantised
from ..io.srgb import decode_srgb
from ..progress.protocol import Progress
from ..relight.mesh_query import MeshQuery
from ..relight.relight_settings import RelightSettings
from ..relight.relighter import Relighter
from ..scene.camera import Camera
from ..scene.camera_files import PlacedCamera
from ..scene.dataset import View
from ..scene.mesh import Mesh
from ..scene.reconstruction import Reconstruction
from ..settings.schema import Choice, Settings
from ..settings.sizes import MIN_SIZE_RATIO, takes_photograph_detail
from ..surface.mesh_texels import mesh_texels
from ..surface.texturing import stoppable
from .alignment import displacement
from .candidates import Candidates, TexelView, add_candidates
from .combination import combine
from .evidence import CLEAR_CORRELATION_GAIN, MIN_CORRELATION_GAIN, Evidence
from .mesh_depth import MeshDepth, render_mesh_depth
from .photographs import FullSizePhotograph, find_full_size_photographs, object_pixels
from .radiometric_correction import fit_correction
from .report import DetailReport
from .sharpness import relative_blur
from .vertex_shading import VertexShading, ViewShading

MIN_PHOTOGRAPHS = 3  # photographs from which albedo can be told from what one of them shows by chance
HELD_BACK_EVERY = 8  # one photograph in so many is held back as evidence
MAX_HELD_BACK = 3  # photographs held back at most
MAX_ALIGNED_TEXTURE = 1024  # largest side of the texture to which photographs are aligned, texels
DEPTH_SIDE = 1600  # longest side of the depth maps that decide visibility, pixels
# Weight of a texel's best photograph from which the texel takes all of its colour from the photographs, as a fraction of the median of
# this weight over the mesh. Below, it is mixed with the working solution.
CERTAIN_WEIGHT_RATIO = 0.3


class AlbedoDetail:
    """Accumulation of photographs into the albedo texture of one mesh.

    Args:
        mesh: mesh with materials and baked textures.
        reconstruction: solved light and materials.

    Attributes:
        candidates: candidates of the texels.
        failed: lines about files that can't be read, by photograph.
    """

    def __init__(self, mesh: Mesh, reconstruction: Reconstruction) -> None:
        self._mesh = mesh
        texture = mesh.textures["albedo"]
        highest = np.iinfo(texture.dtype).max
        self._albedo = decode_srgb(np.arange(highest + 1, dtype=np.float32) / highest)[texture].astype(np.float32)
        self._shading, self._relief = VertexShading(*_lit(mesh, reconstruction)), reconstruction.relief
        self._shaded: dict[str, tuple[ViewShading, float]] = {}
        self._shift: dict[str, np.ndarray] = {}
        self.failed: dict[str, str] = {}
        self._rough: tuple[np.ndarray, np.ndarray] | None = None  # texture to which photographs are aligned
        self._texels = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, len(texture))
        self.candidates = Candidates.empty(len(self._texels.index))

    def align(self, photographs: Sequence[FullSizePhotograph], step: Callable[[int], None]) -> None:
        """Find the displacement of each photograph against a texture that is made of all of them at a lower resolution.

        Args:
            photographs: those that the texture is made from.
            step: called with the number of photographs done; may raise.
        """
        size = min(self._texels.size, MAX_ALIGNED_TEXTURE)
        mesh = self._mesh
        texels = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, size)
        candidates = Candidates.empty(len(texels.index))
        for number, photograph in enumerate(photographs):
            view = self._view(photograph)
            if view is not None:
                add_candidates(view, self._mesh, texels, candidates)
            step(number + 1)
        self._rough = np.zeros((size * size, 3), np.float32), np.zeros(size * size, bool)
        self._rough[0][texels.index] = combine(candidates)
        self._rough[1][texels.index] = candidates.weight.max(1) > 0

    @property
    def plain(self) -> np.ndarray:
        """Albedo (P, 3) of the working solution at the texels."""
        return self._albedo.reshape(-1, 3)[self._texels.index]

    def add(self, photograph: FullSizePhotograph, candidates: Candidates) -> bool:
        """Sample a photograph; return False where it can't be read or too little of the object is seen in it.

        Args:
            photograph: photograph on the disk.
            candidates: candidates that receive the samples.
        """
        view = self._view(photograph)
        if view is None:
            return False
        add_candidates(view, self._mesh, self._texels, candidates)
        return True

    def _view(self, photograph: FullSizePhotograph) -> TexelView | None:
        """Return a photograph ready to be sampled; None where it can't be read or too little of the object is seen in it."""
        try:
            decoded = photograph.load()
        except InputError as error:
            self.failed[photograph.name] = str(error)
            return None
        if photograph.name not in self._shaded:
            self._shaded[photograph.name] = self._shading.seen_by(decoded.camera, photograph.light_rotation), relative_blur(decoded)
        shading, blur = self._shaded[photograph.name]
        correction = fit_correction(decoded, self._mesh, self._albedo, shading)
        if correction is None:
            return None
        view = TexelView(decoded, self._depth(decoded.camera, decoded.lens.size), correction, shading, blur)
        if self._rough is None:
            return view
        if photograph.name not in self._shift:
            albedo, known = self._rough
            size = math.isqrt(len(known))
            images = albedo.reshape(size, size, 3), known.reshape(size, size)
            self._shift[photograph.name] = displacement(decoded, self._mesh, *images, shading, correction)
        return replace(view, shift=self._shift[photograph.name])

    def _depth(self, camera: Camera, full: tuple[int, int]) -> MeshDepth:
        """Return the depth of the mesh at a resolution between that of the camera and of the photograph."""
        longest = max(camera.width, camera.height)
        scale = min(max(full), max(DEPTH_SIDE, longest)) / longest
        return render_mesh_depth(
            self._mesh.vertices, self._mesh.faces, camera.resized(round(camera.width * scale), round(camera.height * scale))
        )

    def add_all(self, photographs: Sequence[FullSizePhotograph], step: Callable[[int], None]) -> int:
        """Sample photographs one after another; return how many could be used.

        Args:
            photographs: photographs on the disk.
            step: called with the number of photographs done; may raise.
        """
        used = 0
        for number, photograph in enumerate(photographs):
            used += self.add(photograph, self.candidates)
            step(number + 1)
        return used

    def held_back(self, photographs: Sequence[FullSizePhotograph], albedo: np.ndarray) -> Evidence:
        """Compare an albedo with photographs that it was not made from.

        Args:
            photographs: held back.
            albedo: (P, 3) linear, with detail.
        """
        evidence, plain = Evidence(self._texels, self._relief), self.plain
        for photograph in photographs:
            held = Candidates.empty(len(self._texels.index), 1)
            if self.add(photograph, held):
                evidence.add(held, albedo, plain)
        return evidence

    def textured(self, albedo: np.ndarray) -> Mesh:
        """Return the mesh with albedo (P, 3) in its texture; texels that no photograph sees well keep the working solution."""
        best = self.candidates.weight.max(1)
        usual = np.median(best[best > 0]) if (best > 0).any() else 1.0
        index = self._texels.index
        texture = self._mesh.textures["albedo"]
        colours = np.empty((len(index), 3), texture.dtype)
        for part in self._texels.chunks():
            certain = np.clip(best[part] / (CERTAIN_WEIGHT_RATIO * usual), 0, 1)[:, None]
            plain = self._albedo.reshape(-1, 3)[index[part]]
            colours[part] = srgb_quantised(certain * np.clip(albedo[part], 0, 1) + (1 - certain) * plain, bits_of(texture))
        return replace(self._mesh, textures={**self._mesh.textures, "albedo": self._texels.image(colours)})

    def report(self, photographs: int, evidence: Evidence, applied: bool, why: str) -> DetailReport:
        """Describe what was done.

        Args:
            photographs: number that the texture was made from.
            evidence: agreement with the held-back photographs.
            applied: the texture holds the detail.
            why: reason, in one line.
        """
        finest = self.candidates.finest
        seen = np.isfinite(finest)
        texel = float(np.median(self._texels.side[self._texels.face])) if len(seen) else None
        new, old = evidence.correlations if evidence.compared else (None, None)
        pixel = float(np.median(finest[seen])) if seen.any() else None
        return DetailReport(applied, why, photographs, new, old, texel, pixel, float(seen.mean()))


def detailed(
    mesh: Mesh, reconstruction: Reconstruction, photographs: Sequence[FullSizePhotograph], choice: Choice, progress: Progress
) -> tuple[Mesh, DetailReport]:
    """Give the albedo texture of a mesh the detail of full-size photographs.

    Args:
        mesh: mesh with materials and baked textures.
        reconstruction: solved light and materials.
        photographs: full-size photographs.
        choice: "off": leave the texture as it is; "auto": where the photographs are larger than the working resolution, or show more pixels
            of the object than there are Gaussians, and held-back ones agree better with it; "on": in any case.
        progress: receives steps, warnings and the result; may cancel.

    Raises:
        Cancelled: the user stopped the work.
    """
    if choice == "off":
        return mesh, DetailReport(False, "turned off")
    photographs = _readable(photographs, progress)
    if len(photographs) < MIN_PHOTOGRAPHS:
        return mesh, DetailReport(False, f"only {len(photographs)} full-size photographs")
    finer, pixels = float(np.median([one.finer for one in photographs])), object_pixels(mesh, photographs)
    if not takes_photograph_detail(choice, finer, reconstruction.gaussians.count / max(pixels, 1.0)):
        # Relief that the Gaussians shade would become albedo, and nothing be gained.
        return mesh, DetailReport(False, "the photographs are not larger than data.resolution and not finer than the Gaussians")
    progress.phase("detail", 2 * len(photographs))
    step = stoppable(progress)
    every = max(HELD_BACK_EVERY, -(-len(photographs) // MAX_HELD_BACK))
    held = list(photographs[every // 2 :: every]) or [photographs[0]]
    others = [one for one in photographs if one not in held]
    work = AlbedoDetail(mesh, reconstruction)
    work.align(others, step)
    used = work.add_all(others, lambda done: step(len(others) + done))
    albedo = combine(work.candidates)
    evidence = work.held_back(held, albedo)
    applied = choice == "on" or evidence.convincing(MIN_CORRELATION_GAIN if finer >= MIN_SIZE_RATIO else CLEAR_CORRELATION_GAIN)
    if applied:
        used += work.add_all(held, lambda done: step(2 * len(others) + done))
        albedo = combine(work.candidates)
    for line in work.failed.values():
        progress.message(f"warning: {line}; its detail is left out")
    report = work.report(used, evidence, applied, evidence.reason)
    progress.message(report.line())
    return (work.textured(albedo) if applied else mesh), report


def detailed_by_dataset(
    mesh: Mesh,
    reconstruction: Reconstruction,
    dataset: Path,
    views: Mapping[str, View | PlacedCamera],
    settings: Settings,
    progress: Progress,
) -> tuple[Mesh, DetailReport]:
    """Give the albedo texture of a run's mesh the detail of the photographs of its dataset.

    Args:
        mesh: mesh with materials and baked textures.
        reconstruction: solved light and materials.
        dataset: folder of the dataset with cameras that the run was made from.
        views: training views of the run by name.
        settings: settings of the run.
        progress: receives steps, warnings and the result; may cancel.

    Raises:
        Cancelled: the user stopped the work.
    """
    if settings.surface.albedo_detail == "off":
        return mesh, DetailReport(False, "turned off")
    photographs, missing = find_full_size_photographs(dataset, settings.data, views)
    if missing:
        progress.message(f"warning: {missing}; the texture takes no detail from them")
    return detailed(mesh, reconstruction, photographs, settings.surface.albedo_detail, progress)


def _readable(photographs: Sequence[FullSizePhotograph], progress: Progress) -> list[FullSizePhotograph]:
    """Return the photographs that are on the disk as they were, with a warning about each other one."""
    good = []
    for one in photographs:
        try:
            one.check()
            good.append(one)
        except InputError as error:
            progress.message(f"warning: {error}; its detail is left out")
    return good


def _lit(mesh: Mesh, reconstruction: Reconstruction) -> tuple:
    """Return the arguments of `VertexShading`."""
    radius = reconstruction.bound.radius
    reconstruction = reconstruction.to("cpu")
    relighter = Relighter(reconstruction, MeshQuery(mesh, radius), RelightSettings(denoise="off"))
    return mesh, relighter, reconstruction.environment_map(), radius
