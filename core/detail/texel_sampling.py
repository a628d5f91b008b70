# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernel that samples a photograph at the texels of a mesh; called by `candidates.py`, which describes the weights.

Positions (x, y) are in pixels of the working resolution or, as `px, py`, tangents of the direction (x, y, 1) in the camera's OpenCV axes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..kernels.cpu.jit import helper, kernel

MAX_ALBEDO = 2.0  # albedo that the greatest code stands for: noise and leftover gloss may exceed 1
CODES = 65535 / MAX_ALBEDO  # codes of a unit of albedo
MIN_FACING = 0.2  # least cosine between normal and view
CLIPPED_FRACTION = 0.98  # fraction of the largest code from which a pixel counts as clipped
CLIPPED_WEIGHT = 0.02  # factor of the weight of a clipped pixel
DEPTH_SLACK = 1.5  # depth differences, in pixels on the surface, that interpolation explains
PINHOLE, POLYNOMIAL, FISHEYE = range(3)  # lens models


class TexelSurface(NamedTuple):
    """P texels of a mesh of F triangles and V vertices, shaded towards one camera.

    Attributes:
        face: (P,) int32 triangle of each texel.
        barycentric: (P, 2) float32 weights of its second and third corner.
        side: (F,) float32 side of a texel on each triangle, world units.
        faces: (F, 3) int32.
        vertices: (V, 3) float32 world.
        normals: (V, 3) float32.
        factor: (V, 3) float32 radiance per albedo.
        gloss: (V, 3) float32 radiance that does not depend on the albedo.
    """

    face: np.ndarray
    barycentric: np.ndarray
    side: np.ndarray
    faces: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    factor: np.ndarray
    gloss: np.ndarray


class WorkingView(NamedTuple):
    """View of a photograph at the working resolution (h, w); lenses are (4,) focal lengths and principal point.

    Attributes:
        pose: (3, 4) from the world to the camera's OpenCV axes.
        centre: (3,) world.
        lens: pinhole of the working resolution.
        depth_lens: pinhole of the depth map.
        inverse_depth: (H, W) float32 1 / planar depth of the mesh, 0 where nothing is.
        inside: (h, w, 1) float32 weight in 0..1, 0 at edges of depth and mask.
        low_frequency: (h, w, 3) float32 factor of the albedo.
        exposure: (3,) factor of the photograph's radiance.
        shift: (h, w, 2) float32 displacement of the photograph, pixels; (1, 1, 2) for none.
    """

    pose: np.ndarray
    centre: np.ndarray
    lens: np.ndarray
    depth_lens: np.ndarray
    inverse_depth: np.ndarray
    inside: np.ndarray
    low_frequency: np.ndarray
    exposure: np.ndarray
    shift: np.ndarray


class LensImage(NamedTuple):
    """Photograph in its own pixels.

    Attributes:
        intrinsics: (4,) focal lengths and principal point.
        distortion: (5,) coefficients.
        model: PINHOLE, POLYNOMIAL or FISHEYE.
        full, half, quarter: (H, W, 3) codes at three resolutions.
        linear: (N,) float32 linear value of each code.
        blur: standard deviation of its blur relative to a sharp photograph, >= 1.
        dark: shading at which a pixel's weight is halved.
    """

    intrinsics: np.ndarray
    distortion: np.ndarray
    model: int
    full: np.ndarray
    half: np.ndarray
    quarter: np.ndarray
    linear: np.ndarray
    blur: float
    dark: float


class KeptSamples(NamedTuple):
    """Best K samples of P texels, changed in place.

    Attributes:
        colour: (P, K, 3) uint16 albedo * CODES.
        weight: (P, K) float32, 0 where there is no sample.
        finest: (P,) float32 size of the finest pixel on the surface, world units.
    """

    colour: np.ndarray
    weight: np.ndarray
    finest: np.ndarray


