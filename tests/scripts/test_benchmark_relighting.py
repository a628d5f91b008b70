# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighting in the benchmark: known directions of its errors."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.mesh_ply import save_mesh_ply
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.shading.procedural_lights import LIGHTS
from irgspp.core.stages.first.initialization import surfels
from scripts_folder import script as script
from sphere_run import sphere

BALLS = ((np.zeros(3), 1.0), (np.array([1.1, -0.4, 0.9]), 0.45))  # they shade each other
MATERIAL = (0.7, 0.5, 0.3, 0.5, 0.0)


def write_balls(folder: Path, material: tuple[float, ...]) -> Path:
    """Write a run's Gaussians, light and mesh: two balls of one material."""
    meshes, splats = [], None
    for centre, radius in BALLS:
        one, count = sphere(48, 96), int(9000 * radius)
        z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * 2.39996322972865
        normal = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
        scale = np.full(count, 0.65 * radius * np.sqrt(4 * np.pi / count))
        some = surfels(centre + radius * normal, normal, np.full((count, 3), 0.5), scale, 0.99)
        splats = some if splats is None else splats.joined(some)
        meshes.append((one, (centre + radius * one.vertices).astype(np.float32)))
    assert splats is not None
    splats.material = torch.logit(torch.tensor(material).clamp(1e-6, 1 - 1e-6))[:, None].repeat(1, splats.count)
    Reconstruction(splats, torch.full((16, 32, 3), 0.5), Bound((0, 0, 0), 2.0), np.eye(4)).save(folder)
    faces = np.concatenate([one.faces + i * len(one.vertices) for i, (one, _) in enumerate(meshes)])
    n = sum(len(one.vertices) for one, _ in meshes)
    shape = [np.concatenate(parts) for parts in zip(*((v, one.normals, one.uvs) for one, v in meshes), strict=True)]
    filled = [np.full(n, value, np.float32) for value in material[3:]]
    save_mesh_ply(Mesh(*shape, faces, np.tile(np.float32(material[:3]), (n, 1)), *filled), folder / "mesh.ply")
    return folder


def lit_view(script, light: np.ndarray):
    """Return a camera's view of the balls under a light, without a true image."""
    camera = Camera(48, 48, 60.0, 60.0, 24.0, 24.0, look_at((1.5, -4.0, 2.0), (0.4, -0.1, 0.3)))
    inside = np.ones((48, 48), bool)
    return script("benchmarks.studio").LitView(SimpleNamespace(camera=camera), "light", prepare_light(light), np.zeros((48, 48, 3)), inside)


@pytest.fixture(scope="module")
def studio(script, tmp_path_factory):
    """Return the balls in sunlight."""
    run = write_balls(tmp_path_factory.mktemp("balls"), MATERIAL)
    light = LIGHTS["sunset"](32, 64)
    return script("benchmarks.studio").Studio(run, [lit_view(script, light)], {"mesh": 2048, "gaussian": 1024})


@pytest.fixture(scope="module")
def error(script, studio):
    """Return a function that measures the root mean square error of a variant with a number of samples."""
    variants = script("benchmarks.relighting").VARIANTS
    return lambda variant, samples: studio.errors(variants[variant], samples)["rms_error"]


def test_light_sampling_beats_strata(error, script):
    few = error("without denoiser", 64)
    assert few < 0.5 * error(script("benchmarks.relighting").PLAIN, 64)
    assert error("full", 16) < error("without MIS", 16)


def test_the_denoiser_helps_where_samples_are_few(error):
    assert error("full", 16) < 0.9 * error("without denoiser", 16)


def test_error_falls_with_samples_as_it_should(error):
    counts = (16, 64, 256)
    errors = [error("without denoiser", n) for n in counts]
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert -1.1 < slope < -0.4  # -1/2 for random samples, up to -1 for strata of something smooth


def test_both_backends_show_the_same(studio):
    mesh, gaussian = (studio.converged(backend, 0) for backend in ("mesh", "gaussian"))
    assert mesh.max() > 0.3
    assert np.abs(mesh - gaussian).mean() < 0.01


def test_indirect_light_comes_closer_to_the_truth(script, tmp_path):
    """In uniform light, white balls are as bright as the light everywhere: no shadow between them remains."""
    studio = script("benchmarks.studio")
    run = write_balls(tmp_path, (1.0, 1.0, 1.0, 0.9, 0.0))
    one = studio.Studio(run, [lit_view(script, np.full((16, 32, 3), 0.5, np.float32))], {"mesh": 64, "gaussian": 64})
    dark = []
    for indirect in (True, False):
        relighter = one.relighter(studio.RelightVariant(denoise="off", indirect=indirect), 256)
        rgba = relighter.relit(relighter.surface(one.lit_views[0].view.camera), one.lit_views[0].prepared).numpy()
        solid = rgba[..., 3] > 0.99
        dark.append(np.abs(rgba[solid][:, :3] - 0.5).mean())
    assert solid.sum() > 300
    assert dark[0] < 0.5 * dark[1]
