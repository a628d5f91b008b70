# SPDX-License-Identifier: GPL-3.0-or-later
"""A sphere of known materials under a white sky, rendered by Cycles in a child process, against its analytic radiance."""

import os
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.errors import IrgsppError
from irgspp.core.evaluation import cycles
from irgspp.core.evaluation.cycles import CyclesPass, compare, cycles_images
from irgspp.core.progress.protocol import Silent
from irgspp.core.shading.brdf import base_reflectance
from irgspp.core.shading.specular_albedo import diffuse_fraction, specular_albedo
from sphere_run import cameras, materials, write_run

SKY = np.full((8, 16, 3), 0.5, np.float32)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "sphere"
    write_run(folder)
    return folder


def under_the_sky(camera):
    """Return the linear radiance (H, W, 3) of the unit sphere under SKY, and its inner pixels; a convex body has no second bounce."""
    ray = camera.rays().astype(float)
    ray = ray.reshape(camera.height, camera.width, 3) / np.linalg.norm(ray.reshape(-1, 3), axis=-1).reshape(camera.height, camera.width, 1)
    along = ray @ camera.centre
    root = along**2 - camera.centre @ camera.centre + 1
    point = camera.centre + (-along - np.sqrt(np.maximum(root, 0)))[..., None] * ray
    albedo, roughness, metallic = (torch.from_numpy(np.ascontiguousarray(m)).flatten(0, 1).float() for m in materials(point))
    n_v = torch.from_numpy(-(point * ray).sum(-1)).flatten().float().clamp(1e-3, 1)
    body = albedo * (1 - metallic)[:, None] * diffuse_fraction(n_v, roughness)[:, None]
    shown = 0.5 * (body + specular_albedo(n_v, roughness, base_reflectance(albedo, metallic[:, None])))
    return shown.view(*root.shape, 3).numpy(), (root > 0.3) & (np.abs(point[..., 2]) > 0.1)


def test_a_white_sky_shows_the_materials(run):
    wide = cameras()[0]
    rendered = cycles_images(run, {"a": wide}, {"sky": SKY}, [CyclesPass(64, False), CyclesPass(8, True)], Silent(), "attributes")
    exact, denoised = rendered["a", "sky"]
    expected, inside = under_the_sky(wide)
    assert exact.rgba.shape == (wide.height, wide.width, 4) and inside.sum() > 300
    assert (exact.rgba[inside, 3] == 1).all() and exact.rgba[0, 0, 3] == 0
    error = np.abs(exact.rgba[..., :3] - expected)[inside]
    assert np.median(error) < 0.01 and np.quantile(error, 0.9) < 0.03
    assert np.abs(denoised.rgba - exact.rgba)[inside].mean() < 0.02
    assert exact.seconds > 0 and denoised.seconds > 0


def test_views_and_lights_are_not_confused(run, monkeypatch):
    """The comparison pairs each of our images with Cycles' of the same view and light."""
    lights = {"dim": SKY, "bright": 2 * SKY}
    views = dict(zip("ab", cameras()[:2], strict=True))
    monkeypatch.setattr(cycles, "SAMPLES", 8)

    def relit(camera, light):
        shown, inside = under_the_sky(camera)
        rgba = np.concatenate([shown * float(light.radiance.max()) / 0.5, np.ones((*shown.shape[:2], 1))], -1)
        return torch.from_numpy(rgba * inside[..., None])

    relighter = SimpleNamespace(surface=lambda camera: camera, relit=relit)
    found = compare(relighter, run, views, lights, Silent())
    assert [(one.view, one.light) for one in found] == [("a", "dim"), ("a", "bright"), ("b", "dim"), ("b", "bright")]
    for one in found:
        inside = under_the_sky(views[one.view])[1]
        assert np.abs(one.ours - one.theirs)[inside].mean() < 0.02
        difference = np.abs(one.ours - one.theirs)
        shown = (one.ours.max(-1) > 0) | (one.theirs.max(-1) > 0)
        assert one.metrics["cycles_difference"] == pytest.approx(difference.sum() / shown.sum() / 3)
        assert one.metrics["cycles_psnr"] == pytest.approx(-10 * np.log10((difference**2).mean()))


def test_a_run_that_is_not_finished_is_one_line(tmp_path):
    with pytest.raises(IrgsppError, match=r"Cycles did not render it: .*cameras\.json"):
        cycles_images(tmp_path, {}, {"sky": SKY}, [CyclesPass(1, False)], Silent())


def test_without_blender_it_says_so(run, monkeypatch):
    monkeypatch.setitem(os.environ, "IRGSPP_BLENDER", "no such blender")
    with pytest.raises(IrgsppError, match="no such blender"):
        cycles_images(run, {}, {}, [], Silent())
