# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial Gaussians: on the visual hull of the masks, or else on sparse points and at random positions in and around the bound."""

from __future__ import annotations

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from ...errors import InputError
from ...io.srgb import decode_srgb
from ...kernels.cpu.jit import kernel
from ...machine.thread_pool import even_ranges, run_ranges, thread_count
from ...scene.dataset import Bound, Dataset, View
from ...scene.gaussians import SH_COEFFICIENTS, SH_DC, Gaussians, quaternion_to

GRID = 96  # cells along the longest side of the hull
OPACITY = 0.7  # of surfels on the hull
SURROUNDINGS = 5.0  # largest distance of random points from the bound's centre, in radii of the bound
SPREAD = 0.65  # scale of a surfel over the spacing of the points
UNSEEN = 2.0  # alpha of a cell that no view has seen yet
MATERIAL = (0.5, 0.5, 0.5, 0.5, 0.02)  # initial albedo (3), roughness, metallic


@kernel
def carve_range(begin, end, corner, step, shape, matrix, alpha, inside):
    """Carve planes begin..end of `inside` (X, Y, Z): its minimum with the bilinear alpha of one view; cells outside the image stay."""
    height, width = alpha.shape
    for i in range(begin, end):
        for j in range(shape[1]):
            for k in range(shape[2]):
                x, y, z = corner[0] + i * step, corner[1] + j * step, corner[2] + k * step
                depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
                if inside[i, j, k] == 0.0 or depth <= 0.0:
                    continue
                u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / depth - 0.5
                v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / depth - 0.5
                if u < 0.0 or v < 0.0 or u > width - 1.0 or v > height - 1.0:
                    continue
                c, r = min(int(u), width - 2), min(int(v), height - 2)
                fu, fv = u - c, v - r
                top = alpha[r, c] * (1.0 - fu) + alpha[r, c + 1] * fu
                bottom = alpha[r + 1, c] * (1.0 - fu) + alpha[r + 1, c + 1] * fu
                inside[i, j, k] = min(inside[i, j, k], top * (1.0 - fv) + bottom * fv)


def _projection(view: View) -> np.ndarray:
    """Return the (3, 4) float32 matrix from world points to (u z, v z, z), pixel centres at .5."""
    c = view.camera
    intrinsics = np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1.0]])
    return (intrinsics @ c.world_to_cv[:3]).astype(np.float32)


