# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole way from views to a textured mesh, on solids known analytically."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import trimesh
from irgspp.core.colour import decode_srgb
from irgspp.core.config import SurfaceSettings
from irgspp.core.errors import Cancelled, IrgsppError
from irgspp.core.progress import Silent
from irgspp.core.surface.extract import extract_surface

SETTINGS = SurfaceSettings(voxels=64, triangles=8000, texture=256)


@dataclass
class Recorder:
    """Remembers what it was told."""

    cancelled: bool = False
    told: list[tuple] = field(default_factory=list)

    def phase(self, name, steps):
        self.told.append((name, steps))

    def step(self, done, **figures):
        self.told.append((done,))

    def message(self, text):
        pass


@pytest.fixture(scope="module", params=["sphere", "torus"])
def extracted(request, solids, camera_ring, bound):
    solid = solids[request.param]
    views = [solid.view(camera, 0.001, i) for i, camera in enumerate(camera_ring(40))]
    return solid, extract_surface(views, solid.samples(), bound, SETTINGS, Silent())


def welded(mesh) -> trimesh.Trimesh:
    """The mesh with its seams closed."""
    _, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    vertices = np.zeros((index.max() + 1, 3))
    vertices[index.reshape(-1)] = mesh.vertices
    return trimesh.Trimesh(vertices, index.reshape(-1)[mesh.faces], process=False)


def test_the_mesh_lies_on_the_solid(extracted):
    solid, mesh = extracted
    voxel = 2.0 / SETTINGS.voxels
    error = np.abs(solid.distance(mesh.vertices.astype(np.float64)))
    assert error.mean() < 0.15 * voxel and error.max() < voxel


def test_the_mesh_is_closed_and_not_inside_out(extracted):
    solid, mesh = extracted
    body = welded(mesh)
    assert body.is_watertight and body.is_winding_consistent and body.volume > 0
    assert body.euler_number == (0 if solid.distance(np.zeros(3)) > 0 else 2)
    facing = (solid.gradient(body.triangles_center) * body.face_normals).sum(-1)
    assert body.area_faces[facing < 0.5].sum() < 1e-3 * body.area


def test_vertex_normals_are_those_of_the_solid(extracted):
    solid, mesh = extracted
    cosine = (solid.gradient(mesh.vertices.astype(np.float64)) * mesh.normals).sum(-1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < 1
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-5)


def test_both_sides_of_a_seam_are_equal(extracted):
    _, mesh = extracted
    _, index, count = np.unique(mesh.vertices, axis=0, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    assert (count > 1).any()  # there are seams
    rows = np.concatenate([mesh.normals, mesh.albedo, mesh.roughness[:, None], mesh.metallic[:, None]], -1)
    first = np.zeros((len(count), rows.shape[1]), np.float32)
    first[index] = rows
    np.testing.assert_array_equal(first[index], rows)


def test_vertex_materials_are_those_of_the_solid(extracted, true_colour):
    _, mesh = extracted
    colour = true_colour(mesh.vertices)
    assert np.abs(mesh.albedo - colour).mean() < 0.01
    assert np.abs(mesh.roughness - colour[:, 1]).mean() < 0.01
    assert np.abs(mesh.metallic - colour[:, 2]).mean() < 0.01


def test_textures_show_the_solid_where_the_uvs_say(extracted, true_colour):
    """Looked up at the triangles' centres as a renderer would: v = 0 at the bottom row."""
    _, mesh = extracted
    size = SETTINGS.texture
    centre, uv = mesh.vertices[mesh.faces].mean(1), mesh.uvs[mesh.faces].mean(1)
    column, row = (uv[:, 0] * size).astype(int), ((1 - uv[:, 1]) * size).astype(int)
    albedo = decode_srgb(mesh.textures["albedo"][row, column] / 255.0)
    assert np.abs(albedo - true_colour(centre)).mean() < 0.02
    assert np.abs(mesh.textures["roughness"][row, column] / 255.0 - true_colour(centre)[:, 1]).mean() < 0.02
    assert mesh.textures["metallic"].shape == (size, size) and mesh.textures["albedo"].shape == (size, size, 3)
    assert all(texture.dtype == np.uint8 for texture in mesh.textures.values())


def test_normal_texture_of_a_smooth_solid_is_nearly_flat(extracted):
    _, mesh = extracted
    normal = mesh.textures["normal"] / 127.5 - 1
    assert np.median(np.degrees(np.arccos(np.clip(normal[..., 2], -1, 1)))) < 2
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1, atol=0.02)


def test_the_unseen_underside_is_closed_near_the_gaussians(solids, camera_ring, bound):
    solid = solids["box"]
    views = [solid.view(camera) for camera in camera_ring(24, lowest=-0.12)]
    mesh = extract_surface(views, solid.samples(20_000), bound, SETTINGS, Silent())
    assert welded(mesh).is_watertight
    assert mesh.vertices[:, 2].min() == pytest.approx(-0.5, abs=0.1)
    assert (np.abs(solid.distance(mesh.vertices.astype(np.float64)))[mesh.vertices[:, 2] > -0.4] < 0.04).all()


def test_no_ghosts_where_no_view_looks(solids, camera_ring, bound):
    """Views from one side only: the shadow behind the object is not made solid."""
    solid = solids["sphere"]
    front = [camera for camera in camera_ring(60) if camera.centre[0] > 2.5]
    samples = solid.samples()
    seen = samples.position[:, 0] > 0
    samples = replace(samples, **{name: getattr(samples, name)[seen] for name in samples.__dataclass_fields__})
    mesh = extract_surface([solid.view(camera) for camera in front], samples, bound, SETTINGS, Silent())
    assert (np.abs(solid.distance(mesh.vertices.astype(np.float64))) < 0.2).mean() > 0.97
    assert mesh.vertices[:, 0].min() > -0.5


def test_progress_tells_three_phases_and_every_step(solids, camera_ring, bound):
    solid, recorder = solids["sphere"], Recorder()
    views = [solid.view(camera, seed=i) for i, camera in enumerate(camera_ring(12, size=48))]
    extract_surface(views, solid.samples(), bound, replace(SETTINGS, voxels=24, texture=64), recorder)
    assert recorder.told == [("fuse", 12), *((i,) for i in range(1, 13)), ("unwrap", 1), (1,), ("bake", 24), *((i,) for i in range(1, 25))]


def test_cancelling_stops(solids, camera_ring, bound):
    solid = solids["sphere"]
    with pytest.raises(Cancelled):
        extract_surface([solid.view(c) for c in camera_ring(6, size=32)], solid.samples(), bound, SETTINGS, Recorder(cancelled=True))


def test_views_without_depth_are_one_clear_line(solids, camera_ring, bound):
    views = [solids["sphere"].view(camera) for camera in camera_ring(3, size=32)]
    views = [replace(view, depth=0 * view.depth) for view in views]
    with pytest.raises(IrgsppError, match="no surface") as error:
        extract_surface(views, solids["sphere"].samples(), bound, SETTINGS, Silent())
    assert "\n" not in str(error.value)


def test_no_views_are_one_clear_line(solids, bound):
    with pytest.raises(IrgsppError, match="no surface"):
        extract_surface([], solids["sphere"].samples(), bound, SETTINGS, Silent())
