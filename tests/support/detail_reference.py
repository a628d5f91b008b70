# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain float64 definitions of the kernels of `core/detail`, with which tests compare them."""

import cv2
import numpy as np
from irgspp.core.datasets.parsed_dataset import Lens
from irgspp.core.detail import texel_sampling as kernels
from irgspp.core.detail.candidates import DARK_FRACTION, Candidates, TexelView
from irgspp.core.detail.combination import ALBEDO_FLOOR, ROUNDS
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.mesh import Mesh
from irgspp.core.surface.mesh_texels import MeshTexels


def nearest_triangles(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Intersect the ray through each pixel's centre with every triangle (Moeller and Trumbore 1997).

    Args:
        vertices: (V, 3) world.
        faces: (F, 3).
        camera: the camera.

    Returns:
        (H, W) index of the nearest triangle, -1 for none, and (H, W) 1 / planar depth, 0 for none.
    """
    ray = camera.rays().astype(np.float64).reshape(-1, 1, 3)
    a, b, c = (vertices[faces[:, k]].astype(np.float64)[None] for k in range(3))
    cross = np.cross(ray, c - a)
    determinant = (cross * (b - a)).sum(-1)
    determinant = np.where(np.abs(determinant) < 1e-15, np.nan, determinant)
    away = camera.centre - a
    u = (away * cross).sum(-1) / determinant
    q = np.cross(away, b - a)
    v = (ray * q).sum(-1) / determinant
    depth = ((c - a) * q).sum(-1) / determinant
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth > 0)
    depth = np.where(hit, depth, np.inf)
    nearest = depth.argmin(1)
    best = depth[np.arange(len(depth)), nearest]
    shape = camera.height, camera.width
    return np.where(np.isfinite(best), nearest, -1).reshape(shape), np.where(np.isfinite(best), 1 / best, 0).reshape(shape)


def lens_pixels(lens: Lens, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixel coordinates at which a lens shows the directions (x, y, 1) of its camera, OpenCV's axes.

    Args:
        lens: the lens.
        x: (...,) tangent to the right.
        y: (...,) tangent downwards.
    """
    if lens.distorted:
        directions = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 1, 3)
        coefficients = np.array(lens.distortion or (0.0,) * 4, np.float64)
        if lens.fisheye:
            points, _ = cv2.fisheye.projectPoints(directions, np.zeros(3), np.zeros(3), np.eye(3), coefficients)
        else:
            points, _ = cv2.projectPoints(directions, np.zeros(3), np.zeros(3), np.eye(3), coefficients)
        x, y = points.reshape(*x.shape, 2)[..., 0], points.reshape(*y.shape, 2)[..., 1]
    return x * lens.fx + lens.cx, y * lens.fy + lens.cy