@helper
def cubic(t):
    """Return the weights of four samples at -1, 0, 1, 2 for a position t in 0..1 (Catmull and Rom 1974)."""
    a = ((-0.5 * t + 1.0) * t - 0.5) * t
    b = (1.5 * t - 2.5) * t * t + 1.0
    c = ((-1.5 * t + 2.0) * t + 0.5) * t
    return a, b, c, (0.5 * t - 0.5) * t * t


@helper
def distorted(x, y, model, k):
    """Return where a lens of a model with coefficients k shows the direction (x, y, 1)."""
    if model == PINHOLE:
        return x, y
    r2 = x * x + y * y
    if model == POLYNOMIAL:
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
def sample_bicubic(codes, linear, u, v, width, height, colour):
    """Write the bicubic sample of an image at the pixel coordinates (u, v) of an image of size (width, height); return the largest code."""
    rows, columns = codes.shape[0], codes.shape[1]
    x, y = u * columns / width - 0.5, v * rows / height - 0.5
    column, row = int(np.floor(x)), int(np.floor(y))
    wx, wy = cubic(x - column), cubic(y - row)
    largest = 0
    red, green, blue = 0.0, 0.0, 0.0
    for i in range(4):
        r = min(max(row + i - 1, 0), rows - 1)
        for j in range(4):
            c = min(max(column + j - 1, 0), columns - 1)
            w = wy[i] * wx[j]
            if 0 < i < 3 and 0 < j < 3:
                largest = max(largest, codes[r, c, 0], codes[r, c, 1], codes[r, c, 2])
            red += w * linear[codes[r, c, 0]]
            green += w * linear[codes[r, c, 1]]
            blue += w * linear[codes[r, c, 2]]
    colour[0], colour[1], colour[2] = red, green, blue
    return largest


@helper
def _interpolate(values, corners, weights, n):
    """Return channel n of vertex values (V, C) in a triangle."""
    return weights[0] * values[corners[0], n] + weights[1] * values[corners[1], n] + weights[2] * values[corners[2], n]


@helper
def _interpolate_vector(values, corners, weights):
    """Return the three channels of vertex values (V, 3) in a triangle."""
    return _interpolate(values, corners, weights, 0), _interpolate(values, corners, weights, 1), _interpolate(values, corners, weights, 2)


@helper
def _cosine_of_view(point, normal, centre):
    """Return the cosine between a normal of any length and the direction from a point to the camera; 0 where it faces away."""
    dx, dy, dz = centre[0] - point[0], centre[1] - point[1], centre[2] - point[2]
    nx, ny, nz = normal
    along = dx * nx + dy * ny + dz * nz
    if along <= 0:
        return 0.0
    return along / np.sqrt((dx * dx + dy * dy + dz * dz) * max(nx * nx + ny * ny + nz * nz, 1e-20))


@helper
def _project(pose, point):
    """Return px, py and the planar depth of a point; only the depth holds where it is <= 0."""
    x, y, z = point
    depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
    px = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / depth
    py = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / depth
    return px, py, depth


@helper
def _is_hidden(inverse, lens, px, py, depth, facing):
    """Return True where the depth map shows another surface than the point at a depth, or none."""
    column, row = int(np.floor(px * lens[0] + lens[2])), int(np.floor(py * lens[1] + lens[3]))
    if column < 0 or row < 0 or column >= inverse.shape[1] or row >= inverse.shape[0] or inverse[row, column] <= 0:
        return True
    return depth - 1 / inverse[row, column] > DEPTH_SLACK * depth / (lens[0] * facing)


@helper
def _bilinear(image, place, n):
    """Return channel n of an image (h, w, C) at a place: row and column of the upper left pixel, and the way to the next ones."""
    row, column, tx, ty = place
    upper = (1 - tx) * image[row, column, n] + tx * image[row, column + 1, n]
    lower = (1 - tx) * image[row + 1, column, n] + tx * image[row + 1, column + 1, n]
    return (1 - ty) * upper + ty * lower


