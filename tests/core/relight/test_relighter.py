# SPDX-License-Identifier: GPL-3.0-or-later
"""Relit images: energy conservation, shadows, agreement of the backends."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.relight import primary_hits
from irgspp.core.relight import relighter as module
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.relight.relighter import Relighter
from irgspp.core.scene.camera import Camera
from irgspp.core.shading.brdf import base_reflectance
from irgspp.core.shading.procedural_lights import studio_light, sunset_light
from irgspp.core.shading.specular_albedo import specular_albedo

BACKENDS = ("mesh", "gaussian")
WHITE = prepare_light(np.ones((16, 32, 3), np.float32))
BALL = ((np.zeros(3), 1.0),)


def pixels(one: Relighter, camera: Camera, light=WHITE):
    """The visible surface, and the straight colour of its opaque pixels, with their mask."""
    surface = one.surface(camera)
    rgba = one.relit(surface, light)
    solid = surface.alpha > 0.99
    return surface, rgba.view(-1, 4)[surface.index[solid], :3], solid


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("material", [(0.5, 0.5, 0.5, 0.8, 0.0), (1.0, 0.9, 0.8, 0.3, 1.0)])
@pytest.mark.parametrize("conserving", [False, True])
def test_white_furnace(relighter, camera, backend, material, conserving):
    """A convex body under a white sky reflects its albedo plus the directional albedo of the lobe, at most 1 if conserving."""
    one = relighter(backend, material, BALL, samples=256, conserving=conserving)
    surface, seen, solid = pixels(one, camera)
    facing = (surface.normal * surface.view).sum(-1)[solid].clamp_min(1e-3)
    albedo, roughness, metallic = (getattr(surface, name)[solid] for name in ("albedo", "roughness", "metallic"))
    lobe = specular_albedo(facing, roughness, base_reflectance(albedo, metallic[:, None]))
    dielectric = specular_albedo(facing, roughness, base_reflectance(albedo, torch.zeros_like(metallic)[:, None]))
    body = albedo * (1 - metallic[:, None]) * (1 - dielectric if conserving else 1)
    inner = facing > 0.3  # near the silhouette mean normals of a pixel are not its mean reflection
    assert inner.sum() > 500
    error = (seen - body - lobe).abs()[inner]
    assert error.mean() < 0.01 and error.quantile(0.99) < 0.05
    if conserving:
        assert seen[inner].max() < 1.02


@pytest.mark.parametrize("material", [(0.6, 0.4, 0.2, 0.7, 0.0), (0.9, 0.7, 0.3, 0.3, 1.0)])
def test_backends_agree_on_balls_that_shade_each_other(relighter, camera, material):
    light = prepare_light(studio_light(32, 64))
    _, mesh, solid = pixels(relighter("mesh", material, mesh_normals=0.0), camera, light)
    _, gaussian, same = pixels(relighter("gaussian", material), camera, light)
    assert torch.equal(solid, same)
    assert (mesh - gaussian).abs().mean() < 0.03 * mesh.mean()


def test_shadow_and_indirect_light(relighter, camera):
    """A ball shadows the one below it; indirect light only adds."""
    lamp = np.zeros((32, 64, 3), np.float32)
    lamp[:4] = 5.0  # overhead
    light = prepare_light(lamp)
    single = relighter("mesh", balls=BALL)
    alone = single.relit(single.surface(camera), light)
    lit, dark = (relighter("mesh", indirect=indirect, denoise="off") for indirect in (True, False))
    both, shadowed = lit.relit(lit.surface(camera), light), dark.relit(dark.surface(camera), light)
    assert (both[..., :3] - shadowed[..., :3]).min() > -1e-6 and (both - shadowed).max() > 0.01
    column, rows = 50, slice(29, 34)  # on the large ball, below the small one
    assert shadowed[rows, column, 1].mean() < 0.8 * alone[rows, column, 1].mean()


def test_without_shadows_all_light_arrives_and_what_surfaces_reflect_adds_to_it(relighter, camera):
    """Two balls then are lit as each alone, and their reflections on each other only add."""
    light = prepare_light(studio_light(32, 64))
    images = {}
    for shadows in (True, False):
        for indirect in (True, False):
            one = relighter("mesh", indirect=indirect, shadows=shadows, denoise="off", samples=64)
            images[shadows, indirect] = one.relit(one.surface(camera), light)[..., :3]
    assert (images[False, False] - images[True, False]).min() > -2e-3 and (images[False, False] - images[True, False]).max() > 0.05
    added, reflected = images[False, True] - images[False, False], images[True, True] - images[True, False]
    assert added.min() > -1e-4 and added.max() > 0.01
    assert (added - reflected).abs().max() < 0.35 * reflected.max()  # the same light; the ratio estimator scales it differently
    single = relighter("mesh", balls=BALL, denoise="off", samples=64)
    surface = single.surface(camera)
    alone, open_pair = single.relit(surface, light)[..., :3], images[False, False]
    below = (slice(33, 40), slice(40, 56))  # on the large ball, beside the small one
    assert torch.allclose(open_pair[below], alone[below], atol=0.02)


def test_samples_are_divided_as_asked(relighter):
    assert relighter("mesh", samples=32).counts == (8, 8, 16)
    assert relighter("mesh", samples=32, allocation=(1, 4, 3)).counts == (4, 16, 12)


def test_without_the_known_irradiance_the_noise_is_larger_and_the_mean_the_same(relighter, camera):
    light = prepare_light(studio_light(32, 64))
    exact, plain, many = (
        relighter("mesh", samples=count, ratio=ratio, denoise="off") for count, ratio in ((16, True), (16, False), (1024, False))
    )
    truth = many.relit(many.surface(camera), light)
    errors = [(one.relit(one.surface(camera), light) - truth).square().mean().sqrt() for one in (exact, plain)]
    assert errors[0] < 0.7 * errors[1]
    assert abs(float((plain.relit(plain.surface(camera), light) - truth).mean())) < 0.01


def test_rays_start_on_the_mesh_where_a_pixel_s_mean_depth_lies_inside_it(relighter, camera):
    """As at a silhouette before another surface; where the mesh lies far behind, floating surfels are lit where they are."""
    one = relighter("mesh", balls=BALL)
    surface = one.surface(camera)
    steep = ((surface.normal * surface.view).sum(-1) > 0.5) & (surface.alpha > 0.99)
    for shift, on_ball in ((-0.5, True), (0.5, False)):
        moved = dataclasses.replace(surface, point=surface.point + shift * surface.view)
        height = one.query.origins(moved).norm(dim=1)[steep] - 1
        assert (height > 0).all() and ((height < 0.02).all() == on_ball)


def test_same_image_twice_bit_by_bit(relighter, camera):
    light = prepare_light(sunset_light(32, 64))
    first, second = (relighter("gaussian", samples="efficient") for _ in range(2))
    image = first.relit(first.surface(camera), light)
    assert torch.equal(image, first.relit(first.surface(camera), light))
    assert torch.equal(image, second.relit(second.surface(camera), light))


@pytest.mark.parametrize("sampling", ["mis", "stratified"])
@pytest.mark.parametrize("kept_bytes", [1 << 29, 1 << 18, 0])
def test_another_light_on_the_same_surface_is_the_same_image_as_alone(relighter, camera, monkeypatch, sampling, kept_bytes):
    monkeypatch.setattr(module, "CACHE_BYTES", kept_bytes)
    monkeypatch.setattr(module, "RAYS", 1 << 14)  # several parts
    lights = [prepare_light(light) for light in (studio_light(32, 64), sunset_light(16, 32))]
    one = relighter("mesh", samples=32, sampling=sampling)
    surface = one.surface(camera)
    kept = [one.relit(surface, light) for light in (*lights, *lights)]
    alone = [one.relit(one.surface(camera), light) for light in lights]
    assert all(torch.equal(a, b) for a, b in zip(kept, (*alone, *alone), strict=True))
    assert not torch.allclose(*alone)


def test_rays_are_kept_for_the_next_light_and_let_go_with_the_surface(relighter, camera):
    one, asked = relighter("mesh", samples=32), []
    query = one.query
    one.query = SimpleNamespace(
        origins=query.origins,
        hits=lambda o, d: asked.append(len(o)) or query.hits(o, d),
        hidden=lambda o, d: asked.append(len(o)) or query.hidden(o, d),
    )
    surface, light = one.surface(camera), prepare_light(studio_light(32, 64))
    for _ in range(2):
        one.relit(surface, light)
    first, second = sum(asked[:-2]), sum(asked[-2:])  # cosine and visible normals once, light samples each time
    assert 0 < second < 0.6 * first
    assert len(one._ray_cache) == 2  # single points, and rays of pixels at edges
    del surface
    assert len(one._ray_cache) == 0


def test_what_nothing_shades_is_exact_with_few_samples(relighter, camera):
    """A convex matt body: sampling determines visibility alone, and all light is visible."""
    light = prepare_light(sunset_light(64, 128))
    few, many = (relighter("mesh", (0.6, 0.5, 0.4, 1.0, 0.0), BALL, samples=n, denoise="off") for n in (16, 2048))
    surface = few.surface(camera)
    solid = (surface.alpha > 0.99) & ((surface.view * surface.normal).sum(-1) > 0.3)
    rough, fine = (one.relit(surface, light).view(-1, 4)[surface.index[solid], :3] for one in (few, many))
    assert ((rough - fine).abs() / fine).median() < 0.02


def test_strategies_agree_and_mis_is_less_noisy(relighter, camera):
    light = prepare_light(sunset_light(32, 64))
    glossy = (0.9, 0.7, 0.3, 0.3, 1.0)
    converged, mis, strata, many = (
        pixels(relighter("mesh", glossy, samples=n, sampling=sampling, denoise="off"), camera, light)[1]
        for n, sampling in ((1024, "mis"), (32, "mis"), (32, "stratified"), (2048, "stratified"))
    )
    assert many.mean() == pytest.approx(float(converged.mean()), rel=0.02)
    assert mis.mean() == pytest.approx(float(converged.mean()), rel=0.02)
    assert (mis - converged).square().mean() < 0.2 * (strata - converged).square().mean()


def test_albedo_scale_holds_for_what_is_seen_in_reflections_too(relighter, camera):
    """A matt scene of half the albedo equals the scaled one."""
    whole, half = (relighter("mesh", (a, a, a, 0.9, 0.0)) for a in (0.8, 0.4))
    reference = half.relit(half.surface(camera), WHITE)
    scaled = whole.with_albedo_scale((0.5, 0.5, 0.5))
    assert torch.allclose(scaled.relit(scaled.surface(camera), WHITE), reference, atol=1e-3)
    assert scaled.settings == dataclasses.replace(whole.settings, albedo_scale=(0.5, 0.5, 0.5))
    assert whole.with_albedo_scale(None) is whole


def test_image_is_linear_in_the_light(relighter, camera):
    one = relighter("mesh", denoise="off")
    surface, light = one.surface(camera), sunset_light(32, 64)
    single, triple = (one.relit(surface, prepare_light(light * factor)) for factor in (np.float32(1), np.float32(3)))
    assert torch.allclose(triple[..., :3], 3 * single[..., :3], rtol=2e-3, atol=2e-3)
    assert torch.equal(triple[..., 3], single[..., 3])


@pytest.mark.parametrize("denoise", ["off", "paper", "demodulated"])
def test_no_light_is_black(relighter, camera, denoise):
    one = relighter("mesh", denoise=denoise)
    rgba = one.relit(one.surface(camera), prepare_light(np.zeros((8, 16, 3), np.float32)))
    assert not rgba[..., :3].any() and rgba[..., 3].max() == 1


@pytest.mark.parametrize("backend", BACKENDS)
def test_cameras_that_see_nothing_and_cameras_inside(relighter, camera, backend):
    one = relighter(backend)
    back = camera.to_world.copy()
    back[:3, 0], back[:3, 2] = -back[:3, 0], -back[:3, 2]
    assert not one.relit(one.surface(dataclasses.replace(camera, to_world=back)), WHITE).any()
    inside = camera.to_world.copy()
    inside[:3, 3] = 0
    rgba = one.relit(one.surface(dataclasses.replace(camera, to_world=inside)), WHITE)
    assert torch.isfinite(rgba).all()


def test_efficient_takes_fewer_samples_where_most_is_metal(relighter):
    assert relighter("gaussian", samples="efficient").counts == (8, 8, 16)
    assert relighter("gaussian", (0.9, 0.9, 0.9, 0.3, 1.0), samples="efficient").counts == (2, 8, 6)


def test_light_is_looked_up_at_full_resolution_in_mirrors(relighter, camera):
    """A lamp smaller than a texel of the prefiltered light still makes a sharp highlight on a smooth ball."""
    lamp = np.full((256, 512, 3), 0.1, np.float32)
    lamp[60:62, 383:385] = 500.0  # towards -Y, where the camera is, and up
    one = relighter("mesh", (0.9, 0.9, 0.9, 0.1, 1.0), BALL, samples=256, denoise="off", mesh_normals=1.0)
    assert isinstance(one.settings, RelightSettings)
    rgba = one.relit(one.surface(camera), prepare_light(lamp))
    assert rgba[..., 0].max() > 20 * rgba[..., 0][rgba[..., 3] > 0.99].median()


def test_rays_of_pixels_at_edges_are_shaded_apart(relighter, camera):
    """At outlines before another surface, divided pixels come closer to an image of twice the resolution than pixels of one point."""
    light, material = prepare_light(studio_light(32, 64)), (0.9, 0.7, 0.3, 0.3, 1.0)
    exact = relighter("mesh", material, samples=512, divide=False, denoise="off")
    finer = exact.relit(exact.surface(camera.resized(4 * camera.width, 4 * camera.height)), light)
    goal = torch.nn.functional.avg_pool2d(finer.permute(2, 0, 1), 4).permute(1, 2, 0)
    error = {}
    for divide in (True, False):
        one = relighter("mesh", material, samples=512, divide=divide, denoise="off")
        surface = one.surface(camera)
        assert (surface.divided is not None) == divide
        if divide:
            edges, rays = surface.index[surface.divided.ray_row.unique()], len(surface.divided.rays.index)
        error[divide] = (one.relit(surface, light) - goal).abs().mean(-1).flatten()
    assert 0.02 < len(edges) / len(surface.index) < 0.5
    assert 2 * len(edges) < rays <= 4 * len(edges)
    others = torch.ones(len(error[True]), dtype=torch.bool)
    others[edges] = False
    assert error[True][edges].mean() < 0.7 * error[False][edges].mean()
    assert torch.allclose(error[True][others], error[False][others], atol=1e-3)  # their tiles share other directions without occluders


def test_divided_rays_share_their_pixel(relighter, camera):
    surface = relighter("gaussian").surface(camera)
    divided = surface.divided
    rows = torch.cat([divided.single_row, divided.ray_row.unique()]).sort().values
    assert torch.equal(rows, torch.arange(len(surface.index)))
    total = torch.zeros(len(surface.index)).index_add(0, divided.ray_row, divided.share)
    assert total[divided.ray_row].sub(1).abs().max() < 1e-6
    albedo = divided.joined(divided.single.albedo, divided.rays.albedo)
    assert (albedo - surface.albedo).abs().max() < 1e-3
    mean = torch.nn.functional.normalize(divided.joined(divided.single.normal, divided.rays.normal), dim=1)
    assert ((mean * surface.normal).sum(1) > 0.9).float().mean() > 0.99


def test_pixels_of_divided_hits_are_those_of_whole_pixels(relighter, camera):
    one = relighter("mesh")
    whole, divided = relighter("mesh", divide=False).surface(camera), one.surface(camera)
    assert torch.equal(whole.index, divided.index)
    for name in ("point", "normal", "albedo", "roughness", "metallic", "alpha", "origin", "coverage"):
        assert torch.allclose(getattr(whole, name), getattr(divided, name), atol=1e-5), name
    assert torch.allclose(one.query.origins(dataclasses.replace(divided, point=divided.point.clone())), divided.origin, atol=1e-6)


def test_tall_images_are_rasterised_in_bands(relighter, camera, monkeypatch):
    whole = relighter("gaussian").surface(camera).divided.rays
    monkeypatch.setattr(primary_hits, "BAND", 4 * camera.width * 7)
    parts = relighter("gaussian").surface(camera).divided.rays
    assert torch.equal(whole.index, parts.index)
    assert torch.allclose(whole.normal, parts.normal, atol=1e-5)
    assert torch.allclose(whole.coverage, parts.coverage, atol=1e-5)


def of_irgs(one, **settings) -> Relighter:
    """The same relighter for materials of IRGS' BRDF."""
    scene = dataclasses.replace(one.reconstruction, brdf="irgs")
    return Relighter(scene, one.query, dataclasses.replace(one.settings, **settings), one.mesh)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("roughness", [0.2, 0.8])
