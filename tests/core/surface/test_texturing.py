# SPDX-License-Identifier: GPL-3.0-or-later
"""Texturing of surfaces of analytic solids."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.errors import Cancelled
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.surface import Surface
from irgspp.core.settings.schema import SurfaceSettings
from irgspp.core.surface.bake import tangents
from irgspp.core.surface.extraction import extract_geometry, extract_levels
from irgspp.core.surface.mesh_texels import mesh_texels
from irgspp.core.surface.meshing import unit
from irgspp.core.surface.normal_source import NormalSource
from irgspp.core.surface.texturing import textured_mesh

SETTINGS = SurfaceSettings(voxels=64, triangles=8000, texture=256)


@pytest.fixture(scope="module", params=["sphere", "torus"])
def made(request, solids, camera_ring, bound):
    """Solid, surface and mesh."""
    solid = solids[request.param]
    views = [solid.view(camera, 0.001, i) for i, camera in enumerate(camera_ring(40))]
    surface = extract_geometry(views, solid.samples(), bound, SETTINGS, Silent())
    return solid, surface, textured_mesh(surface, views, solid.samples(), SETTINGS, Silent())


@pytest.fixture(scope="module")
def few(solids, camera_ring, bound):
    """A small surface with the views and samples it was made from."""
    solid = solids["sphere"]
    views = [solid.view(camera, seed=i) for i, camera in enumerate(camera_ring(12, size=48))]
    return extract_geometry(views, solid.samples(), bound, replace(SETTINGS, voxels=24), Silent()), views, solid.samples()


def test_the_mesh_is_the_surface_cut_open(made):
    _, surface, mesh = made
    corners = surface.vertices[surface.faces].astype(np.float32)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], corners)


def test_vertex_normals_are_those_of_the_solid(made):
    solid, _, mesh = made
    cosine = (solid.gradient(mesh.vertices.astype(np.float64)) * mesh.normals).sum(-1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < 1
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-5)


def test_both_sides_of_a_seam_are_equal(made):
    _, _, mesh = made
    _, index, count = np.unique(mesh.vertices, axis=0, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    assert (count > 1).any()  # there are seams
    rows = np.concatenate([mesh.normals, mesh.albedo, mesh.roughness[:, None], mesh.metallic[:, None]], -1)
    first = np.zeros((len(count), rows.shape[1]), np.float32)
    first[index] = rows
    np.testing.assert_array_equal(first[index], rows)


def test_vertex_materials_are_those_of_the_solid(made, true_colour):
    _, _, mesh = made
    colour = true_colour(mesh.vertices)
    assert np.abs(mesh.albedo - colour).mean() < 0.01
    assert np.abs(mesh.roughness - colour[:, 1]).mean() < 0.01
    assert np.abs(mesh.metallic - colour[:, 2]).mean() < 0.01


def test_confidence_is_zero_where_no_view_looks(solids, camera_ring, few):
    surface, _, samples = few
    above = [solids["sphere"].view(camera) for camera in camera_ring(12, size=48) if camera.centre[2] > 2]
    mesh = textured_mesh(surface, above, samples, replace(SETTINGS, texture=32), Silent())
    assert (mesh.confidence[mesh.vertices[:, 2] < -0.5] == 0).all()
    assert mesh.confidence[mesh.vertices[:, 2] > 0.7].min() > 0.3
    assert mesh.confidence.max() < 1


def test_confidence_of_materials_is_baked_where_it_is_known(few, camera_ring, solids):
    surface, _, samples = few
    above = [solids["sphere"].view(camera) for camera in camera_ring(12, size=48) if camera.centre[2] > 2]
    known = [replace(view, confidence=np.broadcast_to(np.float32([0.2, 0.5, 0.8]), (*view.alpha.shape, 3))) for view in above]
    settings = replace(SETTINGS, texture=32)
    mesh = textured_mesh(surface, known, samples, settings, Silent())
    assert np.allclose(mesh.material_confidence[mesh.vertices[:, 2] > 0.7], [0.2, 0.5, 0.8], atol=1e-5)
    assert not mesh.material_confidence[mesh.vertices[:, 2] < -0.5].any()  # no view looks there
    assert {tuple(colour) for colour in mesh.textures["material_confidence"].reshape(-1, 3)} >= {(51, 128, 204), (0, 0, 0)}
    without = textured_mesh(surface, above, samples, settings, Silent())
    assert without.material_confidence is None and "material_confidence" not in without.textures
    np.testing.assert_array_equal(without.albedo, mesh.albedo)


def test_textures_show_the_solid_where_the_uvs_say(made, true_colour):
    """Look the textures up at the triangles' centres as a renderer does: v = 0 at the bottom row."""
    _, _, mesh = made
    size = SETTINGS.texture
    centre, uv = mesh.vertices[mesh.faces].mean(1), mesh.uvs[mesh.faces].mean(1)
    column, row = (uv[:, 0] * size).astype(int), ((1 - uv[:, 1]) * size).astype(int)
    albedo = decode_srgb(mesh.textures["albedo"][row, column] / 255.0)
    assert np.abs(albedo - true_colour(centre)).mean() < 0.02
    assert np.abs(mesh.textures["roughness"][row, column] / 255.0 - true_colour(centre)[:, 1]).mean() < 0.02
    assert mesh.textures["metallic"].shape == (size, size) and mesh.textures["albedo"].shape == (size, size, 3)
    assert all(texture.dtype == np.uint8 for texture in mesh.textures.values())


