# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo detail: the albedo texture of a mesh from full-size photographs, with the low frequencies of the working solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..errors import Cancelled, InputError
from ..io.srgb import decode_srgb
from ..progress.protocol import Progress
from ..relight.mesh_query import MeshQuery
from ..relight.prepared_light import prepare_light
from ..relight.relighter import Relighter, RelightSettings
from ..scene.camera import Camera
from ..scene.mesh import Mesh
from ..scene.reconstruction import Reconstruction
from ..settings.schema import Choice
from ..surface.bake import Texels, colour_byte
from .candidates import Candidates, TexelView, add_candidates
from .combination import combine
from .depth_map import DepthMap, depth_map
from .evidence import Evidence
from .levelling import level
from .mesh_texels import MeshTexels, mesh_texels
from .photographs import Photograph
from .sharpness import relative_blur
from .vertex_shading import VertexShading

FEWEST_VIEWS = 3  # photographs from which albedo can be told from what one of them shows by chance
HELD_BACK = 8  # one photograph in so many is held back as evidence
MOST_HELD = 3  # photographs held back at most
DEPTH_SIDE = 1600  # longest side of the depth maps that decide visibility, pixels
CERTAIN = 0.3  # weight of the best photograph, as a fraction of that of one straight above with the scene's usual pixels, that suffices


@dataclass(frozen=True)
class DetailReport:
    """What was done, for run.json.

    Attributes:
        applied: the texture holds detail of the photographs.
        why: reason, in one line.
        photographs: number that the texture was made from.
        error_ratio: error on held-back photographs with detail over that without, or None.
        texel: side of a texel on the surface, world units, median.
        pixel: size of the finest pixel on the surface, world units, median over the texels that some photograph sees; or None.
        seen: fraction of the texels that some photograph sees.
    """

    applied: bool
    why: str
    photographs: int = 0
    error_ratio: float | None = None
    texel: float | None = None
    pixel: float | None = None
    seen: float = 0.0

    def state(self) -> dict[str, object]:
        """Return the report as JSON holds it, without unnecessary digits."""
        return {name: float(f"{value:.4g}") if isinstance(value, float) else value for name, value in asdict(self).items()}