def test_white_furnace_of_irgs(relighter, camera, backend, roughness):
    """A convex body reflects its whole albedo plus the directional albedo of IRGS' lobe, whatever its metallic says."""
    one = of_irgs(relighter(backend, (0.5, 0.4, 0.3, roughness, 0.7), BALL, samples=256))
    surface, seen, solid = pixels(one, camera)
    facing = (surface.normal * surface.view).sum(-1)[solid].clamp_min(1e-3)
    lobe = specular_albedo(facing, surface.roughness[solid], torch.full((int(solid.sum()), 3), 0.04), "irgs")
    error = (seen - surface.albedo[solid] - lobe).abs()[facing > 0.3]
    assert error.mean() < 0.01 and error.quantile(0.99) < 0.05 and not surface.metallic.any()


def test_materials_are_relit_by_the_brdf_they_were_fitted_with_unless_another_is_asked_for(relighter, camera):
    light = prepare_light(studio_light(32, 64))
    ours = relighter("mesh", (0.6, 0.4, 0.2, 0.5, 0.3), indirect=True)
    images = {}
    for name, one in {
        "principled": ours,
        "irgs": of_irgs(ours),
        "asked": Relighter(ours.reconstruction, ours.query, dataclasses.replace(ours.settings, brdf="irgs"), ours.mesh),
        "asked back": of_irgs(ours, brdf="principled"),
    }.items():
        images[name] = one.relit(one.surface(camera), light)
    assert torch.equal(images["irgs"], images["asked"]) and torch.equal(images["principled"], images["asked back"])
    assert (images["irgs"] - images["principled"]).abs().max() > 0.02


def test_surfaces_that_rays_meet_have_the_brdf_too(relighter, camera):
    """Two balls of metal: without metal, the light that one casts on the other changes."""
    light = prepare_light(studio_light(32, 64))
    own = {}
    for name, brdf in (("irgs", None), ("principled", "principled")):
        lit, dark = (of_irgs(relighter("mesh", (0.6, 0.4, 0.2, 0.5, 1.0), indirect=i, denoise="off"), brdf=brdf) for i in (True, False))
        own[name] = lit.relit(lit.surface(camera), light) - dark.relit(dark.surface(camera), light)
    assert own["irgs"].max() > 0.005 and (own["irgs"] - own["principled"]).abs().max() > 0.002


def test_irgs_has_no_conserving_diffuse_lobe(relighter):
    with pytest.raises(InputError, match=r"--diffuse: conserving is of the principled BRDF.*--brdf principled"):
        of_irgs(relighter("mesh"), conserving=True)
    assert of_irgs(relighter("mesh"), conserving=True, brdf="principled").conserving
    assert not of_irgs(relighter("mesh")).conserving and relighter("mesh").conserving
