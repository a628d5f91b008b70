# SPDX-License-Identifier: GPL-3.0-or-later
"""The shape of a running reconstruction in the scene: points, then a surface, then the result alone."""

import json
import os
import time
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from irgspp.irgspp_addon.importer.arrangement import HIDDEN
from irgspp.irgspp_addon.importer.live_shape import SHAPE, read_shape, remove_live_shape, show_live_shape
from irgspp.irgspp_addon.importer.scene_builder import import_run
from irgspp.irgspp_addon.jobs import result_import
from irgspp.irgspp_addon.jobs.job import Job
from irgspp.operators import live_shape

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)


@pytest.fixture
def scene(default_scene):
    return default_scene


def write(run, **changes):
    """Write a shape as the engine does; a value of None leaves an array out."""
    shape = {"position": CORNERS, "colour": np.full((4, 3), 0.5, np.float32), "centre": np.zeros(3), "to_world": np.eye(4)} | changes
    (run / SHAPE).parent.mkdir(parents=True, exist_ok=True)
    np.savez(run / SHAPE, **{name: array for name, array in shape.items() if array is not None})


def job_of(run, scene, state="running") -> Job:
    job = Job("one", "reconstruct", "Reconstruct", run, run / "notes", data=result_import.place_of(scene), state=state)
    job.began = time.time() - 60
    return job


def shown(run):
    return [thing for thing in bpy.data.objects if thing.get("irgspp", "").startswith(f"{run.resolve()}#") and thing.type == "MESH"]


def counts():
    return [len(blocks) for blocks in (bpy.data.objects, bpy.data.collections, bpy.data.meshes)]


def test_points_become_a_surface_and_vanish(scene, tmp_path):
    before = counts()
    write(tmp_path)
    points = show_live_shape(tmp_path, scene)
    assert len(points.data.vertices) == 4 and not points.data.polygons and points.hide_render and points.name in scene.objects
    write(tmp_path, position=CORNERS[:3], colour=np.zeros((3, 3), np.float32))
    assert len(show_live_shape(tmp_path, scene).data.vertices) == 3 and len(shown(tmp_path)) == 1
    write(tmp_path, faces=FACES)
    (surface,) = [show_live_shape(tmp_path, scene)]
    assert len(surface.data.polygons) == 4 and surface.hide_render and shown(tmp_path) == [surface]
    remove_live_shape(tmp_path)
    assert counts() == before


def test_the_result_takes_the_place_of_the_shape(scene, run_folder):
    (run_folder / SHAPE).unlink(missing_ok=True)
    write(run_folder)
    points = show_live_shape(run_folder, scene)
    points.parent.location.x = 3.0  # the user has moved it
    imported = import_run(run_folder)
    assert shown(run_folder) == [imported.mesh] and imported.root.location.x == 3.0
    assert show_live_shape(run_folder, scene) is None  # the earlier result stays until the next one
    remove_live_shape(run_folder)
    assert shown(run_folder) == [imported.mesh]
    (run_folder / SHAPE).unlink()


def test_the_shape_lies_over_the_imported_dataset(scene, tmp_path):
    dataset = tmp_path / "photos"
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text(json.dumps({"dataset": str(dataset.resolve())}))
    root = bpy.data.objects.new("dataset", None)
    scene.collection.objects.link(root)
    root["irgspp_dataset"], root["irgspp_to_world"], root["irgspp_placement"] = (
        str(dataset.resolve()),
        np.eye(4).reshape(-1).tolist(),
        "AS_IS 1 False",
    )
    root.location = (5, 0, 0)
    bpy.context.view_layer.update()
    write(tmp_path / "run")
    points = show_live_shape(tmp_path / "run", scene)
    bpy.context.view_layer.update()
    assert tuple(points.matrix_world.translation) == (5, 0, 0)


