# SPDX-License-Identifier: GPL-3.0-or-later
"""Gradient descent through the rendering equation, on a sphere in one colour under a white sky."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gaussians import METALLIC
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.surface import Surface
from irgspp.core.settings.schema import SecondStageSettings
from irgspp.core.shading.environment_lookup import rotate
from irgspp.core.stages.second.held_back import held_back
from irgspp.core.stages.second.metal import METALLIC_THRESHOLD
from irgspp.core.stages.second.radiance_refit import refit_radiance
from irgspp.core.stages.second.refinement import refinement as module
from irgspp.core.stages.second.refinement.pixel_pool import pool_pixels, with_surface_normals
from irgspp.core.stages.second.refinement.refinement import METAL_PIXEL_SHARE, Refinement, split_samples
from irgspp.core.surface.normal_images import SURFACE_WEIGHT

SETTINGS = SecondStageSettings(iterations=40, pixels=64, samples=16, pool=4000, normal_rate=1e-4)


@pytest.fixture(scope="module")
def start(splat_sphere):
    """Function that makes the sphere under a white sky with albedo 0.5, roughness 0.5 and a given metallic."""

    def make(metallic=0.02):
        material = torch.tensor([0.5, 0.5, 0.5, 0.5, metallic])[:, None].expand(5, 3000)
        surfels = replace(splat_sphere(3000, opacity=0.999), material=torch.logit(material).contiguous())
        return Reconstruction(surfels, torch.ones(8, 16, 3), Bound((0.0, 0.0, 0.0), 1.5), np.eye(4))

    return make


@pytest.fixture(scope="module")
def photographs(sphere_dataset, camera_ring):
    return sphere_dataset(camera_ring(10)).train


def refinement(reconstruction, views):
    tracer = SecondaryTracer(reconstruction)
    pool = pool_pixels(views, tracer, SETTINGS.pool, np.random.default_rng(0))
    return Refinement(reconstruction, pool, tracer, SETTINGS, 0)


def test_pixels_are_shaded_by_the_light_of_their_photograph(start, photographs):
    """With the light of all photographs turned by a quarter about +Z, pixels look as under a map that is turned so, but for noise."""
    first, quarter = start(), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    light = torch.ones(8, 16, 3) * torch.linspace(0.1, 2, 16)[:, None]
    turned = [replace(view, light_rotation=quarter) for view in photographs]
    rolled = torch.from_numpy(rotate(light.numpy(), -90.0)).float()
    shown = []
    for views, environment in ((turned, light), (photographs, rolled), (photographs, light)):
        trial = refinement(replace(first, environment=environment), views)
        pixels = torch.arange(0, trial.pool.count, 20)
        with torch.no_grad():
            shown.append(trial._shade(pixels, (128, 128, 256), environment, torch.Generator().manual_seed(0)))
    apart = [(one - shown[1]).abs().mean() / shown[1].mean() for one in (shown[0], shown[2])]
    assert apart[0] < 0.03 and apart[1] > 0.2


def test_what_was_held_back_is_shown_better_and_the_same_each_time(start, photographs):
    results = []
    for _ in range(2):
        trial = refinement(start(), photographs)
        before = trial.test()
        trial.run()
        assert trial.test() > before + 0.3
        results.append(trial.result())
    assert torch.equal(results[0].gaussians.material, results[1].gaussians.material)
    assert torch.equal(results[0].environment, results[1].environment)
    red, _, blue = results[0].gaussians.materials()[:3].mean(1)
    assert red > blue  # as in the photographs


def test_the_same_view_is_held_back_where_the_last_ones_show_nothing(start, photographs):
    blank = [replace(view, alpha=np.zeros_like(view.alpha)) for view in photographs[8:]]
    trial = refinement(start(), [*photographs[:8], *blank])
    assert trial.pool.number[trial.tested].unique().tolist() == held_back(len(photographs)).nonzero().flatten().tolist()
    assert trial.pool.number[trial.trained].unique().tolist() == [0, 1, 2, 3, 4, 6, 7]


def test_the_noise_of_few_samples_does_not_count_as_an_error(start, photographs, monkeypatch):
    """Against images of its own materials and light, the noise of single estimates is the whole error."""
    lamp = torch.full((8, 16, 3), 0.3)
    lamp[2, 5] = 60.0
    trial, few = refinement(replace(start(), environment=lamp), photographs), (4, 8, 4)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        trial.pool.colour[trial.tested] = encode_srgb(trial._shade(trial.tested, (256, 512, 512), lamp, generator))
        single = trial._difference(trial._shade(trial.tested, few, lamp, generator), trial.tested)
    monkeypatch.setattr(module, "TEST_SAMPLES", few)
    noise = -10 * math.log10(float(single.square().mean()))
    assert trial.test() > noise + 6, noise


def test_further_pixels_show_the_metal_parts_of_an_object(start, photographs):
    """A tenth of the surfels are metal; nothing is drawn in addition where none, or the whole object, is."""
    first = start()
    material = first.gaussians.material.clone()
    material[METALLIC, first.gaussians.position[2] > 0.6] = torch.logit(torch.tensor(0.98))
    mixed = replace(first, gaussians=replace(first.gaussians, material=material))
    shares = []
    for reconstruction in (first, mixed, start(0.98)):
        trial, drawn = refinement(reconstruction, photographs), []
        shade = trial._shade
        trial._shade = lambda pixels, *rest, shade=shade, drawn=drawn: drawn.append(pixels) or shade(pixels, *rest)
        metal = trial._materials(torch.arange(trial.pool.count))[3] > METALLIC_THRESHOLD
        trial.step()
        shares.append((len(drawn[0]), float(metal[drawn[0]].float().mean()), float(metal.float().mean())))
    assert [count for count, _, _ in shares] == [64, 64 + round(64 * METAL_PIXEL_SHARE), 64]
    assert shares[1][1] > shares[1][2] + 0.15


def test_only_what_is_no_metal_turns_and_may_become_one(start, photographs):
    for metallic, free in ((0.02, True), (0.95, False)):
        first = start(metallic).gaussians
        trial = refinement(start(metallic), photographs)
        trial.run(lambda done: done == 3)
        refined = trial.result().gaussians
        assert torch.equal(refined.quaternion, first.quaternion) != free
        assert torch.equal(refined.material[METALLIC], first.material[METALLIC]) != free
        assert not torch.equal(refined.material[:METALLIC], first.material[:METALLIC])


def test_white_balance_is_a_mean_over_solid_angle(start, photographs):
    """A tint of the two rows at the poles counts by their solid angle, not by their texels."""
    trial = refinement(start(), photographs)
    trial.settings = replace(trial.settings, white_balance=1.0)
    light = torch.ones(8, 16, 3)
    light[0, :, 0] = light[-1, :, 0] = 2.0
    red = 1 - np.cos(np.pi / 8)  # fraction of the sphere
    assert float(trial._white_balance(light)) == pytest.approx(4 / 9 * red, rel=1e-5)


def test_the_step_ends_the_run(start, photographs):
    done = []
    refinement(start(), photographs).run(lambda count: done.append(count) or count == 2)
    assert done == [1, 2]


def test_samples_are_split_without_loss():
    assert split_samples(128, (0.5, 0.25, 0.25)) == (64, 32, 32)
    assert min(split_samples(3, (0.125, 0.5, 0.375))) == 1


def test_radiance_is_fitted_and_nothing_else_moves(start, photographs):
    first = start()
    losses = []
    fitted = refit_radiance(first, photographs, 30, 0)
    for reconstruction in (first, fitted):
        colour = (0.5 + 0.28209479 * reconstruction.gaussians.sh[0]).mean(1)
        losses.append(float((colour - torch.tensor([0.604, 0.214, 0.033])).abs().sum()))  # (0.8, 0.5, 0.2) in linear light
    assert losses[1] < losses[0]
    for name, value in first.gaussians.tensors().items():
        assert torch.equal(value, fitted.gaussians.tensors()[name]) == (name != "sh"), name
    assert torch.equal(first.environment, fitted.environment)


@pytest.mark.parametrize("subpixels", [1, 2])
def test_a_view_without_the_object_gives_no_pixels(start, photographs, subpixels):
    empty = replace(photographs[0], alpha=np.zeros_like(photographs[0].alpha))
    pool = pool_pixels([empty, *photographs[1:]], SecondaryTracer(start()), SETTINGS.pool, np.random.default_rng(0), subpixels)
    assert pool.count and 0 not in pool.number


@pytest.mark.parametrize("subpixels", [1, 2])
def test_drawn_views_and_known_surfels_agree(start, photographs, subpixels):
    first = start()
    tracer = SecondaryTracer(first)
    pool = pool_pixels(photographs, tracer, SETTINGS.pool, np.random.default_rng(0), subpixels)
    known = Refinement(first, pool, tracer, SETTINGS, 0)
    drawn = Refinement(first, pool, tracer, SETTINGS, 0, cameras=[view.camera for view in photographs])
    pixels = torch.arange(0, pool.count, 50)
    ours, theirs = (trial.gbuffer.sums(first.gaussians, pixels) for trial in (known, drawn))
    assert (ours[:, 3:] - theirs[:, 3:]).abs().max() < 1e-3
    assert torch.nn.functional.cosine_similarity(ours[:, :3], theirs[:, :3]).min() > 0.99
    assert drawn.test() == pytest.approx(known.test(), abs=0.2)
    chosen = drawn.gbuffer.choose_pixels(drawn.trained, 20, torch.Generator().manual_seed(0))
    assert len(pool.number[chosen].unique()) == 1


def test_pixels_take_most_of_their_normal_from_the_surface(start, photographs):
    plain = refinement(start(), photographs)
    pixels = torch.arange(0, plain.pool.count, 20)
    with torch.no_grad():
        own = plain._materials(pixels)[0]
        turned = torch.nn.functional.normalize(torch.roll(own, 1, 1) + own, dim=1)
        known = torch.zeros(plain.pool.count, 3)
        known[pixels[::2]] = turned[::2]  # the others do not show the surface
        plain.pool = replace(plain.pool, surface_normal=known)
        mixed = plain._materials(pixels)[0]
    expected = torch.nn.functional.normalize((1 - SURFACE_WEIGHT) * own + SURFACE_WEIGHT * turned, dim=1)
    assert torch.allclose(mixed[::2], expected[::2], atol=1e-6) and torch.equal(mixed[1::2], own[1::2])


def test_a_pool_knows_the_normals_that_its_pixels_show(start, photographs):
    body = trimesh.creation.icosphere(5)
    surface = Surface(np.array(body.vertices), np.array(body.vertices), np.array(body.faces), 0.02)
    pool = pool_pixels(photographs, SecondaryTracer(start()), SETTINGS.pool, np.random.default_rng(0))
    known = with_surface_normals(pool, surface, [view.camera for view in photographs]).surface_normal
    assert known is not None
    radial = torch.nn.functional.normalize(pool.point, dim=1)
    assert float((known * radial).sum(1).median()) > 0.999 and float(known.norm(dim=1).median()) == pytest.approx(1, abs=1e-4)
