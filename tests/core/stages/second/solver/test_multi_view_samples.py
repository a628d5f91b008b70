# SPDX-License-Identifier: GPL-3.0-or-later
"""Multi-view samples of a sphere in analytic images: visibility, directions and colours."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from irgspp.core.kernels.cpu.bvh import SurfelTree
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import View
from irgspp.core.stages.common.training_view import MIN_SATURATED
from irgspp.core.stages.first.initialization import surfels
from irgspp.core.stages.second.solver.multi_view_samples import MultiViewSamples, sample_views
from irgspp.core.stages.second.solver.view_choice import MIN_FACING_COSINE

OFFSET, COUNT = 0.03, 400
OCCLUDER, SIZE = np.array([0.0, -1.4, 1.2]), 0.6  # a ball in front of the sphere


def shown(position, camera):
    """Return the linear colour (..., 3) of points on the sphere as a camera sees them."""
    toward = camera.centre - position
    toward = toward / np.linalg.norm(toward, axis=-1, keepdims=True)
    return 0.3 + 0.15 * position + 0.1 * toward


def photograph(camera, image=shown):
    """Render the sphere on black, without a mask."""
    ray = camera.rays().astype(float)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ray @ camera.centre
    root = along**2 - camera.centre @ camera.centre + 1
    point = camera.centre + (-along - np.sqrt(np.maximum(root, 0)))[..., None] * ray
    linear = np.where(root[..., None] >= 0, image(point, camera), 0)
    return View("a", camera, Path("a.png"), encode_srgb(linear).astype(np.float32), None)


def tree(*parts):
    first, *others = parts
    for other in others:
        first = first.joined(other)
    return SurfelTree.build(first.position, first.quaternion, first.log_scale, first.opacity)


def ball(centre, radius, count):
    z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * 2.39996322972865
    normal = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
    return surfels(
        centre + radius * normal, normal, np.full((count, 3), 0.5), np.full(count, 0.65 * radius * np.sqrt(4 * np.pi / count)), 0.99
    )


@pytest.fixture(scope="module")
def cameras(camera_ring):
    return camera_ring(20, 96)


@pytest.fixture(scope="module")
def sphere():
    return tree(ball(np.zeros(3), 1.0, 5000))


@pytest.fixture(scope="module")
def points():
    normal = np.random.default_rng(0).normal(size=(COUNT, 3))
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
    return normal, normal


def look(points, views, tree, most=100, least=3, seed=0):
    tracer = SimpleNamespace(tree=tree, offset=OFFSET, device="cpu")
    return sample_views(*points, views, tracer, np.random.default_rng(seed), most, least)


def pairs(seen, chosen, cameras):
    """Return the set of (point, camera) of all samples; the camera is found by the direction."""
    position = seen.position[seen.point].numpy()[:, None]
    toward = np.stack([c.centre for c in cameras]) - position
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    apart = np.abs(toward - seen.view.numpy()[:, None]).max(-1)
    assert (apart.min(1) < 1e-5).all()
    return set(zip(chosen.numpy()[seen.point].tolist(), apart.argmin(1).tolist(), strict=True))


def facing(points, camera, lowest=MIN_FACING_COSINE):
    toward = camera.centre - points[0]
    return (toward * points[1]).sum(1) > lowest * np.linalg.norm(toward, axis=1)


def test_every_camera_that_faces_a_point_samples_it(points, cameras, sphere):
    seen, chosen = look(points, [photograph(c) for c in cameras], sphere)
    expected = {(int(p), c) for c, camera in enumerate(cameras) for p in np.flatnonzero(facing(points, camera))}
    count = np.bincount([p for p, _ in expected], minlength=COUNT)
    expected = {(p, c) for p, c in expected if count[p] >= 3}
    actual = pairs(seen, chosen, cameras)
    assert actual <= expected and len(actual) > 0.98 * len(expected)  # surfels may block grazing rays
    assert len(actual) == len(seen.point)


def test_colours_are_the_photographs_in_linear_light(points, cameras, sphere):
    seen, _ = look(points, [photograph(c) for c in cameras], sphere)
    position, view = seen.position[seen.point].numpy(), seen.view.numpy()
    expected = 0.3 + 0.15 * position + 0.1 * view
    error = np.abs(seen.colour.numpy() - expected)[(view * position).sum(1) > 0.4]
    assert len(error) > 1000 and error.max() < 3e-3
    assert not seen.saturated.any()


def test_samples_of_a_point_are_adjacent(points, cameras, sphere):
    seen, chosen = look(points, [photograph(c) for c in cameras], sphere)
    assert (seen.point.diff() >= 0).all()
    assert torch.equal(seen.lengths, torch.bincount(seen.point)) and (seen.lengths > 0).all()
    assert (chosen.diff() > 0).all()
    np.testing.assert_array_equal(seen.position, points[0][chosen])
    np.testing.assert_array_equal(seen.normal, points[1][chosen])
    np.testing.assert_allclose(seen.view.norm(dim=1), 1, atol=1e-6)
    types = (seen.position, seen.normal, seen.view, seen.colour)
    assert all(t.dtype == torch.float32 and t.is_contiguous() for t in types)


def test_most_keeps_some_at_random_and_least_leaves_points_out(points, cameras, sphere):
    views = [photograph(c) for c in cameras]
    whole, of_whole = look(points, views, sphere)
    count = np.zeros(COUNT, int)
    count[of_whole] = whole.lengths
    some, of_some = look(points, views, sphere, most=4, least=5)
    assert set(of_some.tolist()) == set(np.flatnonzero(count >= 5)) and 0 < len(of_some) < len(of_whole)
    assert (some.lengths == 4).all()
    kept = pairs(some, of_some, cameras)
    assert kept < pairs(whole, of_whole, cameras)
    assert len({camera for _, camera in kept}) == len(cameras)  # no camera is preferred
    other, _ = look(points, views, sphere, most=4, least=5, seed=1)
    again, _ = look(points, views, sphere, most=4, least=5)
    assert not torch.equal(some.view, other.view)
    assert torch.equal(some.view, again.view) and torch.equal(some.colour, again.colour) and torch.equal(some.point, again.point)


def test_what_stands_in_the_way_hides(points, cameras):
    """Against the exact intersection of rays with a ball; a rim where surfels are half transparent is ignored."""
    both = tree(ball(np.zeros(3), 1.0, 5000), ball(OCCLUDER, SIZE, 2000))
    seen, chosen = look(points, [photograph(c) for c in cameras], both, least=1)
    actual = pairs(seen, chosen, cameras)
    hidden = 0
    for c, camera in enumerate(cameras):
        toward = camera.centre - points[0]
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        start = points[0] + OFFSET * points[1] - OCCLUDER
        along = (start * toward).sum(1)
        nearest = np.sqrt((start * start).sum(1) - np.where(along < 0, along**2, 0))
        for p in np.flatnonzero(facing(points, camera, 0.3)):
            if abs(nearest[p] - SIZE) > 0.06:
                assert ((p, c) in actual) == (nearest[p] > SIZE), (p, c)
                hidden += nearest[p] < SIZE
    assert hidden > 50


def test_clipped_channels_are_marked(points, cameras, sphere):
    def clipped(position, camera):
        return np.stack([position[..., 0], np.full(position.shape[:-1], 0.5), 0.2 + position[..., 2]], -1).clip(0, 0.75) / 0.75

    seen, _ = look(points, [photograph(c, clipped) for c in cameras], sphere)
    position = seen.position[seen.point]
    steep = ((position * seen.view).sum(1) > 0.5).numpy()  # pixels cover little of the surface there
    x, z = position[steep, 0].numpy(), position[steep, 2].numpy() + 0.2
    limit = float(decode_srgb(np.array(MIN_SATURATED))) * 0.75
    for value, channel in ((x, 0), (z, 2)):  # any of the four pixels around a point counts, so the border is one pixel wide
        flag = seen.saturated[steep, channel].numpy()
        assert flag[value > limit + 0.05].all() and not flag[value < limit - 0.05].any()
        assert 0.02 < flag.mean() < 0.5
    assert not seen.saturated[:, 1].any()


def test_masks_leave_out_what_mixes_with_the_background(points, cameras, sphere):
    def masked(camera):
        view = photograph(camera)
        alpha = np.ones((camera.height, camera.width), np.float32)
        alpha[:, camera.width // 2 :] = 0.98
        return View("a", camera, view.path, view.colour, alpha)

    whole, of_whole = look(points, [photograph(c) for c in cameras], sphere, least=1)
    seen, chosen = look(points, [masked(c) for c in cameras], sphere, least=1)
    expected = set()
    for p, c in pairs(whole, of_whole, cameras):
        camera = cameras[c]
        at = camera.world_to_cv[:3, :3] @ points[0][p] + camera.world_to_cv[:3, 3]
        if camera.fx * at[0] / at[2] + camera.cx < camera.width / 2 - 0.5:  # both columns around it are left of the middle
            expected.add((p, c))
    assert pairs(seen, chosen, cameras) == expected and expected


def test_points_behind_a_camera_or_beside_its_image_are_not_seen(points, sphere):
    away = Camera(96, 96, 125.0, 125.0, 48.0, 48.0, look_at(np.array([0.0, -4.0, 0.5]), np.array([0.0, -8.0, 0.5])))
    aside = Camera(96, 96, 125.0, 125.0, 48.0, 48.0, look_at(np.array([0.0, -4.0, 0.5]), np.array([8.0, -4.0, 0.5])))
    seen, chosen = look(points, [photograph(away), photograph(aside)], sphere, least=1)
    assert len(seen.position) == len(seen.point) == len(chosen) == 0


def some_samples():
    random = np.random.default_rng(2)
    lengths = [3, 1, 4, 2]
    point = torch.tensor(np.repeat(np.arange(4), lengths))
    rows = lambda n: torch.from_numpy(random.random((n, 3)).astype(np.float32))  # noqa: E731
    return MultiViewSamples(rows(4), rows(4), point, rows(10), rows(10), rows(10) > 0.5)


def test_sums_are_those_of_a_loop():
    seen = some_samples()
    for values in (seen.colour, seen.colour[:, 0], torch.rand(10, 2, 5)):
        expected = [values[[k for k in range(10) if seen.point[k] == p]].sum(0) for p in range(4)]
        np.testing.assert_allclose(seen.sums(values), torch.stack(expected), rtol=1e-6)


@pytest.mark.parametrize(("begin", "end"), [(0, 4), (1, 3), (2, 2), (3, 4)])
def test_parts_hold_their_points_and_their_views_only(begin, end):
    seen = some_samples()
    part, views = seen.part(begin, end), (seen.point >= begin) & (seen.point < end)
    assert torch.equal(part.position, seen.position[begin:end]) and torch.equal(part.normal, seen.normal[begin:end])
    assert torch.equal(part.point + begin, seen.point[views])
    for name in ("view", "colour", "saturated"):
        assert torch.equal(getattr(part, name), getattr(seen, name)[views])
