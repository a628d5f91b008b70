# SPDX-License-Identifier: GPL-3.0-or-later
"""The object's origin at its foot: the run's frame is found again after Set Origin, Apply Transform, edits and new imports."""

import bpy
import numpy as np
import pytest
from blender_side import write_sphere_run
from irgspp.irgspp_addon.importer.mesh_origin import ORIGIN, REFERENCES
from irgspp.irgspp_addon.importer.ply import read_ply
from irgspp.irgspp_addon.importer.run_frame import frame_of
from irgspp.irgspp_addon.importer.scene_builder import import_run
from mathutils import Euler, Matrix

PLACED = Matrix.LocRotScale((1, 2, 3), Euler((0.3, 0.2, 0.1)), (2, 2, 2))  # of the run in the world


@pytest.fixture
def thing(run_folder):
    bpy.ops.wm.read_homefile(use_empty=True)
    imported = import_run(run_folder)
    bpy.context.view_layer.update()
    bpy.context.view_layer.objects.active = imported.mesh
    imported.mesh.select_set(True)
    return imported.mesh


def move(thing):
    """Move the object so that the run lies at PLACED."""
    thing.matrix_world = PLACED @ thing.matrix_world
    bpy.context.view_layer.update()


def assert_frame(thing, expected):
    np.testing.assert_allclose(frame_of(thing).matrix, np.array(expected), atol=2e-5)


def test_the_origin_is_the_foot(thing):
    places = np.array([vertex.co for vertex in thing.data.vertices])
    np.testing.assert_allclose(thing.matrix_world.translation, (0, 0, -1), atol=1e-6)
    np.testing.assert_allclose([places[:, 2].min(), places[:, 2].max()], [0, 2], atol=1e-6)
    assert_frame(thing, Matrix())
    move(thing)
    assert_frame(thing, PLACED)


def test_applied_transforms_and_another_origin(thing):
    move(thing)
    bpy.ops.object.transform_apply(location=True, rotation=True, scale=True)
    assert_frame(thing, PLACED)
    bpy.ops.object.origin_set(type="ORIGIN_GEOMETRY")
    bpy.context.view_layer.update()
    assert np.linalg.norm(thing.matrix_world.translation - PLACED.translation) < 0.05  # the sphere's centre
    assert_frame(thing, PLACED)


def test_an_edited_mesh_counts_as_imported(thing):
    move(thing)
    for vertex in thing.data.vertices:
        vertex.co.x *= 1.5
    assert_frame(thing, PLACED)
    thing.data.clear_geometry()
    np.testing.assert_allclose(np.array(thing.matrix_world @ Matrix.Translation((0, 0, 1))), np.array(PLACED), atol=1e-5)


@pytest.mark.parametrize("applied", [False, True])
def test_importing_another_mesh_keeps_the_place(tmp_path, applied):
    bpy.ops.wm.read_homefile(use_empty=True)
    run = write_sphere_run(tmp_path / "run")
    thing = import_run(run).mesh
    bpy.context.view_layer.update()
    move(thing)
    if applied:
        thing.select_set(True)
        bpy.context.view_layer.objects.active = thing
        bpy.ops.object.transform_apply(location=True, rotation=True, scale=True)
    before = read_ply(run / "mesh.ply")["vertex"]
    after = before.copy()
    after["z"] = np.maximum(after["z"], -0.5)  # its foot is higher
    (run / "mesh.ply").write_bytes((run / "mesh.ply").read_bytes().replace(before.tobytes(), after.tobytes()))
    again = import_run(run).mesh
    bpy.context.view_layer.update()
    assert again == thing
    assert_frame(thing, PLACED)
    np.testing.assert_allclose(list(thing[ORIGIN]), [0, 0, -0.5], atol=0.01)


def test_an_object_of_an_earlier_version(thing, run_folder):
    origin = list(thing[ORIGIN])
    del thing[ORIGIN], thing[REFERENCES]
    thing.data.transform(Matrix.Translation(origin))
    thing.matrix_basis = Matrix()
    bpy.context.view_layer.update()
    move(thing)
    assert_frame(thing, PLACED)
    import_run(run_folder)
    bpy.context.view_layer.update()
    assert_frame(thing, PLACED)
    np.testing.assert_allclose(thing.matrix_world.translation, PLACED @ Matrix.Translation(origin).translation, atol=1e-5)
