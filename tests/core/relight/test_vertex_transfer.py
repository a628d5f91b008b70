# SPDX-License-Identifier: GPL-3.0-or-later
"""Light on the vertices: the exact radiosity of a hemispherical bowl, the kernels against PyTorch, rotated lights, the unoccluded case."""

import numpy as np
import pytest
import torch
import trimesh
from irgspp.core.relight.mesh_tracer import EmbreeTracer
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.relight.vertex_transfer import VertexTransfer
from irgspp.core.scene.mesh import Mesh
from irgspp.core.shading.environment_lookup import rotate
from irgspp.core.shading.procedural_lights import studio_light

pytestmark = pytest.mark.usefixtures("engine")
ONE = torch.ones(3)


def mesh_of(shape: trimesh.Trimesh, albedo: float, inside: bool = False) -> Mesh:
    """A mesh of one albedo; `inside` turns it inside out."""
    if inside:
        shape.invert()
    count = len(shape.vertices)
    arrays = (shape.vertices, shape.vertex_normals, np.zeros((count, 2)))
    flat = [np.full(count, value, np.float32) for value in (1.0, 0.0)]
    return Mesh(*(a.astype(np.float32) for a in arrays), shape.faces.astype(np.int32), np.full((count, 3), albedo, np.float32), *flat)


def transfer_of(mesh: Mesh) -> VertexTransfer:
    return VertexTransfer(mesh, EmbreeTracer(mesh), 1.0)


@pytest.fixture(scope="module")
def bowl() -> Mesh:
    """The inner side of the lower half of the unit sphere."""
    whole = trimesh.creation.icosphere(4, 1.0)
    lower = whole.triangles_center[:, 2] < 0
    return mesh_of(trimesh.Trimesh(whole.vertices, whole.faces[lower]), 0.5, inside=True)


@pytest.fixture(scope="module")
def studio():
    return prepare_light(studio_light(64, 128) * np.linspace(0.2, 1.8, 128, dtype=np.float32)[None, :, None])


def test_a_bowl_under_a_uniform_sky_has_the_radiosity_of_a_sphere_half_open(bowl):
    """In a sphere all form factors are equal: E = pi L f / (1 - a (1 - f)) with the open fraction f = 1/2 (three bounces of four)."""
    arriving = transfer_of(bowl).light(prepare_light(np.full((16, 32, 3), 2.0, np.float32)), ONE)
    deep = bowl.vertices[:, 2] < -0.1  # rays of the rim start on either side of it
    assert float(arriving[deep, :3].mean()) == pytest.approx(2 * 0.5 * sum(0.25**n for n in range(4)), rel=0.01)
    assert float(arriving[deep, 3].mean()) == pytest.approx(0.5 * sum(0.25**n for n in range(4)), rel=0.01)


def test_a_ball_receives_the_unoccluded_light(studio):
    ball = mesh_of(trimesh.creation.icosphere(4, 1.0), 0.5)
    arriving, expected = transfer_of(ball).light(studio, ONE), studio.irradiance(torch.from_numpy(ball.normals)) / torch.pi
    torch.testing.assert_close(arriving[:, :3], expected)
    torch.testing.assert_close(arriving[:, 3], torch.ones(len(arriving)))


@pytest.mark.parametrize("degrees", [0.0, 77.0])
def test_kernels_equal_pytorch_in_double_precision(bowl, studio, degrees):
    transfer, scale, light = transfer_of(bowl), torch.tensor([1.0, 0.8, 0.6]), studio.turned(degrees)
    unoccluded = light.irradiance(torch.from_numpy(bowl.normals)) / torch.pi
    expected = transfer.arriving(light, scale.double(), unoccluded.double())
    torch.testing.assert_close(transfer.light(light, scale)[:, :3].double(), expected, rtol=1e-5, atol=1e-6)


def test_a_rotated_light_equals_a_light_of_rotated_texels(bowl):
    image = studio_light(64, 128) * np.linspace(0.2, 1.8, 128, dtype=np.float32)[None, :, None]
    transfer = transfer_of(bowl)
    found, expected = (transfer.light(light, ONE) for light in (prepare_light(image).turned(45), prepare_light(rotate(image, 45))))
    assert float((found - expected).abs().mean()) < 1e-4 and float((found - expected).abs().max()) < 0.02  # bilinear in other places


def test_the_scale_of_the_albedo_counts_and_nothing_is_kept_for_another(bowl, studio):
    transfer, scale = transfer_of(bowl), 1.5 * ONE
    dark, bright = transfer.light(studio, 0 * ONE), transfer.light(studio, scale)
    assert (bright[:, :3].mean(0) > 1.2 * dark[:, :3].mean(0)).all()
    assert transfer.light(studio, scale) is bright


def test_the_inside_of_a_thin_wall_sends_no_light():
    """A vertex whose rays start within a closed box is in the dark, however bright the outside is."""
    box = mesh_of(trimesh.creation.box((1, 1, 1)).subdivide().subdivide(), 0.9)
    within = Mesh(**{**vars(box), "normals": -box.normals})
    light = VertexTransfer(within, EmbreeTracer(box), 1.0).light(prepare_light(np.ones((16, 32, 3), np.float32)), ONE)
    assert float(light[:, :3].max()) < 1e-6


def test_points_take_their_nearest_vertices(bowl):
    corner, weight = transfer_of(bowl).nearest(torch.from_numpy(bowl.vertices[5:8]) + 1e-4)
    assert corner[:, 0].tolist() == [5, 6, 7] and weight.sum(1).tolist() == [1, 1, 1]
