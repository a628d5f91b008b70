# SPDX-License-Identifier: GPL-3.0-or-later
"""TSDF fusion against plain loops and analytic solids."""

import itertools

import numpy as np
import pytest
from irgspp.core.errors import IrgsppError
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.dataset import Bound
from irgspp.core.settings.schema import SurfaceSettings
from irgspp.core.surface import fusion
from irgspp.core.surface.voxel_grid import BLOCK, Grid, make_grid


def centres(grid: Grid) -> np.ndarray:
    """Return the world positions (B, BLOCK^3, 3) of the active voxels."""
    local = np.array(list(np.ndindex(BLOCK, BLOCK, BLOCK)))
    return grid.origin + grid.voxel * (grid.active[:, None] * BLOCK + local)


def integrate_plainly(view, point, voxel, truncation):
    """Return (weighted distance, weight, seen through) of one voxel in one view, float64, by the definition."""
    camera, (pixel,), (far,) = view.camera, *view.camera.project(point[None])
    u, v = pixel
    if far <= 0 or not (0 <= u < camera.width and 0 <= v < camera.height):
        return 0.0, 0.0, False
    surface = camera.centre + view.depth[..., None].astype(np.float64) * camera.rays()
    distances = (view.normal * (point - surface)).sum(-1)
    cosine = -(view.normal * camera.rays()).sum(-1) / np.linalg.norm(camera.rays(), axis=-1)
    row, column = int(v), int(u)
    seen = view.alpha[row, column] > 0.5
    if not seen:
        nearest = min(np.hypot(i - row, j - column) for i, j in np.argwhere(view.alpha > 0.5))
        sure = float(nearest * far / camera.fx > truncation)
        return sure, sure, True
    behind = far - view.depth[row, column]
    free = behind < -truncation
    if cosine[row, column] <= fusion.MIN_FACING or behind > 1.5 * truncation:
        return 0.0, 0.0, free
    distance = distances[row, column]
    r, c = int(np.floor(v - 0.5)), int(np.floor(u - 0.5))
    if 0 <= r < camera.height - 1 and 0 <= c < camera.width - 1:
        four = np.array([[r, c], [r, c + 1], [r + 1, c], [r + 1, c + 1]])
        good = all(view.alpha[i, j] > 0.5 and cosine[i, j] > fusion.MIN_FACING for i, j in four)
        for k in range(4):
            (i, j), (m, n) = four[k], four[3 - k]
            good = good and abs(view.normal[i, j] @ (surface[m, n] - surface[i, j])) < voxel
        if good:
            s, t = u - 0.5 - c, v - 0.5 - r
            distance = np.array([1 - t, t]) @ distances[r : r + 2, c : c + 2] @ np.array([1 - s, s])
    if distance < -truncation:
        return 0.0, 0.0, free
    w = view.alpha[row, column] * cosine[row, column] * min(1.0, 1 + distance / truncation)
    return w * min(1.0, distance / truncation), w, free


def test_integrate_equals_plain_loops(solids, camera_ring, bound):
    solid, rng = solids["torus"], np.random.default_rng(0)
    views = [solid.view(camera, 0.02, i) for i, camera in enumerate(camera_ring(3, size=24))]
    grid = make_grid(views, solid.samples(500), bound, SurfaceSettings(voxels=24))
    shape, truncation = (len(grid.active), BLOCK**3), fusion.TRUNCATION * grid.voxel
    sums = fusion.DistanceSums(np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, bool))
    total, weight, free = sums
    blocks = fusion.VoxelBlocks(grid.active, grid.origin, grid.voxel, truncation)
    for view in views:
        fusion.integrate(0, len(grid.active), blocks, fusion.plane_layers(view, grid.voxel), sums)
    points = centres(grid)
    for b, i in zip(rng.integers(0, shape[0], 600), rng.integers(0, shape[1], 600), strict=True):
        expected = [integrate_plainly(view, points[b, i], grid.voxel, truncation) for view in views]
        assert total[b, i] == pytest.approx(sum(e[0] for e in expected), abs=1e-4)
        assert weight[b, i] == pytest.approx(sum(e[1] for e in expected), abs=1e-4)
        assert free[b, i] == any(e[2] for e in expected)


