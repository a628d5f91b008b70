# SPDX-License-Identifier: GPL-3.0-or-later
"""Candidates of texels: the albedo that each of a texel's best photographs shows there.

A photograph is sampled in its own pixels, lens distortion included, so that its detail is interpolated once. Its weight at a texel is
(facing * resolution / (footprint * blur))^2 * inside, with the cosine between normal and view, the size of the pixel on the surface, the
width of the photograph's own blur in pixels, and the distance from depth and mask edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..kernels.cpu.jit import helper, kernel
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..scene.camera import Camera
from ..scene.mesh import Mesh
from .mesh_depth import MeshDepth
from .mesh_texels import MeshTexels
from .photographs import LoadedPhotograph
from .radiometric_correction import RadiometricCorrection
from .vertex_shading import ViewShading

KEPT = 5  # candidates of a texel
LARGEST = 2.0  # albedo that the greatest code stands for: noise and leftover gloss may exceed 1
CODES = 65535 / LARGEST
FACING = 0.2  # least cosine between normal and view
CLIPPED = 0.98  # fraction of the largest code from which a pixel counts as clipped
CLIPPED_WEIGHT = 0.02  # factor of the weight of a clipped pixel
DARK = 0.1  # fraction of the median shading at which a pixel's weight is halved, since its noise is divided by little light
SLACK = 1.5  # depth differences, in pixels on the surface, that interpolation explains


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
    def empty(cls, count: int, kept: int = KEPT) -> Candidates:
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
    run_ranges(sample_texels, ranges, *_arguments(view, mesh, texels), candidates.colour, candidates.weight, candidates.finest)


def _arguments(view: TexelView, mesh: Mesh, texels: MeshTexels) -> tuple:
    """Return the arguments of `sample_texels` between the range and the results."""
    photograph, camera, lens = view.photograph, view.photograph.camera, view.photograph.lens
    depth, shading = view.depth, view.shading
    shown = shading.factor[(shading.factor > 0).all(1)]
    numbers = np.array([FACING, SLACK, DARK * float(np.median(shown)) if len(shown) else 1.0, view.blur], np.float64)
    coefficients = np.zeros(5)
    coefficients[: len(lens.distortion)] = lens.distortion
    kind = 0 if not lens.distorted else 2 if lens.fisheye else 1
    intrinsics = np.array([lens.fx, lens.fy, lens.cx, lens.cy])
    shift = np.zeros((1, 1, 2), np.float32) if view.shift is None else view.shift
    return (
        texels.face,
        texels.barycentric,
        texels.side,
        *(np.ascontiguousarray(a, np.float32) for a in (mesh.vertices, mesh.normals)),
        mesh.faces,
        np.ascontiguousarray(camera.world_to_cv[:3]),
        camera.centre,
        pinhole_numbers(camera),
        pinhole_numbers(depth.camera),
        depth.inverse,
        view.correction.inside,
        view.correction.low_frequency,
        1 / view.correction.gain,
        shading.factor,
        shading.gloss,
        intrinsics,
        coefficients,
        kind,
        shift,
        *photograph.pyramid,
        photograph.linear,
        numbers,
    )


def pinhole_numbers(camera: Camera) -> np.ndarray:
    """Return focal lengths and principal point (4,) of a camera."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64)


@helper
def cubic(t):
    """Return the weights of four samples at -1, 0, 1, 2 for a position t in 0..1 (Catmull and Rom 1974)."""
    a = ((-0.5 * t + 1.0) * t - 0.5) * t
    b = (1.5 * t - 2.5) * t * t + 1.0
    c = ((-1.5 * t + 2.0) * t + 0.5) * t
    return a, b, c, (0.5 * t - 0.5) * t * t


@helper
def distorted(x, y, kind, k):
    """Return where a lens shows the direction (x, y, 1): 0 a pinhole, 1 OpenCV's polynomial model, 2 its fisheye model."""
    if kind == 0:
        return x, y
    r2 = x * x + y * y
    if kind == 1:
        radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        return x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x), y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y
    r = np.sqrt(r2)
    if r < 1e-9:
        return x, y
    angle = np.arctan(r)
    a2 = angle * angle
    scale = angle * (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3])))) / r
    return x * scale, y * scale


@helper
def sampled(image, linear, u, v, width, height, colour):
    """Write the bicubic sample of an image at the pixel coordinates (u, v) of an image of size (width, height); return the largest code."""
    rows, columns = image.shape[0], image.shape[1]
    x, y = u * columns / width - 0.5, v * rows / height - 0.5
    column, row = int(np.floor(x)), int(np.floor(y))
    wx, wy = cubic(x - column), cubic(y - row)
    most = 0
    red, green, blue = 0.0, 0.0, 0.0
    for i in range(4):
        r = min(max(row + i - 1, 0), rows - 1)
        for j in range(4):
            c = min(max(column + j - 1, 0), columns - 1)
            w = wy[i] * wx[j]
            if 0 < i < 3 and 0 < j < 3:
                most = max(most, image[r, c, 0], image[r, c, 1], image[r, c, 2])
            red += w * linear[image[r, c, 0]]
            green += w * linear[image[r, c, 1]]
            blue += w * linear[image[r, c, 2]]
    colour[0], colour[1], colour[2] = red, green, blue
    return most