def _carve(views: list[View], bound: Bound, low: np.ndarray, high: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Carve the box low..high (3,) at `cells` cells along its longest side; returns as `visual_hull`."""
    step = float((high - low).max()) / cells
    shape = np.maximum(np.ceil((high - low) / step).astype(int) + 1, 3)
    inside = np.full(shape, UNSEEN, np.float32)
    for view in views:
        assert view.alpha is not None
        arrays = (low.astype(np.float32), np.float32(step), shape, _projection(view), view.alpha)
        run_ranges(carve_range, even_ranges(shape[0], thread_count()), *arrays, inside)
    x, y, z = ((low[i] + step * np.arange(shape[i]) - bound.centre[i]) ** 2 for i in range(3))
    # The corners of the box lie outside the bound and often outside every image, where nothing carves them.
    inside[(x[:, None, None] + y[:, None] + z > bound.radius**2) | (inside > 1)] = 0
    return inside, low, step


def visual_hull(views: list[View], bound: Bound) -> tuple[np.ndarray, np.ndarray, float]:
    """Carve the visual hull (Laurentini 1994) from the bound with the masks of all views, coarse then fine.

    The hull that the surfels start on: the minimum of the bilinear alpha over all views, at GRID cells along the hull, by numba.
    `core.datasets.bound.bound_of_masks` also carves, but only estimates the bounding sphere before any bound is known: coarsely, with
    few views, and tolerant of masks that contradict each other.

    Args:
        views: all have masks.
        bound: sphere outside which everything is empty.

    Returns:
        The minimum alpha of each cell (X, Y, Z) float32, the world position (3,) of cell (0, 0, 0), and the cell size in world units.

    Raises:
        InputError: no cell is inside all masks.
    """
    centre, radius = np.asarray(bound.centre), bound.radius
    inside, corner, step = _carve(views, bound, centre - radius, centre + radius, GRID // 2)
    cells = np.argwhere(inside > 0.1)
    if not len(cells):
        raise InputError(
            "masks", "no point of the object's bound is inside all masks", "check the cameras, or set data.centre, data.radius"
        )
    low, high = corner + (cells.min(0) - 1.5) * step, corner + (cells.max(0) + 1.5) * step
    return _carve(views, bound, low, high, GRID)


def _surface(inside: np.ndarray, corner: np.ndarray, step: float, count: int, rng: np.random.Generator):
    """Sample `count` area-uniform points (N, 3) and outward unit normals (N, 3) on the hull's 0.5 level; also return its area."""
    padded = np.pad(inside, 1)
    vertices, faces, _, _ = marching_cubes(padded, min(0.5, 0.5 * float(inside.max())))
    triangles = ((vertices - 1) * step + corner)[faces]
    edges = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(edges, axis=1)
    pick = rng.choice(len(faces), count, p=area / area.sum())
    r1, r2 = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    a, b, c = triangles[pick, 0], triangles[pick, 1], triangles[pick, 2]
    points = (1 - r1) * a + r1 * (1 - r2) * b + r1 * r2 * c
    gradient = np.stack(np.gradient(gaussian_filter(inside, 1.5)), -1) / step
    cell = np.clip(np.round((points - corner) / step).astype(int), 0, np.array(inside.shape) - 1)
    normals = -gradient[tuple(cell.T)]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    flat = edges[pick] / np.maximum(area[pick, None], 1e-20)
    return points, np.where(length > 1e-6, normals / np.maximum(length, 1e-6), flat), float(area.sum())


def observed_colour(views: list[View], points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Average the images' colours at surface points, weighted by the cosine between normal and view; occlusion is neglected.

    Args:
        views: images, which are averaged as they are encoded.
        points: (N, 3) world.
        normals: (N, 3) unit.

    Returns:
        (N, 3) float32 linear colour; grey where no view faces the point.
    """
    total, weight = np.zeros((len(points), 3)), np.full((len(points), 1), 1e-9)
    for view in views:
        pixel, depth = view.camera.project(points)
        to_camera = view.camera.centre - points
        cosine = (to_camera * normals).sum(1) / np.linalg.norm(to_camera, axis=1)
        column, row = np.floor(pixel).astype(int).T
        visible = (depth > 0) & (cosine > 0.2) & (column >= 0) & (row >= 0) & (column < view.camera.width) & (row < view.camera.height)
        total[visible] += cosine[visible, None] * view.colour[row[visible], column[visible]]
        weight[visible] += cosine[visible, None]
    return decode_srgb(np.where(weight > 1e-6, total / weight, 0.5)).astype(np.float32)


def surfels(points: np.ndarray, normals: np.ndarray, colour: np.ndarray, spacing: np.ndarray, opacity: float) -> Gaussians:
    """Make round surfels with constant radiance.

    Args:
        points: (N, 3) centres, world.
        normals: (N, 3) unit normals.
        colour: (N, 3) linear radiance.
        spacing: (N,) distance to neighbouring points in world units, which the scales follow.
        opacity: of all surfels, 0..1.
    """
    n = len(points)
    sh = torch.zeros(SH_COEFFICIENTS, 3, n)
    sh[0] = (torch.as_tensor(colour, dtype=torch.float32).T - 0.5) / SH_DC
    scale = torch.as_tensor(np.log(np.maximum(SPREAD * spacing, 1e-12)), dtype=torch.float32)
    material = torch.logit(torch.tensor(MATERIAL))[:, None].repeat(1, n)
    normal = torch.as_tensor(normals, dtype=torch.float32).T
    position = torch.as_tensor(points, dtype=torch.float32).T.contiguous()
    return Gaussians(position, quaternion_to(normal), scale[None].repeat(2, 1), torch.logit(torch.full((n,), opacity)), sh, material)


def from_hull(dataset: Dataset, count: int, rng: np.random.Generator) -> Gaussians:
    """Place surfels on the visual hull of the training masks, in spatial order.

    Args:
        dataset: views that all have masks.
        count: number of surfels.
        rng: of their positions.
    """
    inside, corner, step = visual_hull(dataset.train, dataset.bound)
    points, normals, area = _surface(inside, corner, step, count, rng)
    order, spacing = spatial_order(points), np.full(count, np.sqrt(area / count))
    points, normals = points[order], normals[order]
    return surfels(points, normals, observed_colour(dataset.train, points, normals), spacing, OPACITY)


def from_points(dataset: Dataset, count: int, rng: np.random.Generator) -> Gaussians:
    """Place surfels on the sparse points, and at random in and around the bound up to half of `count`; density control adds the rest.

    Normals point to the nearest camera.

    Args:
        dataset: views and sparse points.
        count: most surfels.
        rng: of the selection and of random positions.
    """
    centre, radius = np.asarray(dataset.bound.centre), dataset.bound.radius
    known = dataset.points.position if dataset.points is not None else np.zeros((0, 3), np.float32)
    colours = decode_srgb(dataset.points.colour) if dataset.points is not None else np.zeros((0, 3), np.float32)
    if len(known) > count:
        chosen = rng.choice(len(known), count, replace=False)
        known, colours = known[chosen], colours[chosen]
    direction = rng.normal(size=(max(count // 2 - len(known), 0), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    # Every other point lies around the object, log-uniform in distance, to represent the background.
    inner = rng.random(len(direction)) ** (1 / 3)
    reach = np.where(np.arange(len(direction)) % 2 == 0, inner, SURROUNDINGS ** rng.random(len(direction)))
    filler = centre + direction * radius * reach[:, None]
    cameras = np.stack([v.camera.centre for v in dataset.train])
    clearance = 0.5 * np.linalg.norm(cameras - centre, axis=1).min()  # a surfel close to a camera would hide everything
    filler = filler[KDTree(cameras).query(filler)[0] > clearance]
    points = np.concatenate([known, filler])
    _, nearest = KDTree(cameras).query(points)
    normals = cameras[nearest] - points
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distance, _ = KDTree(points).query(points, k=4)
    spacing = np.clip(np.sqrt((distance[:, 1:] ** 2).mean(1)), 1e-4 * radius, 0.2 * radius)
    colour = np.concatenate([colours, observed_colour(dataset.train, points[len(known) :], normals[len(known) :])])
    return surfels(points, normals, colour, spacing, 0.1)


def spatial_order(points: np.ndarray) -> np.ndarray:
    """Return the (N,) order of points (N, 3) along a Morton curve, so that neighbours in space are neighbours in memory."""
    low, extent = points.min(0), np.ptp(points, 0).max()
    grid = ((points - low) / max(extent, 1e-30) * 1023).astype(np.uint32)
    code = np.zeros(len(points), np.uint32)
    for bit in range(10):
        for axis in range(3):
            code |= ((grid[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def initial_gaussians(dataset: Dataset, count: int, rng: np.random.Generator) -> Gaussians:
    """Make the initial Gaussians of the first stage: on the visual hull where every view has a mask, else on points and at random.

    Args:
        dataset: views, bound and sparse points.
        count: most surfels; exactly as many on a hull.
        rng: of positions.
    """
    return from_hull(dataset, count, rng) if dataset.has_alpha else from_points(dataset, count, rng)
