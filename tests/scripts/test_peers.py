# SPDX-License-Identifier: GPL-3.0-or-later
"""Peers get the same work: Mitsuba's images against sums over all texels, and values interpolated from curves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import View
from irgspp.core.shading.environment_lookup import solid_angles, texel_directions
from irgspp.core.shading.rendering_equation import reflect_light
from irgspp.core.shading.sampling import Samples
from scripts_folder import scripts_on_path
from sphere_run import axis_light, materials, sphere


@pytest.fixture(scope="module")
def load():
    """Import a module of the benchmark."""
    with scripts_on_path() as script:
        yield lambda name: script(f"benchmarks.{name}")


def sphere_from(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels in which a camera sees the unit sphere well inside its outline (H, W), and the points there (P, 3)."""
    ray = camera.rays().astype(np.float64)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = -(ray @ camera.centre)
    height2 = camera.centre @ camera.centre - along**2
    seen = height2 < 0.6
    return seen, camera.centre + (along - np.sqrt(np.maximum(1 - height2, 0)))[..., None][seen] * ray[seen]


def reflected(points: np.ndarray, eye: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Return the radiance that the sphere reflects to the eye, summed over every texel of the light, (P, 3)."""
    direction = texel_directions(*light.shape[:2]).reshape(1, -1, 3)
    density = 1 / (solid_angles(*light.shape[:2]).repeat_interleave(light.shape[1]) * direction.shape[1])
    normal = torch.from_numpy(points).float()
    view = torch.nn.functional.normalize(torch.from_numpy(eye).float() - normal, dim=1)
    count = len(normal)
    samples = Samples(direction.expand(count, -1, -1).contiguous(), density.expand(count, -1).contiguous())
    incoming = torch.from_numpy(light).reshape(1, -1, 3).expand(count, -1, -1).contiguous()
    surface = (torch.from_numpy(value) for value in materials(points))
    return torch.add(*reflect_light(view, normal, *surface, samples, incoming)).numpy()


def test_mitsuba_sees_what_we_see(load):
    peer = load("mitsuba_peer")
    if reason := peer.missing():
        pytest.skip(reason)
    mesh, light = sphere(rows=48, columns=96), axis_light(32)
    light[4:6, 10:12] = 8.0  # a lamp, so that nothing is symmetric
    thing = {name: getattr(mesh, name) for name in ("vertices", "normals", "faces", "uvs")}
    thing |= {f"texture_{name}": texture for name, texture in mesh.textures.items()}
    camera = Camera(32, 24, 28.0, 28.0, 14.0, 13.0, look_at((2.0, -2.2, 1.1)))
    shots = peer.images(thing, {"view": camera}, {"light": light}, [], converged=256)["view", "light"]
    seen, points = sphere_from(camera)
    ours, theirs = reflected(points, camera.centre, light), shots.converged[seen][:, :3]
    assert seen.sum() > 120 and np.ptp(ours) > 0.2
    off = np.abs(theirs / ours - 1)
    assert np.median(off) < 0.01 and off.mean() < 0.02  # pixels are areas there and points here: not alike where metal begins


def test_rays_of_the_pool_are_the_cameras(load):
    inverse = load("peer_inverse")
    cameras = [Camera(9, 7, 8.0, 11.0, 4.0, 3.6, look_at(eye)) for eye in ((3, 1, 1), (-1, 2, 4))]
    random = np.random.default_rng(0)
    alpha = (random.random((2, 7, 9)) > 0.5).astype(np.float32)
    views = [
        View("v", camera, Path("v.png"), random.random((7, 9, 3)).astype(np.float32), a) for camera, a in zip(cameras, alpha, strict=True)
    ]
    views[1] = replace(views[1], colour=np.ones((7, 9, 3), np.float32))
    pool = inverse.pool(views)
    number = pool["pixel_view"].astype(int)
    assert len(number) == alpha.sum() and pool["pixel_saturated"][number == 1].all() and not pool["pixel_saturated"][number == 0].any()
    column, row = pool["pixel_place"].T[:, :, None] + 0.5
    ray = pool["view_corner"][number] + column * pool["view_right"][number] + row * pool["view_down"][number]
    true = np.concatenate([camera.rays()[a > 0] for camera, a in zip(cameras, alpha, strict=True)])
    np.testing.assert_allclose(ray, true, atol=1e-6)
    np.testing.assert_allclose(pool["view_origin"], [camera.centre for camera in cameras], atol=1e-6)


def test_time_to_an_error_and_error_at_a_time(load):
    relighting = load("peer_relighting")
    points = [relighting.Point(n, 0.1 * n, 0.2 * n, 20 + 10 * np.log10(n)) for n in (1, 10, 100)]
    assert relighting.seconds_to(points, 15) == pytest.approx(0.1)
    assert relighting.seconds_to(points, 35) == pytest.approx(0.1 * 10**1.5)
    assert relighting.seconds_to(points, 41) is None
    assert relighting.psnr_at(points, 0.05) is None
    assert relighting.psnr_at(points, 10**0.5) == pytest.approx(35)
    assert relighting.psnr_at(points, 1e3) == pytest.approx(40)
    ours = [relighting.Point(16, 1.0, 4.0, 30.0)]
    duel = relighting.RendererComparison([{relighting.OURS: ours, relighting.MITSUBA: points}], {})
    assert duel.times_as_long(ours[0], relighting.MITSUBA) == pytest.approx(1.0)
    assert duel.times_as_long(ours[0], relighting.MITSUBA, "cpu_seconds") == pytest.approx(0.5)
    assert duel.at_our_time(ours[0], relighting.CYCLES) is None


def test_another_seed_where_mitsuba_crashes(load, monkeypatch):
    inverse, peer = load("peer_inverse"), load("mitsuba_peer")
    asked = []

    def ask(module, request, arrays):
        asked.append(request["seed"])
        if request["seed"] < survives:
            raise peer.Crashed(module)
        return {"states": []}, {}

    monkeypatch.setattr(peer, "run_child", ask)
    survives = inverse.SEEDS[-1]
    assert inverse._run_with_seeds({"budgets": [1.0]}, {}) == ({"states": []}, {}) and asked == list(inverse.SEEDS)
    survives += 1
    with pytest.raises(peer.Crashed):
        inverse._run_with_seeds({"budgets": [1.0]}, {})