def test_relax_equals_plain_loops():
    rng = np.random.default_rng(0)
    active = np.argwhere(rng.random((3, 3, 3)) < 0.6).astype(np.int32)
    grid = Grid(np.zeros(3), 1.0, (3, 3, 3), active)
    total, weight, distance = (rng.random((len(active), BLOCK**3)).astype(np.float32) for _ in range(3))
    relaxed = np.empty_like(distance)
    fusion.relax(0, len(active), active, grid.table(), 0.5, total, weight, distance, relaxed)
    known, volume = grid.dense(np.ones_like(distance, bool), False), grid.dense(distance.astype(np.float64), np.nan)
    mean = np.full(volume.shape, np.nan)
    for x, y, z in zip(*np.nonzero(known), strict=True):
        steps = [np.array([x, y, z]) + s * np.eye(3, dtype=int)[a] for a, s in itertools.product(range(3), (-1, 1))]
        inside = [tuple(p) for p in steps if (p >= 0).all() and (p < volume.shape).all() and known[tuple(p)]]
        mean[x, y, z] = np.mean([volume[p] for p in inside])
    expected = (grid.dense(total, 0) + 0.5 * mean) / (grid.dense(weight, 0) + 0.5)
    np.testing.assert_allclose(grid.dense(relaxed, np.nan), expected, atol=1e-6)


@pytest.mark.parametrize("name", ["sphere", "torus", "box"])
def test_field_is_the_signed_distance_near_the_surface(name, solids, camera_ring, bound):
    solid = solids[name]
    views = [solid.view(camera) for camera in camera_ring(32)]
    grid = make_grid(views, solid.samples(), bound, SurfaceSettings(voxels=48))
    field = fusion.fuse(views, grid, Silent()) * fusion.TRUNCATION * grid.voxel
    true = solid.distance(centres(grid))
    near = np.abs(true) < 1.5 * grid.voxel
    assert np.abs(field - true)[near].mean() < 0.25 * grid.voxel
    wrong = np.sign(field) != np.sign(true)
    assert not wrong[np.abs(true) > 1.5 * grid.voxel].any()  # neither ghosts outside nor hollows inside


def test_nothing_is_inside_below_the_floor(solids, camera_ring, bound):
    """Cameras above alone leave what they do not see inside; the floor cuts it off, and changes nothing above."""
    solid = solids["sphere"]
    views = [solid.view(camera) for camera in camera_ring(16, lowest=0.3)]
    grid = make_grid(views, solid.samples(), bound, SurfaceSettings(voxels=48))
    field, cut = fusion.fuse(views, grid, Silent()), fusion.fuse(views, grid, Silent(), -0.5)
    height = centres(grid)[..., 2] + 0.5
    assert (field[height < -grid.voxel] < 0).any() and (cut[height < 0] > 0).all()
    np.testing.assert_array_equal(cut[height > fusion.TRUNCATION * grid.voxel], field[height > fusion.TRUNCATION * grid.voxel])
    near = (np.abs(height) < grid.voxel) & (field < -0.9)
    np.testing.assert_allclose(cut[near] * fusion.TRUNCATION * grid.voxel, -height[near], atol=1e-5)


def test_dense_puts_blocks_in_their_place():
    grid = Grid(np.array([1.0, 2.0, 3.0]), 0.5, (2, 3, 1), np.array([[0, 0, 0], [1, 2, 0]], np.int32))
    volume = grid.dense(centres(grid)[..., 1], -1.0)
    assert volume.shape == grid.shape == (8, 12, 4)
    assert (volume[:4, :4] == 2 + 0.5 * np.arange(4)[None, :, None]).all()
    assert (volume[4:, 8:] == 2 + 0.5 * np.arange(8, 12)[None, :, None]).all()
    assert (volume == -1).sum() == 4 * BLOCK**3


def test_grid_keeps_thin_tips_and_drops_outliers(solids, camera_ring, bound):
    solid = solids["sphere"]
    samples = solid.samples(5000)
    samples.position[0] = (0, 0, 1.12)  # a tip
    samples.position[1] = (1.4, 0, 0.2)  # an outlier inside the bound
    grid = make_grid([solid.view(camera) for camera in camera_ring(4)], samples, bound, SurfaceSettings(voxels=64))
    top = grid.origin + grid.voxel * (np.array(grid.shape) - 1)
    assert top[2] > 1.12
    assert top[0] < 1.4


def test_no_depth_inside_the_bound_is_an_error(solids, camera_ring):
    solid = solids["sphere"]
    views = [solid.view(camera) for camera in camera_ring(3)]
    with pytest.raises(IrgsppError, match="no view has a depth inside the object's bound"):
        make_grid(views, solid.samples(), Bound((9.0, 9.0, 9.0), 1.0), SurfaceSettings())