DAMAGED = [
    {"faces": FACES + 1},
    {"faces": FACES[:, :2]},
    {"faces": np.zeros((0, 3), np.int32)},
    {"position": np.full((4, 3), np.nan, np.float32)},
    {"colour": np.zeros((3, 3), np.float32)},
    {"to_world": np.zeros((4, 4))},
    {"centre": None},
    {"position": np.array(["a"])},
]


@pytest.mark.parametrize("changes", DAMAGED)
def test_damaged_shapes_are_not_shown(scene, tmp_path, changes):
    before = counts()
    write(tmp_path, **changes)
    assert read_shape(tmp_path) is None and show_live_shape(tmp_path, scene) is None and counts() == before


def test_files_that_are_no_shapes_are_not_shown(tmp_path):
    assert read_shape(tmp_path) is None
    (tmp_path / SHAPE).parent.mkdir()
    for data in (b"", b"PK\x03\x04 cut", b"\x93NUMPY"):
        (tmp_path / SHAPE).write_bytes(data)
        assert read_shape(tmp_path) is None


def test_a_running_job_is_followed_and_cleared_away(scene, tmp_path):
    job = job_of(tmp_path, scene)
    live_shape.follow(job)
    assert not shown(tmp_path)  # nothing is written yet
    write(tmp_path)
    live_shape.follow(job)
    (points,) = shown(tmp_path)
    assert scene.objects["Cube"].hide_get() and bpy.context.view_layer.objects.active == points  # a new file: the object is framed
    assert not points.select_get()
    mesh = points.data
    live_shape.follow(job)
    assert shown(tmp_path)[0].data == mesh  # the same file is not read again
    scene.objects["Cube"].hide_set(False)
    write(tmp_path, faces=FACES)
    os.utime(tmp_path / SHAPE, (time.time() + 5, time.time() + 5))
    live_shape.follow(job)
    assert len(shown(tmp_path)[0].data.polygons) == 4 and not scene.objects["Cube"].hide_get()  # the view is arranged once
    job.state = "cancelled"
    live_shape.follow(job)
    assert not shown(tmp_path)


def default_objects_shown(scene) -> list[bool]:
    """Return whether the default cube and light are shown in the view and, then, in images."""
    things = [scene.objects["Cube"], scene.objects["Light"]]
    return [not thing.hide_get() for thing in things] + [not thing.hide_render for thing in things]


@pytest.mark.parametrize("state", ["cancelled", "failed"])
def test_the_cube_and_light_are_shown_again_where_no_result_came(scene, tmp_path, state):
    job = job_of(tmp_path, scene)
    write(tmp_path)
    live_shape.follow(job)
    assert default_objects_shown(scene) == [False] * 4
    job.state = state
    live_shape.follow(job)
    assert default_objects_shown(scene) == [True] * 4 and not set(scene.objects["Cube"].keys()) & {HIDDEN}
    job.state = "running"  # resumed
    live_shape.follow(job)
    assert default_objects_shown(scene) == [False] * 4
    job.state = "cancelled"
    live_shape.follow(job)
    assert default_objects_shown(scene) == [True] * 4


def test_the_cube_and_light_stay_hidden_under_the_result(scene, run_folder):
    job = job_of(run_folder, scene)
    write(run_folder)
    live_shape.follow(job)
    assert default_objects_shown(scene) == [False] * 4
    result_import.import_result(job)
    job.state = "done"
    live_shape.follow(job)
    assert default_objects_shown(scene) == [False] * 4 and HIDDEN not in scene.objects["Cube"]
    (run_folder / SHAPE).unlink()


def test_what_the_user_had_hidden_is_not_shown_by_the_end_of_a_job(scene, tmp_path):
    scene.objects["Cube"].hide_set(True)
    scene.objects["Light"].hide_render = True
    before = default_objects_shown(scene)
    job = job_of(tmp_path, scene)
    write(tmp_path)
    live_shape.follow(job)
    job.state = "cancelled"
    live_shape.follow(job)
    assert default_objects_shown(scene) == before == [False, True, True, False]