@helper
def _demodulate(factors, glosses, low_frequency, exposure, corners, weights, place, colour):
    """Turn the radiance in `colour` into albedo; return the mean shading."""
    light = 0.0
    for n in range(3):
        factor, gloss = _interpolate(factors, corners, weights, n), _interpolate(glosses, corners, weights, n)
        low = _bilinear(low_frequency, place, n)
        colour[n] = min(max((colour[n] * exposure[n] - gloss) / max(factor, 1e-6) * low, 0.0), MAX_ALBEDO)
        light += factor / 3
    return light


@helper
def _keep_best(kept_colour, kept_weight, p, weight, colour):
    """Replace the worst kept sample of texel p by a better one."""
    worst = 0
    for n in range(1, kept_weight.shape[1]):
        if kept_weight[p, n] < kept_weight[p, worst]:
            worst = n
    if weight > kept_weight[p, worst]:
        kept_weight[p, worst] = weight
        for n in range(3):
            kept_colour[p, worst, n] = int(colour[n] * CODES + 0.5)


@kernel
def sample_texels(begin, end, surface, view, image, kept):
    """Sample a photograph at the texels begin..end and keep the best samples of each, see `Candidates`."""
    face, barycentric, side, faces, vertices, normals, factor, gloss = surface
    pose, centre, lens, depth_lens, inverse_depth, inside, low_frequency, exposure, shift = view
    intrinsics, distortion, model, full, half, quarter, linear, blur, dark = image
    kept_colour, kept_weight, finest = kept
    colour = np.zeros(3, np.float64)
    height, width = full.shape[0], full.shape[1]
    clipped = CLIPPED_FRACTION * (linear.shape[0] - 1)
    for p in range(begin, end):
        f = face[p]
        corners = faces[f, 0], faces[f, 1], faces[f, 2]
        b, c = barycentric[p, 0], barycentric[p, 1]
        weights = 1 - b - c, b, c
        point = _interpolate_vector(vertices, corners, weights)
        facing = _cosine_of_view(point, _interpolate_vector(normals, corners, weights), centre)
        if facing < MIN_FACING:
            continue
        px, py, depth = _project(pose, point)
        if depth <= 0 or _is_hidden(inverse_depth, depth_lens, px, py, depth, facing):
            continue
        x, y = px * lens[0] + lens[2] - 0.5, py * lens[1] + lens[3] - 0.5
        column, row = int(np.floor(x)), int(np.floor(y))
        if column < 0 or row < 0 or column >= inside.shape[1] - 1 or row >= inside.shape[0] - 1:
            continue
        place = row, column, x - column, y - row
        edge = _bilinear(inside, place, 0)
        if edge <= 0:
            continue
        if shift.shape[0] > 1:
            px += _bilinear(shift, place, 0) / lens[0]
            py += _bilinear(shift, place, 1) / lens[1]
        px, py = distorted(px, py, model, distortion)
        u, v = px * intrinsics[0] + intrinsics[2], py * intrinsics[1] + intrinsics[3]
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        pixel = depth / intrinsics[0]
        if side[f] < 1.5 * pixel:  # the resolution whose pixels are about as large as a texel; a helper would cost a third more time
            largest = sample_bicubic(full, linear, u, v, width, height, colour)
        elif side[f] < 3 * pixel:
            largest = sample_bicubic(half, linear, u, v, width, height, colour)
        else:
            largest = sample_bicubic(quarter, linear, u, v, width, height, colour)
        finest[p] = min(finest[p], pixel)
        weight = edge * (facing / (pixel * blur)) ** 2
        if largest >= clipped:
            weight *= CLIPPED_WEIGHT
        light = _demodulate(factor, gloss, low_frequency, exposure, corners, weights, place, colour)
        weight *= light * light / (light * light + dark * dark)
        _keep_best(kept_colour, kept_weight, p, weight, colour)