@kernel
def sample_texels(
    begin, end, face, barycentric, side, vertices, normals, faces, pose, centre, working, mapped, inverse, inside, level, exposure, factor,
    gloss, intrinsics, distortion, kind, shift, full, half, quarter, linear, numbers, kept_colour, kept_weight, finest
):  # fmt: skip
    """Sample a photograph at the texels begin..end and keep the best samples of each, see `Candidates`."""
    colour = np.zeros(3, np.float64)
    height, width = full.shape[0], full.shape[1]
    rows, columns = inverse.shape
    clipped = CLIPPED * (linear.shape[0] - 1)
    for p in range(begin, end):
        f = face[p]
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        b, c = barycentric[p, 0], barycentric[p, 1]
        a = 1 - b - c
        x = a * vertices[i, 0] + b * vertices[j, 0] + c * vertices[k, 0]
        y = a * vertices[i, 1] + b * vertices[j, 1] + c * vertices[k, 1]
        z = a * vertices[i, 2] + b * vertices[j, 2] + c * vertices[k, 2]
        nx = a * normals[i, 0] + b * normals[j, 0] + c * normals[k, 0]
        ny = a * normals[i, 1] + b * normals[j, 1] + c * normals[k, 1]
        nz = a * normals[i, 2] + b * normals[j, 2] + c * normals[k, 2]
        dx, dy, dz = centre[0] - x, centre[1] - y, centre[2] - z
        facing = dx * nx + dy * ny + dz * nz
        if facing <= 0:
            continue
        facing /= np.sqrt((dx * dx + dy * dy + dz * dz) * max(nx * nx + ny * ny + nz * nz, 1e-20))
        if facing < numbers[0]:
            continue
        far = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if far <= 0:
            continue
        px = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / far
        py = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / far
        column, row = int(np.floor(px * mapped[0] + mapped[2])), int(np.floor(py * mapped[1] + mapped[3]))
        if column < 0 or row < 0 or column >= columns or row >= rows or inverse[row, column] <= 0:
            continue
        if far - 1 / inverse[row, column] > numbers[1] * far / (mapped[0] * facing):
            continue
        cx, cy = px * working[0] + working[2] - 0.5, py * working[1] + working[3] - 0.5
        column, row = int(np.floor(cx)), int(np.floor(cy))
        if column < 0 or row < 0 or column >= inside.shape[1] - 1 or row >= inside.shape[0] - 1:
            continue
        tx, ty = cx - column, cy - row
        edge = (1 - ty) * ((1 - tx) * inside[row, column] + tx * inside[row, column + 1])
        edge += ty * ((1 - tx) * inside[row + 1, column] + tx * inside[row + 1, column + 1])
        if edge <= 0:
            continue
        if shift.shape[0] > 1:
            for axis in range(2):
                s = (1 - ty) * ((1 - tx) * shift[row, column, axis] + tx * shift[row, column + 1, axis])
                s += ty * ((1 - tx) * shift[row + 1, column, axis] + tx * shift[row + 1, column + 1, axis])
                if axis == 0:
                    px += s / working[0]
                else:
                    py += s / working[1]
        lx, ly = distorted(px, py, kind, distortion)
        u, v = lx * intrinsics[0] + intrinsics[2], ly * intrinsics[1] + intrinsics[3]
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        pixel = far / intrinsics[0]
        if side[f] < 1.5 * pixel:
            most = sampled(full, linear, u, v, width, height, colour)
        elif side[f] < 3 * pixel:
            most = sampled(half, linear, u, v, width, height, colour)
        else:
            most = sampled(quarter, linear, u, v, width, height, colour)
        footprint = pixel * numbers[3]
        finest[p] = min(finest[p], pixel)
        weight = edge * (facing / footprint) ** 2
        if most >= clipped:
            weight *= CLIPPED_WEIGHT
        light = 0.0
        for n in range(3):
            d = a * factor[i, n] + b * factor[j, n] + c * factor[k, n]
            s = a * gloss[i, n] + b * gloss[j, n] + c * gloss[k, n]
            low = (1 - ty) * ((1 - tx) * level[row, column, n] + tx * level[row, column + 1, n])
            low += ty * ((1 - tx) * level[row + 1, column, n] + tx * level[row + 1, column + 1, n])
            colour[n] = min(max((colour[n] * exposure[n] - s) / max(d, 1e-6) * low, 0.0), LARGEST)
            light += d / 3
        weight *= light * light / (light * light + numbers[2] * numbers[2])
        worst = 0
        for n in range(1, kept_weight.shape[1]):
            if kept_weight[p, n] < kept_weight[p, worst]:
                worst = n
        if weight > kept_weight[p, worst]:
            kept_weight[p, worst] = weight
            for n in range(3):
                kept_colour[p, worst, n] = int(colour[n] * CODES + 0.5)
