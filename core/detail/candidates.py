# SPDX-License-Identifier: GPL-3.0-or-later
"""Candidates of texels: the albedo that each of a texel's best photographs shows there.

A photograph is sampled in its own pixels, lens distortion included, so that its detail is interpolated once. Its weight at a texel is
(facing * resolution / (footprint * blur))^2 * inside, with the cosine between normal and view, the size of the pixel on the surface, the
width of the photograph's own blur in pixels, and the distance from depth and mask edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..scene.camera import Camera
from ..scene.mesh import Mesh
from ..surface.mesh_texels import MeshTexels
from .mesh_depth import MeshDepth
from .photographs import LoadedPhotograph
from .radiometric_correction import RadiometricCorrection
from .texel_sampling import FISHEYE, PINHOLE, POLYNOMIAL, KeptSamples, LensImage, TexelSurface, WorkingView, sample_texels
from .vertex_shading import ViewShading

MAX_CANDIDATES = 5  # candidates of a texel
DARK_FRACTION = 0.1  # fraction of the median shading at which a pixel's weight is halved, since its noise is divided by little light


@dataclass(frozen=True, eq=False)
class Candidates:
    """Best K candidates of P texels.

    Attributes:
        colour: (P, K, 3) uint16 albedo * CODES.
        weight: (P, K) float32, 0 where there is no candidate.
        finest: (P,) float32 size of the finest pixel on the surface, world units; infinite where no photograph sees the texel.
    """

    colour: np.ndarray
    weight: np.ndarray
    finest: np.ndarray

    @classmethod
    def empty(cls, count: int, kept: int = MAX_CANDIDATES) -> Candidates:
        """Return no candidates for a number of texels.

        Args:
            count: texels.
            kept: candidates of each at most.
        """
        colour, weight = np.zeros((count, kept, 3), np.uint16), np.zeros((count, kept), np.float32)
        return cls(colour, weight, np.full(count, np.inf, np.float32))


@dataclass(frozen=True, eq=False)
class TexelView:
    """Photograph with everything that is needed to sample it at texels.

    Attributes:
        photograph: decoded.
        depth: depth map of the mesh, at any resolution.
        correction: its exposure and low frequencies.
        shading: shading of the mesh's vertices.
        blur: standard deviation of its blur relative to a sharp photograph, >= 1.
        shift: (h, w, 2) float32 displacement of its content against the mesh, in pixels of the working resolution.
    """

    photograph: LoadedPhotograph
    depth: MeshDepth
    correction: RadiometricCorrection
    shading: ViewShading
    blur: float = 1.0
    shift: np.ndarray | None = None


def add_candidates(view: TexelView, mesh: Mesh, texels: MeshTexels, candidates: Candidates) -> None:
    """Sample a photograph at the texels that it shows, and keep the samples that are among the best of their texel.

    Args:
        view: the photograph.
        mesh: the mesh.
        texels: its texels.
        candidates: changed in place.
    """
    ranges = even_ranges(len(texels.index), 8 * thread_count())
    kept = KeptSamples(candidates.colour, candidates.weight, candidates.finest)
    run_ranges(sample_texels, ranges, _texel_surface(mesh, texels, view.shading), _working_view(view), _lens_image(view), kept)


def _texel_surface(mesh: Mesh, texels: MeshTexels, shading: ViewShading) -> TexelSurface:
    """Pack the texels and vertices for the kernel."""
    vertices, normals = (np.ascontiguousarray(values, np.float32) for values in (mesh.vertices, mesh.normals))
    return TexelSurface(texels.face, texels.barycentric, texels.side, mesh.faces, vertices, normals, shading.factor, shading.gloss)


def _working_view(view: TexelView) -> WorkingView:
    """Pack the view at the working resolution for the kernel."""
    camera, depth, correction = view.photograph.camera, view.depth, view.correction
    return WorkingView(
        pose=np.ascontiguousarray(camera.world_to_cv[:3]),
        centre=camera.centre,
        lens=_pinhole_numbers(camera),
        depth_lens=_pinhole_numbers(depth.camera),
        inverse_depth=depth.inverse,
        inside=correction.inside[..., None],
        low_frequency=correction.low_frequency,
        exposure=1 / correction.gain,
        shift=np.zeros((1, 1, 2), np.float32) if view.shift is None else view.shift,
    )


def _lens_image(view: TexelView) -> LensImage:
    """Pack the photograph in its own pixels for the kernel."""
    photograph, lens, factor = view.photograph, view.photograph.lens, view.shading.factor
    shown = factor[(factor > 0).all(1)]
    dark = DARK_FRACTION * float(np.median(shown)) if len(shown) else 1.0
    coefficients = np.zeros(5)
    coefficients[: len(lens.distortion)] = lens.distortion
    model = PINHOLE if not lens.distorted else FISHEYE if lens.fisheye else POLYNOMIAL
    intrinsics = np.array([lens.fx, lens.fy, lens.cx, lens.cy])
    full, half, quarter = photograph.pyramid
    return LensImage(intrinsics, coefficients, model, full, half, quarter, photograph.linear, float(view.blur), dark)


def _pinhole_numbers(camera: Camera) -> np.ndarray:
    """Return focal lengths and principal point (4,) of a camera."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64)
