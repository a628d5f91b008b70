# SPDX-License-Identifier: GPL-3.0-or-later
"""Unwrapping, and tangent frames."""

import numpy as np
import pytest
import trimesh
from irgspp.core.surface import bake
from irgspp.core.surface.mesh_texels import mesh_texels
from irgspp.core.surface.meshing import Triangles, vertex_normals
from irgspp.core.surface.unwrap import unwrap


@pytest.fixture(scope="module")
def sphere():
    body = trimesh.creation.icosphere(4)
    mesh = Triangles(np.array(body.vertices), np.array(body.faces))
    return mesh, *unwrap(mesh, 256)


def test_unwrapped_faces_are_the_faces_of_the_mesh(sphere):
    mesh, source, faces, uvs = sphere
    np.testing.assert_array_equal(source[faces], mesh.faces)
    assert set(source) == set(range(len(mesh.vertices)))
    assert uvs.min() >= 0 and uvs.max() <= 1


def test_no_chart_is_mirrored_and_none_overlap(sphere):
    mesh, source, faces, uvs = sphere
    a, b, c = (uvs[faces[:, k]].astype(np.float64) for k in range(3))
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert (area > 0).mean() > 0.999
    texels = mesh_texels(mesh.vertices[source], uvs, faces, 1024)
    covered = len(texels.index) / 1024**2
    assert covered == pytest.approx(area.sum(), rel=0.005)  # overlap would cover less than the areas' sum


def test_tangents_follow_u_and_v(sphere):
    """Against central differences: moving along +u moves along the tangent, +v along side * normal x tangent."""
    mesh, source, faces, uvs = sphere
    vertices, normals = mesh.vertices[source], vertex_normals(mesh)[source]
    frames = bake.tangents(vertices, normals, uvs, faces)
    np.testing.assert_allclose(np.linalg.norm(frames[:, :3], axis=-1), 1)
    np.testing.assert_allclose((frames[:, :3] * normals).sum(-1), 0, atol=1e-9)
    bitangent = frames[:, 3:] * np.cross(normals, frames[:, :3])
    corner, uv = vertices[faces], uvs[faces].astype(np.float64)
    for edge in (1, 2):
        world, (du, dv) = corner[:, edge] - corner[:, 0], (uv[:, edge] - uv[:, 0]).T
        along = np.stack([(world * axes[faces[:, 0]]).sum(-1) for axes in (frames[:, :3], bitangent)], -1)
        cosine = (along * np.stack([du, dv], -1)).sum(-1) / np.linalg.norm(along, axis=-1) / np.hypot(du, dv)
        assert np.median(cosine) > 0.99 and (cosine > 0.5).mean() > 0.99


def test_mirrored_texture_coordinates_turn_the_side():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    normals, faces = np.tile([0, 0, 1.0], (3, 1)), np.array([[0, 1, 2]])
    straight = bake.tangents(vertices, normals, vertices[:, :2], faces)
    mirrored = bake.tangents(vertices, normals, vertices[:, :2] * [-1, 1], faces)
    np.testing.assert_allclose(straight, np.tile([1, 0, 0, 1], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(mirrored, np.tile([-1, 0, 0, -1], (3, 1)), atol=1e-12)


def test_tangent_space_undoes_the_frame():
    rng = np.random.default_rng(0)
    normal, other, local = (rng.normal(size=(50, 3)) for _ in range(3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    tangent = np.cross(normal, other)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    side = np.where(rng.random(50) < 0.5, -1.0, 1.0)
    world = local[:, :1] * tangent + local[:, 1:2] * side[:, None] * np.cross(normal, tangent) + local[:, 2:] * normal
    np.testing.assert_allclose(bake.tangent_space(world, normal, tangent, side), local, atol=1e-12)
