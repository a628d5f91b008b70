# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights of a fine sphere above a mesh of few triangles."""

import numpy as np
import pytest
import trimesh
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.surface import Surface
from irgspp.core.surface.height import height_line, height_map
from irgspp.core.surface.mesh_texels import mesh_texels
from irgspp.core.surface.meshing import Triangles, unit
from irgspp.core.surface.unwrap import unwrap

SIZE, VOXEL = 128, 0.02


def ball(subdivisions: int, radius: float = 1.0) -> Surface:
    body = trimesh.creation.icosphere(subdivisions)
    return Surface(radius * body.vertices, np.array(body.vertices), np.array(body.faces), VOXEL)


def unwrapped(surface: Surface) -> Mesh:
    source, faces, uvs = unwrap(Triangles(surface.vertices, surface.faces), SIZE)
    place, normals = (values[source].astype(np.float32) for values in (surface.vertices, surface.normals))
    grey, half = np.full((len(source), 3), 0.5, np.float32), np.full(len(source), 0.5, np.float32)
    return Mesh(place, normals, uvs, faces, grey, half, half)


def test_displaced_texels_lie_on_the_fine_surface():
    mesh, fine = unwrapped(ball(1)), ball(5)
    heights = height_map(mesh, fine, SIZE)
    assert heights is not None and heights.image.shape == (SIZE, SIZE) and heights.image.dtype == np.uint16 and heights.missed == 0
    texels = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, SIZE)
    height = heights.scale * (heights.image.ravel()[texels.index] / 65535 - 0.5)
    place = texels.interpolate(mesh.vertices, mesh.faces)
    normal = unit(texels.interpolate(mesh.normals, mesh.faces))
    assert np.abs(np.linalg.norm(place, axis=-1) - 1).max() > 0.05  # the mesh alone is far from it
    assert np.abs(np.linalg.norm(place + height[:, None] * normal, axis=-1) - 1).max() < 1e-3
    assert height.max() == pytest.approx(heights.scale / 2, rel=1e-3) and height.min() > -1e-3


def test_surface_below_the_mesh_has_heights_below_midlevel():
    heights = height_map(unwrapped(ball(1)), ball(5, 0.9), SIZE)
    assert heights is not None and heights.image.max() < 32768


def test_the_other_side_of_a_thin_part_is_not_taken():
    """Two sheets back to back, .05 apart: below the lower one lies nothing, above it only the back of the upper one."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    upper = np.concatenate([corners, np.full((4, 1), 0.05)], -1)
    up = np.array([[0, 1, 2], [0, 2, 3]])
    fine = trimesh.Trimesh(upper, up, process=False).subdivide().subdivide()
    mesh = Mesh(
        np.concatenate([corners, np.zeros((4, 1))], -1).astype(np.float32),
        np.tile(np.float32([0, 0, -1]), (4, 1)),
        corners.astype(np.float32),
        up[:, ::-1].astype(np.int32),
        np.zeros((4, 3), np.float32),
        np.zeros(4, np.float32),
        np.zeros(4, np.float32),
    )
    surface = Surface(np.array(fine.vertices), np.tile([0.0, 0, 1], (len(fine.vertices), 1)), np.array(fine.faces), VOXEL)
    assert height_map(mesh, surface, 32) is None  # no texel has a height


def test_a_mesh_that_is_not_reduced_has_no_heights():
    fine = ball(4)
    assert height_map(unwrapped(fine), fine, SIZE) is None
    assert height_map(unwrapped(fine), ball(4, 1.05), SIZE) is None  # as many triangles, however far apart
    flat = trimesh.creation.box((1, 1, 1))
    dense = flat.subdivide().subdivide().subdivide()
    coarse = Surface(np.array(flat.vertices), unit(np.array(flat.vertices)), np.array(flat.faces), VOXEL)
    same = Surface(np.array(dense.vertices), unit(np.array(dense.vertices)), np.array(dense.faces), VOXEL)
    assert height_map(unwrapped(coarse), same, SIZE) is None  # fewer triangles, but the same shape


def test_the_record_is_one_line():
    heights = height_map(unwrapped(ball(1)), ball(5), SIZE)
    assert heights is not None
    state = heights.state()
    assert state["midlevel"] == 0.5 and state["scale"] == pytest.approx(heights.scale, rel=1e-5)
    assert f"scale {state['scale']}" in height_line(state) and "no height texture" in height_line(None)
