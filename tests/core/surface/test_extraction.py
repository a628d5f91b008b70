# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface extraction on analytic solids."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from irgspp.core.errors import Cancelled, IrgsppError
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.surface import Surface
from irgspp.core.settings.schema import SurfaceSettings
from irgspp.core.surface import extraction, meshing, repair
from irgspp.core.surface.extraction import coarser, extract_geometry, extract_levels

SETTINGS = SurfaceSettings(voxels=64, triangles=8000)


@pytest.fixture(scope="module", params=["sphere", "torus"])
def extracted(request, solids, camera_ring, bound):
    solid = solids[request.param]
    views = [solid.view(camera, 0.001, i) for i, camera in enumerate(camera_ring(40))]
    return solid, extract_geometry(views, solid.samples(), bound, SETTINGS, Silent())


def body_of(surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


def test_the_mesh_lies_on_the_solid(extracted):
    solid, surface = extracted
    voxel = 2.0 / SETTINGS.voxels
    error = np.abs(solid.distance(surface.vertices))
    assert error.mean() < 0.15 * voxel and error.max() < voxel


def test_the_mesh_is_closed_and_not_inside_out(extracted):
    solid, surface = extracted
    body = body_of(surface)
    assert body.is_watertight and body.is_winding_consistent and body.volume > 0
    assert body.euler_number == (0 if solid.distance(np.zeros(3)) > 0 else 2)
    facing = (solid.gradient(body.triangles_center) * body.face_normals).sum(-1)
    assert body.area_faces[facing < 0.5].sum() < 1e-3 * body.area


def test_masks_move_a_surface_that_is_too_small(solids, camera_ring, bound):
    solid, voxel = solids["sphere"], 2.0 / SETTINGS.voxels
    small = replace(solid, distance=lambda points: solid.distance(points) + 0.5 * voxel)
    cameras = camera_ring(40)
    masks = [solid.view(camera).alpha.astype(np.float32) for camera in cameras]
    surface = extract_geometry([small.view(camera) for camera in cameras], small.samples(), bound, SETTINGS, Silent(), masks)
    assert np.abs(solid.distance(surface.vertices)).mean() < 0.25 * voxel
    assert body_of(surface).is_watertight


def test_a_rough_offset_to_the_silhouettes_leaves_no_folded_face(solids, camera_ring, bound, monkeypatch):
    """Where smoothing does not unfold a face, an edge of it is collapsed; normals follow."""
    noise = np.random.default_rng(0)
    monkeypatch.setattr(
        extraction, "silhouette_offset", lambda vertices, *_: np.where(vertices[:, 0] > 0.8, 0.1, 0) * noise.normal(size=len(vertices))
    )
    monkeypatch.setattr(repair, "MAX_UNFOLDING_STEPS", 0)
    solid = solids["sphere"]
    views = [solid.view(camera) for camera in camera_ring(12)]
    surface = extract_geometry(views, solid.samples(), bound, SETTINGS, Silent(), [view.alpha for view in views])
    mesh = meshing.Triangles(surface.vertices, surface.faces)
    assert repair.folded_faces(mesh, surface.normals).sum() == 0
    assert repair.folded_faces(mesh, meshing.vertex_normals(mesh, repair.NORMAL_AVERAGES)).sum() == 0
    assert body_of(surface).is_watertight and len(surface.normals) == len(surface.vertices)


def test_normals_follow_a_repair_that_keeps_the_number_of_vertices(monkeypatch):
    """A collapse removes vertices, and filling the hole that it leaves may add as many."""
    ball = trimesh.creation.icosphere(3)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces)
    monkeypatch.setattr(repair, "remove_folds", lambda *_: meshing.Triangles(vertices[::-1].copy(), len(vertices) - 1 - faces))
    mended = extraction._unfold(Surface(vertices, vertices.copy(), faces, 0.1))
    assert (mended.normals * mended.vertices).sum(-1).min() > 0.99


def test_vertex_normals_are_those_of_the_solid(extracted):
    solid, surface = extracted
    cosine = (solid.gradient(surface.vertices) * surface.normals).sum(-1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < 1
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=-1), 1, atol=1e-5)