def test_the_cube_and_light_are_shown_again_in_a_file_that_was_opened_again(scene, tmp_path):
    job = job_of(tmp_path / "run", scene)
    write(tmp_path / "run")
    live_shape.follow(job)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    job.data["place"]["file"] = bpy.data.filepath
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    live_shape._shown.clear()  # as in another Blender
    live_shape.follow(job)
    assert default_objects_shown(bpy.context.scene) == [False] * 4
    job.state = "cancelled"
    live_shape.follow(job)
    assert default_objects_shown(bpy.context.scene) == [True] * 4 and not shown(tmp_path / "run")


def test_nothing_changes_while_blender_renders(scene, tmp_path, monkeypatch):
    write(tmp_path)
    monkeypatch.setattr(live_shape.jobs, "all_jobs", lambda: [job_of(tmp_path, scene)])
    monkeypatch.setattr(live_shape, "bpy", SimpleNamespace(app=SimpleNamespace(is_job_running=lambda kind: kind == "RENDER")))
    assert live_shape._tick() == live_shape.SECONDS and not shown(tmp_path)
    monkeypatch.setattr(live_shape, "bpy", bpy)
    live_shape._tick()
    assert shown(tmp_path)


def test_shapes_that_nobody_wants_are_not_shown(scene, tmp_path):
    write(tmp_path)
    os.utime(tmp_path / SHAPE, (1, 1))  # of an earlier job
    live_shape.follow(job_of(tmp_path, scene))
    os.utime(tmp_path / SHAPE)
    scene.irgspp.live_shape = False
    live_shape.follow(job_of(tmp_path, scene))
    scene.irgspp.live_shape = True
    elsewhere = job_of(tmp_path, scene)
    result_import.another_file()
    live_shape.follow(elsewhere)
    assert not shown(tmp_path)


def test_what_is_being_edited_stays(scene, tmp_path):
    write(tmp_path, faces=FACES)
    surface = show_live_shape(tmp_path, scene)
    bpy.context.view_layer.objects.active = surface
    bpy.ops.object.mode_set(mode="EDIT")
    assert show_live_shape(tmp_path, scene) is None
    bpy.ops.object.mode_set(mode="OBJECT")
    assert show_live_shape(tmp_path, scene) is not None


def undo_to(message: str, scene_name: str):
    """Undo one step and return the scene, since earlier references are dead."""
    assert bpy.ops.ed.undo() == {"FINISHED"}, message
    return bpy.data.scenes[scene_name]


def test_undo_while_a_job_runs_loses_and_doubles_nothing(scene, tmp_path):
    name, job = scene.name, job_of(tmp_path, scene)
    bpy.ops.ed.undo_push(message="before")
    write(tmp_path)
    live_shape.follow(job)
    bpy.ops.ed.undo_push(message="with points")
    write(tmp_path, faces=FACES)
    os.utime(tmp_path / SHAPE, (time.time() + 5, time.time() + 5))
    live_shape.follow(job)
    bpy.ops.ed.undo_push(message="with the surface")
    for _ in range(2):
        scene = undo_to("job", name)
        live_shape.follow(job)  # the restored step had points, or nothing
        (surface,) = shown(tmp_path)
        assert len(surface.data.polygons) == 4 and surface.name in scene.objects
    bpy.ops.ed.redo()
    live_shape.follow(job)
    assert len(shown(tmp_path)) == 1


def test_undo_after_a_job_does_not_bring_its_shape_back(scene, tmp_path):
    job = job_of(tmp_path, scene)
    write(tmp_path)
    live_shape.follow(job)
    bpy.ops.ed.undo_push(message="running")
    job.state = "cancelled"
    live_shape.follow(job)
    assert not shown(tmp_path)
    bpy.ops.ed.undo_push(message="ended")
    bpy.ops.ed.undo()
    assert shown(tmp_path)  # Blender restores the step of the running job
    live_shape.follow(job)
    assert not shown(tmp_path)