class AlbedoDetail:
    """Accumulation of photographs into the albedo texture of one mesh.

    Args:
        mesh: with materials and baked textures.
        reconstruction: solved light and materials.
        progress: may cancel.
    """

    def __init__(self, mesh: Mesh, reconstruction: Reconstruction, progress: Progress) -> None:
        self._mesh, self._progress = mesh, progress
        texture = mesh.textures["albedo"]
        self._texels: MeshTexels = mesh_texels(mesh, len(texture))
        self._albedo = decode_srgb(np.arange(256, dtype=np.float32) / 255)[texture].astype(np.float32)
        self._shading = VertexShading(*_lit(mesh, reconstruction))
        self._blur: dict[str, float] = {}
        self.candidates = Candidates.empty(len(self._texels.index))

    @property
    def plain(self) -> np.ndarray:
        """Albedo (P, 3) of the working solution at the texels."""
        return self._albedo.reshape(-1, 3)[self._texels.index]

    def add(self, photograph: Photograph, candidates: Candidates) -> bool:
        """Sample a photograph; return False where too little of the object is seen in it.

        Args:
            photograph: on the disk.
            candidates: that receive the samples.

        Raises:
            InputError: if the file is gone or damaged.
        """
        decoded = photograph.decode()
        shading = self._shading.seen_by(decoded.camera)
        correction = level(decoded, self._mesh, self._albedo, shading)
        if correction is None:
            return False
        view = TexelView(decoded, self._depth(decoded.camera, decoded.lens.size), correction, shading, relative_blur(decoded))
        add_candidates(view, self._mesh, self._texels, candidates)
        return True

    def _depth(self, camera: Camera, full: tuple[int, int]) -> DepthMap:
        """Return the depth of the mesh at a resolution between that of the camera and of the photograph."""
        longest = max(camera.width, camera.height)
        scale = min(max(full), max(DEPTH_SIDE, longest)) / longest
        return depth_map(self._mesh.vertices, self._mesh.faces, camera.resized(round(camera.width * scale), round(camera.height * scale)))

    def held_back(self, photographs: Sequence[Photograph], albedo: np.ndarray) -> Evidence:
        """Compare an albedo with photographs that it was not made from.

        Args:
            photographs: held back.
            albedo: (P, 3) linear, with detail.
        """
        evidence, plain = Evidence(), self.plain
        for photograph in photographs:
            held = Candidates.empty(len(self._texels.index), 1)
            if self.add(photograph, held):
                evidence.add(held, albedo, plain)
        return evidence

    def textured(self, albedo: np.ndarray) -> Mesh:
        """Return the mesh with albedo (P, 3) in its texture; texels that no photograph sees well keep the working solution."""
        best = self.candidates.weight.max(1)
        usual = np.median(best[best > 0]) if (best > 0).any() else 1.0
        certain = np.clip(best / (CERTAIN * usual), 0, 1)[:, None]
        mixed = certain * np.clip(albedo, 0, 1) + (1 - certain) * self.plain
        size = self._texels.size
        index = self._texels.index
        grid = Texels(size, index // size, index % size, self._texels.face, np.empty((0, 3)))
        return replace(self._mesh, textures={**self._mesh.textures, "albedo": grid.image(colour_byte(mixed))})

    def report(self, photographs: int, evidence: Evidence, applied: bool, why: str) -> DetailReport:
        """Describe what was done.

        Args:
            photographs: number that the texture was made from.
            evidence: of the held-back ones.
            applied: the texture holds the detail.
            why: reason, in one line.
        """
        finest = self.candidates.finest
        seen = np.isfinite(finest)
        texel = float(np.median(self._texels.side[self._texels.face])) if len(seen) else None
        ratio = evidence.ratio if evidence.texels else None
        return DetailReport(applied, why, photographs, ratio, texel, float(np.median(finest[seen])) if seen.any() else None, float(seen.mean()))


def detailed(
    mesh: Mesh, reconstruction: Reconstruction, photographs: Sequence[Photograph], choice: Choice, progress: Progress
) -> tuple[Mesh, DetailReport]:
    """Give the albedo texture of a mesh the detail of full-size photographs.

    Args:
        mesh: with materials and baked textures.
        reconstruction: solved light and materials.
        photographs: full-size photographs.
        choice: "off": leave the texture as it is; "auto": where held-back photographs agree better with it; "on": in any case.
        progress: receives steps, warnings and the result; may cancel.

    Raises:
        Cancelled: the user stopped the work.
    """
    if choice == "off":
        return mesh, DetailReport(False, "turned off")
    if len(photographs) < FEWEST_VIEWS:
        return mesh, DetailReport(False, f"only {len(photographs)} full-size photographs")
    progress.phase("detail", len(photographs) + 1)
    work = AlbedoDetail(mesh, reconstruction, progress)
    every = max(HELD_BACK, -(-len(photographs) // MOST_HELD))
    held = list(photographs[every // 2 :: every]) or [photographs[0]]
    others = [one for one in photographs if one not in held]
    used = _add_all(work, others, progress, 0)
    albedo = combine(work.candidates)
    evidence = work.held_back(held, albedo)
    applied = choice == "on" or evidence.convincing
    if applied:
        used += _add_all(work, held, progress, len(others))
        albedo = combine(work.candidates)
    why = f"held-back photographs differ from the texture by {evidence.ratio:.2f} of the difference without detail"
    report = work.report(used, evidence, applied, why)
    progress.message(_line(report))
    return (work.textured(albedo) if applied else mesh), report


def _add_all(work: AlbedoDetail, photographs: Sequence[Photograph], progress: Progress, before: int) -> int:
    """Sample photographs one after another; return how many could be used."""
    used = 0
    for number, photograph in enumerate(photographs):
        try:
            used += work.add(photograph, work.candidates)
        except InputError as error:
            progress.message(f"warning: {error}; its detail is left out")
        progress.step(before + number + 1)
        if progress.cancelled:
            raise Cancelled("stopped while taking detail from photographs")
    return used


def _line(report: DetailReport) -> str:
    """Return the report as one line for the user."""
    what = f"albedo detail of {report.photographs} photographs" if report.applied else "no albedo detail"
    density = "" if not report.texel or not report.pixel else f"; {report.pixel / report.texel:.2g} texels per pixel of the photographs"
    return f"{what}: {report.why}{density}"


def _lit(mesh: Mesh, reconstruction: Reconstruction) -> tuple:
    """Return the arguments of `VertexShading`."""
    radius = reconstruction.bound.radius
    reconstruction = reconstruction.to("cpu")
    relighter = Relighter(reconstruction, MeshQuery(mesh, radius), RelightSettings(denoise="off"))
    return mesh, relighter, prepare_light(reconstruction.environment_map()), radius