def test_the_unseen_underside_is_closed_near_the_gaussians(solids, camera_ring, bound):
    solid = solids["box"]
    views = [solid.view(camera) for camera in camera_ring(24, lowest=-0.12)]
    surface = extract_geometry(views, solid.samples(20_000), bound, SETTINGS, Silent())
    assert body_of(surface).is_watertight
    assert surface.vertices[:, 2].min() == pytest.approx(-0.5, abs=0.1)
    assert (np.abs(solid.distance(surface.vertices))[surface.vertices[:, 2] > -0.4] < 0.04).all()


def test_no_ghosts_where_no_view_looks(solids, camera_ring, bound):
    """With views from one side only, the unseen space behind the object is not filled."""
    solid = solids["sphere"]
    front = [camera for camera in camera_ring(60) if camera.centre[0] > 2.5]
    samples = solid.samples()
    seen = samples.position[:, 0] > 0
    samples = replace(samples, **{name: getattr(samples, name)[seen] for name in samples.__dataclass_fields__})
    surface = extract_geometry([solid.view(camera) for camera in front], samples, bound, SETTINGS, Silent())
    assert (np.abs(solid.distance(surface.vertices)) < 0.2).mean() > 0.97
    assert surface.vertices[:, 0].min() > -0.5


def test_cancelling_stops(solids, camera_ring, bound, recorder):
    solid = solids["sphere"]
    with pytest.raises(Cancelled):
        extract_geometry([solid.view(c) for c in camera_ring(6, size=32)], solid.samples(), bound, SETTINGS, recorder(cancelled=True))


def test_views_without_depth_are_one_clear_line(solids, camera_ring, bound):
    views = [solids["sphere"].view(camera) for camera in camera_ring(3, size=32)]
    views = [replace(view, depth=0 * view.depth) for view in views]
    with pytest.raises(IrgsppError, match="no surface") as error:
        extract_geometry(views, solids["sphere"].samples(), bound, SETTINGS, Silent())
    assert "\n" not in str(error.value)


def test_no_views_are_one_clear_line(solids, bound):
    with pytest.raises(IrgsppError, match="no surface"):
        extract_geometry([], solids["sphere"].samples(), bound, SETTINGS, Silent())


def test_progress_reports_every_view(solids, camera_ring, bound, recorder):
    solid, recorded = solids["sphere"], recorder()
    views = [solid.view(camera, seed=i) for i, camera in enumerate(camera_ring(12, size=48))]
    extract_geometry(views, solid.samples(), bound, replace(SETTINGS, voxels=24), recorded)
    assert recorded.events == [("fuse", 12), *((i,) for i in range(1, 13))]


def test_a_coarser_surface_keeps_shape_and_normals(extracted):
    surface = extracted[1]
    coarse = coarser(surface, 2000)
    assert 1000 < len(coarse.faces) <= 2000 < len(surface.faces)
    assert abs(body_of(coarse).volume / body_of(surface).volume - 1) < 0.01
    assert np.allclose(np.linalg.norm(coarse.normals, axis=1), 1)
    nearest = np.linalg.norm(coarse.vertices[:, None] - surface.vertices[None], axis=-1).argmin(1)
    assert (coarse.normals * surface.normals[nearest]).sum(1).mean() > 0.995


def test_a_small_surface_stays_as_it_is(extracted):
    surface = extracted[1]
    assert coarser(surface, len(surface.faces)) is surface


def test_levels_come_from_one_fusion_and_equal_single_extractions(solids, camera_ring, bound, recorder):
    solid, recorded = solids["sphere"], recorder()
    views = [solid.view(camera) for camera in camera_ring(12, size=48)]
    settings = replace(SETTINGS, voxels=24, triangles=600)
    reduced, fine = extract_levels(views, solid.samples(), bound, settings, recorded, None, (600, None))
    assert [event[0] for event in recorded.events].count("fuse") == 1
    alone = extract_geometry(views, solid.samples(), bound, settings, Silent())
    np.testing.assert_array_equal(reduced.vertices, alone.vertices)
    assert len(reduced.faces) <= 600 < len(fine.faces)