def texel_samples(view: TexelView, mesh: Mesh, texels: MeshTexels) -> tuple[np.ndarray, np.ndarray]:
    """Return the albedo (P, 3) that a photograph shows at texels, and its weight (P,), 0 where it does not show them."""
    photograph, camera, depth = view.photograph, view.photograph.camera, view.depth
    corners = mesh.faces[texels.face]
    second, third = texels.barycentric.astype(np.float64).T
    share = np.stack([1 - second - third, second, third], -1)[..., None]

    def at(values: np.ndarray) -> np.ndarray:
        return (values[corners].astype(np.float64) * share).sum(1)

    point, normal = at(mesh.vertices), at(mesh.normals)
    towards = camera.centre - point
    facing = (towards * normal).sum(-1) / np.linalg.norm(towards, axis=-1) / np.linalg.norm(normal, axis=-1)
    pixel, far = depth.camera.project(point)
    column, row = np.floor(pixel).astype(int).T
    shown = (facing >= kernels.MIN_FACING) & depth.camera.in_image(pixel, far)
    nearest = np.where(shown, depth.inverse[np.where(shown, row, 0), np.where(shown, column, 0)], 0)
    surface = 1 / np.where(nearest > 0, nearest, np.inf)
    shown &= (nearest > 0) & (far - surface <= kernels.DEPTH_SLACK * far / (depth.camera.fx * facing))
    place = camera.project(point)[0] - 0.5
    inside = np.where(shown, _bilinear(view.correction.inside[..., None], place)[:, 0], 0)
    direction = (camera.project(point)[0] - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    if view.shift is not None:
        direction = direction + _bilinear(view.shift, place) / (camera.fx, camera.fy)
    lens = photograph.lens
    u, v = lens_pixels(lens, direction[:, 0], direction[:, 1])
    inside = np.where((u >= 0) & (v >= 0) & (u < lens.width) & (v < lens.height), inside, 0)
    size = far / lens.fx
    choice = np.digitize(texels.side[texels.face] / size, (1.5, 3))
    pairs = [_bicubic(codes, photograph.linear, u, v, lens.size) for codes in photograph.pyramid]
    colour = np.stack([p[0] for p in pairs])[choice, np.arange(len(u))]
    most = np.stack([p[1] for p in pairs])[choice, np.arange(len(u))]
    factor, gloss = at(view.shading.factor), at(view.shading.gloss)
    albedo = (colour / view.correction.gain - gloss) / np.maximum(factor, 1e-6) * _bilinear(view.correction.low_frequency, place)
    weight = inside * (facing / (size * view.blur)) ** 2
    weight = np.where(most >= kernels.CLIPPED_FRACTION * (len(photograph.linear) - 1), kernels.CLIPPED_WEIGHT * weight, weight)
    light, dark = factor.mean(-1), DARK_FRACTION * np.median(view.shading.factor[(view.shading.factor > 0).all(1)])
    return np.clip(albedo, 0, kernels.MAX_ALBEDO), weight * light**2 / (light**2 + dark**2)


def combined(candidates: Candidates, power: float, outlier: float) -> np.ndarray:
    """Return the robust mean (P, 3) of candidates, see `combination.combine`."""
    colour = candidates.colour / kernels.CODES
    weight = candidates.weight.astype(np.float64)
    known = weight.max(1) > 0
    weight = weight / np.where(known, weight.max(1), 1)[:, None]
    logs, trust = np.log(colour + ALBEDO_FLOOR), np.ones_like(weight)
    for _ in range(ROUNDS):
        w = weight * trust
        centre = (w[..., None] * logs).sum(1) / np.maximum(w.sum(1), 1e-30)[:, None]
        trust = 1 / (1 + ((logs - centre[:, None]) ** 2).sum(-1) / (3 * outlier**2))
    w = weight**power * trust
    return np.where(known[:, None], (w[..., None] * colour).sum(1) / np.maximum(w.sum(1), 1e-30)[:, None], 0)


def _bilinear(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return samples (P, C) of an image at places (P, 2) in units where pixel centres are integers; 0 outside."""
    maps = (place[:, axis].astype(np.float64) for axis in (0, 1))
    x, y = maps
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    good = (column >= 0) & (row >= 0) & (column < image.shape[1] - 1) & (row < image.shape[0] - 1)
    c, r = np.where(good, column, 0), np.where(good, row, 0)
    tx, ty = (x - column)[:, None], (y - row)[:, None]
    top = (1 - tx) * image[r, c] + tx * image[r, c + 1]
    bottom = (1 - tx) * image[r + 1, c] + tx * image[r + 1, c + 1]
    return np.where(good[:, None], (1 - ty) * top + ty * bottom, 0)


def _bicubic(codes: np.ndarray, linear: np.ndarray, u: np.ndarray, v: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return bicubic samples (P, 3) of a photograph, and the largest code (P,) of the four nearest pixels."""
    padded = np.asarray(cv2.copyMakeBorder(codes, 3, 3, 3, 3, cv2.BORDER_REPLICATE))
    x, y = u * codes.shape[1] / size[0] - 0.5, v * codes.shape[0] / size[1] - 0.5
    x, y = np.clip(x, -1, codes.shape[1]), np.clip(y, -1, codes.shape[0])
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    total, most = np.zeros((len(x), 3)), np.zeros(len(x))
    for i in range(-1, 3):
        for j in range(-1, 3):
            code = padded[row + i + 3, column + j + 3]
            weight = _catmull_rom(y - row - i) * _catmull_rom(x - column - j)
            total += weight[:, None] * linear[code.astype(np.intp)].astype(np.float64)
            if i in (0, 1) and j in (0, 1):
                most = np.maximum(most, code.max(-1))
    return total, most


def _catmull_rom(t: np.ndarray) -> np.ndarray:
    """Return the cubic kernel of Catmull and Rom (1974) at distances (P,)."""
    t = np.abs(t)
    return np.where(t < 1, (1.5 * t - 2.5) * t**2 + 1, np.where(t < 2, ((-0.5 * t + 2.5) * t - 4) * t + 2, 0))