def test_normal_texture_of_a_smooth_solid_is_nearly_flat(made):
    _, _, mesh = made
    normal = mesh.textures["normal"] / 127.5 - 1
    assert np.median(np.degrees(np.arccos(np.clip(normal[..., 2], -1, 1)))) < 2
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1, atol=0.02)


def test_sixteen_bits_hold_what_eight_round(few):
    surface, views, samples = few
    eight, sixteen = (
        textured_mesh(surface, views, samples, replace(SETTINGS, texture=32, texture_bits=bits), Silent()).textures for bits in (8, 16)
    )
    for name in ("albedo", "roughness", "metallic", "normal"):
        assert sixteen[name].dtype == np.uint16
        assert np.abs(sixteen[name] / 257 - eight[name]).max() <= 0.51  # half a step of 8 bits, and of 16
    assert len(np.unique(sixteen["albedo"] % 257)) > 200 and sixteen["confidence"].dtype == np.uint8


def shaded_normals(mesh, size):
    """Return the points (P, 3) at the texels, and the normals (P, 3) that a renderer makes of the normal texture there."""
    texels, frames = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, size), tangents(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces)
    normal, tangent = (unit(texels.interpolate(values, mesh.faces)) for values in (mesh.normals, frames[:, :3]))
    tangent = unit(tangent - (tangent * normal).sum(-1, keepdims=True) * normal)
    bitangent = frames[mesh.faces[texels.face, 0], 3:] * np.cross(normal, tangent)
    code = mesh.textures["normal"].reshape(-1, 3)[texels.index] / 127.5 - 1
    return texels.interpolate(mesh.vertices, mesh.faces), unit(code[:, :1] * tangent + code[:, 1:2] * bitangent + code[:, 2:] * normal)


def test_a_fine_surface_gives_a_reduced_mesh_its_normals(solids, camera_ring, bound):
    solid, settings = solids["torus"], replace(SETTINGS, texture=128)
    views, samples = [solid.view(camera) for camera in camera_ring(20)], solid.samples()
    coarse, fine = extract_levels(views, samples, bound, settings, Silent(), None, (250, None))
    exact = Surface(fine.vertices, solid.gradient(fine.vertices), fine.faces, fine.voxel)
    mesh = textured_mesh(coarse, views, samples, settings, Silent(), normal_source=NormalSource(1.0, exact, resolved=True))
    points, normals = shaded_normals(mesh, 128)
    cosine = (normals * solid.gradient(solid.project(points))).sum(-1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < 1.5


def test_progress_reports_both_phases_and_every_step(few, recorder):
    recorded = recorder()
    textured_mesh(*few, replace(SETTINGS, texture=64), recorded)
    assert recorded.events == [("unwrap", 1), (1,), ("bake", 24), *((i,) for i in range(1, 25))]


def test_cancelling_stops(few, recorder):
    recorded = recorder(cancelled=True)
    with pytest.raises(Cancelled):
        textured_mesh(*few, replace(SETTINGS, texture=64), recorded)
    assert recorded.events == [("unwrap", 1), (1,)]
