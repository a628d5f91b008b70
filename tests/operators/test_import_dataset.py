# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of a dataset: cameras project as the readers' do wherever their parent empty is placed; imports replace each other."""

import json
import shutil
from pathlib import Path

import bpy
import irgspp
import numpy as np
import pytest
from blender_side import ROOT, in_engine
from irgspp.core.scene.camera import Camera
from irgspp.irgspp_addon.importer.cameras import look_through
from irgspp.irgspp_addon.importer.dataset_import import export_folder, is_fresh
from irgspp.irgspp_addon.importer.placement import to_dataset
from irgspp.irgspp_addon.jobs import queue as jobs
from irgspp.operators.import_dataset import dataset_of

DEMO = ROOT / "core" / "demo_data"
KINDS = ("demo", "stretched", "distorted")
PIXELS = 1e-3  # how far a point may fall from where the readers' camera sees it


@pytest.fixture(scope="session")
def datasets(tmp_path_factory):
    """Folders with `dataset` and `truth.json`, by kind."""
    folders = {kind: tmp_path_factory.mktemp(kind) for kind in KINDS}
    for kind, folder in folders.items():
        in_engine(ROOT / "tests" / "support" / "posed_photographs.py", kind, folder)
    truths = {kind: json.loads((folder / "truth.json").read_text()) for kind, folder in folders.items()}
    return {kind: (DEMO if kind == "demo" else folder / "dataset", truths[kind]) for kind, folder in folders.items()}


@pytest.fixture
def registered():
    """The extension, in an empty file."""
    bpy.ops.wm.read_homefile(use_empty=True)
    irgspp.register()
    yield
    irgspp.unregister()


def camera_of(values: list) -> Camera:
    width, height, fx, fy, cx, cy, to_world = values
    return Camera(width, height, fx, fy, cx, cy, np.array(to_world))


def seen(scene: bpy.types.Scene, placed: bpy.types.Object, points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) where Blender's camera sees points (N, 3) of the world."""
    look_through(scene, placed)
    bpy.context.view_layer.update()
    render = scene.render
    projection = placed.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(),
        x=render.resolution_x,
        y=render.resolution_y,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    to_camera = np.linalg.inv(np.array(placed.matrix_world.normalized(), float))
    clip = np.c_[points, np.ones(len(points))] @ (np.array(projection, float) @ to_camera).T
    x, y = clip[:, 0] / clip[:, 3], clip[:, 1] / clip[:, 3]
    return np.stack([(x + 1) / 2 * render.resolution_x, (1 - y) / 2 * render.resolution_y], -1)


def imported_cameras() -> dict[str, bpy.types.Object]:
    return {thing.name: thing for thing in bpy.context.scene.objects if thing.type == "CAMERA"}


def root() -> bpy.types.Object:
    (found,) = [thing for thing in bpy.context.scene.objects if thing.type == "EMPTY" and not thing.parent]
    return found


@pytest.mark.parametrize("options", [{}, {"up_axis": "NEG_Y_UP", "scale": 0.3, "recentre": True}], ids=["as it is", "placed"])
@pytest.mark.parametrize("kind", KINDS)
def test_points_fall_on_the_pixels_of_the_readers(registered, datasets, kind, options):
    dataset, truth = datasets[kind]
    assert bpy.ops.irgspp.import_dataset(directory=str(dataset), **options) == {"FINISHED"}
    placed = imported_cameras()
    assert set(placed) == set(truth["cameras"])
    bpy.context.view_layer.update()
    to_scene = np.array(root().matrix_world, float)
    points = np.array(truth["centre"]) + np.random.default_rng(0).uniform(-0.4, 0.4, (40, 3))
    moved = points @ to_scene[:3, :3].T + to_scene[:3, 3]
    worst = 0.0
    for name, values in truth["cameras"].items():
        pixels, depth = camera_of(values).project(points)
        assert (depth > 0).all()
        worst = max(worst, float(np.abs(seen(bpy.context.scene, placed[name], moved) - pixels).max()))
    print(f"{kind}: {worst:.2g} px")
    assert worst < PIXELS


def test_own_frame_can_be_had_and_is_never_lost(registered, datasets):
    dataset, truth = datasets["distorted"]
    to_own = np.linalg.inv(truth["to_world"])
    bpy.ops.irgspp.import_dataset(directory=str(dataset), up_axis="Z_UP")
    bpy.context.view_layer.update()
    assert np.allclose(np.array(root().matrix_world), to_own, atol=1e-6)
    assert np.allclose(np.array(to_dataset(root())), np.eye(4), atol=1e-5)
    bpy.ops.irgspp.import_dataset(directory=str(dataset), up_axis="AS_IS", scale=2.0, recentre=True)
    bpy.context.view_layer.update()
    middle = np.array(root().matrix_world) @ [*truth["centre"], 1.0]
    assert np.allclose(middle[:3], 0, atol=1e-5)
    root().location.x += 7  # a person moves it
    bpy.context.view_layer.update()
    assert np.allclose(np.array(to_dataset(root())), to_own @ np.linalg.inv(np.array(root().matrix_world, float)), atol=1e-5)


def test_axes_come_to_stand_upright(registered, datasets):
    dataset, truth = datasets["distorted"]
    turn = np.array(truth["to_world"])[:3, :3]
    axes = {"X_UP": (1, 0, 0), "Y_UP": (0, 1, 0), "NEG_X_UP": (-1, 0, 0), "NEG_Y_UP": (0, -1, 0), "NEG_Z_UP": (0, 0, -1)}
    for name, axis in axes.items():
        bpy.ops.irgspp.import_dataset(directory=str(dataset), up_axis=name)
        bpy.context.view_layer.update()
        upright = np.array(root().matrix_world)[:3, :3] @ turn @ axis
        assert np.allclose(upright, (0, 0, 1), atol=1e-6), name


def test_photographs_without_distortion_stand_behind_the_cameras(registered, datasets):
    for kind in ("stretched", "distorted"):
        bpy.ops.wm.read_homefile(use_empty=True)
        dataset, truth = datasets[kind]
        bpy.ops.irgspp.import_dataset(directory=str(dataset))
        for name, placed in imported_cameras().items():
            (background,) = placed.data.background_images
            file = Path(bpy.path.abspath(background.image.filepath))
            assert tuple(background.image.size) == tuple(truth["cameras"][name][:2])
            assert file.is_relative_to(export_folder(dataset) if kind == "distorted" else dataset)


def test_points_have_place_and_colour(registered, datasets):
    dataset, truth = datasets["distorted"]
    bpy.ops.irgspp.import_dataset(directory=str(dataset))
    (cloud,) = [thing for thing in bpy.context.scene.objects if thing.type == "MESH"]
    place, colour = truth["points"]
    stored, shade = np.empty(3 * len(place), np.float32), np.empty(4 * len(place), np.float32)
    cloud.data.vertices.foreach_get("co", stored)
    cloud.data.color_attributes["colour"].data.foreach_get("color_srgb", shade)
    assert np.allclose(stored.reshape(-1, 3), place, atol=1e-6)
    assert np.allclose(shade.reshape(-1, 4)[:, :3], colour, atol=1 / 250)
    evaluated = cloud.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert cloud.hide_render and evaluated.modifiers and cloud.parent == root()


def counts() -> dict[str, int]:
    names = ("objects", "meshes", "materials", "images", "cameras", "collections", "node_groups")
    return {name: len(getattr(bpy.data, name)) for name in names}


def test_importing_again_replaces_and_options_hold(registered, datasets):
    dataset, _ = datasets["distorted"]
    bpy.ops.irgspp.import_dataset(directory=str(dataset))
    before = counts()
    bpy.ops.irgspp.import_dataset(directory=str(dataset), scale=2.0)
    assert counts() == before
    bpy.ops.irgspp.import_dataset(directory=str(dataset), photographs=False, points=False)
    assert not [thing for thing in bpy.context.scene.objects if thing.type == "MESH"]
    assert not any(placed.data.background_images for placed in imported_cameras().values())
    assert counts()["images"] == 0


def test_reading_is_done_once_and_again_after_a_change(registered, datasets, tmp_path):
    shutil.copytree(datasets["stretched"][0], tmp_path / "dataset")
    dataset = (tmp_path / "dataset").resolve()
    bpy.ops.irgspp.import_dataset(directory=str(dataset))
    asked = len(jobs.all_jobs())
    bpy.ops.irgspp.import_dataset(directory=str(dataset), scale=3.0)
    assert len(jobs.all_jobs()) == asked and is_fresh(dataset, export_folder(dataset))
    about = json.loads((dataset / "transforms.json").read_text())
    about["frames"] = about["frames"][:-2]
    (dataset / "transforms.json").write_text(json.dumps(about))
    bpy.ops.irgspp.import_dataset(directory=str(dataset))
    assert len(jobs.all_jobs()) == asked + 1 and len(imported_cameras()) == 10


def test_undo_and_save_keep_it(registered, datasets, tmp_path):
    dataset, _ = datasets["distorted"]
    bpy.ops.ed.undo_push(message="empty")
    empty = counts()
    bpy.ops.irgspp.import_dataset("EXEC_DEFAULT", True, directory=str(dataset))
    before = counts()
    bpy.ops.ed.undo()
    assert counts() == empty
    bpy.ops.ed.redo()
    assert counts() == before
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert counts() == before
    bpy.ops.irgspp.import_dataset(directory=str(dataset))
    assert counts() == before


def test_run_lies_over_its_dataset(registered, datasets, run_folder, tmp_path):
    dataset, truth = datasets["distorted"]
    shutil.copytree(run_folder, tmp_path / "run")
    about = json.loads((run_folder / "reconstruction.json").read_text())
    (tmp_path / "run" / "reconstruction.json").write_text(json.dumps({**about, "to_world": truth["to_world"]}))
    (tmp_path / "run" / "run.json").write_text(json.dumps({"dataset": str(dataset)}))
    bpy.ops.irgspp.import_dataset(directory=str(dataset), up_axis="X_UP", scale=0.5)
    above = root()
    bpy.ops.irgspp.import_run(directory=str(tmp_path / "run"))
    bpy.context.view_layer.update()
    placed = bpy.context.object.parent
    assert placed != above and np.allclose(np.array(placed.matrix_world), np.array(above.matrix_world), atol=1e-6)


@pytest.mark.parametrize(
    ("directory", "words"),
    [("", "none is chosen"), ("/no/such/place", "no such file or folder; it may have been moved"), ("{empty}", "no dataset here")],
)
def test_folder_that_is_no_dataset_is_an_error_in_words(registered, tmp_path, directory, words):
    for operator in (bpy.ops.irgspp.import_dataset, bpy.ops.irgspp.inspect_dataset):
        with pytest.raises(RuntimeError, match=words) as caught:
            operator(directory=directory.format(empty=tmp_path))
        assert str(caught.value).count("\n") == 1 and "Traceback" not in str(caught.value)
    assert not bpy.data.objects


def test_inspection_tells_the_panel(registered, datasets):
    dataset, truth = datasets["stretched"]
    assert bpy.ops.irgspp.inspect_dataset(directory=str(dataset)) == {"FINISHED"}
    settings = bpy.context.scene.irgspp
    facts = json.loads(settings.inspected)
    assert Path(settings.dataset) == dataset.resolve() and facts["format"] == "transforms"
    assert facts["train"] + facts["test"] == len(truth["cameras"]) and facts["points"] is None and facts["masked"] == 0
    assert facts["sizes"] == [[90, 62, 12]] and facts["warnings"] == []


def test_dropped_files_are_what_they_stand_for(registered, datasets, run_folder, tmp_path):
    handler = bpy.types.IRGSPP_FH_dropped
    assert handler.bl_file_extensions == ".json;.bin" and not handler.poll_drop(bpy.context)
    bpy.ops.irgspp.import_dropped(filepath=str(datasets["stretched"][0] / "transforms.json"))
    assert len(imported_cameras()) == 12
    bpy.ops.irgspp.import_dropped(filepath=str(DEMO / "transforms_test.json"))
    bpy.ops.irgspp.import_dropped(filepath=str(DEMO / "transforms_train.json"))
    assert len(imported_cameras()) == 12 + 46  # the same dataset, once
    shutil.copytree(run_folder, tmp_path / "run")
    (tmp_path / "run" / "run.json").write_text("{}")
    bpy.ops.irgspp.import_dropped(filepath=str(tmp_path / "run" / "run.json"))
    assert bpy.context.object.name == "run"
    with pytest.raises(RuntimeError, match="is neither a dataset nor a run"):
        bpy.ops.irgspp.import_dropped(filepath=str(tmp_path / "photographs.json"))


def test_dropped_file_stands_for_its_whole_dataset(tmp_path):
    model = tmp_path / "sparse" / "0"
    model.mkdir(parents=True)
    for file in (model / "cameras.bin", tmp_path / "transforms.json"):
        file.touch()
    assert dataset_of(model / "images.bin") == tmp_path
    assert dataset_of(tmp_path / "transforms.json") == tmp_path / "transforms.json"  # the folder would mean the model
    (tmp_path / "other" / "model").mkdir(parents=True)
    for file in (tmp_path / "other" / "transforms.json", tmp_path / "other" / "model" / "cameras.bin"):
        file.touch()
    assert dataset_of(tmp_path / "other" / "transforms.json") == tmp_path / "other"
    assert dataset_of(tmp_path / "other" / "model" / "cameras.bin") == tmp_path / "other" / "model"


def test_job_of_another_file_brings_nothing_into_this_one(registered, datasets):
    """The import is queued from a window, and another file is opened before it ends."""
    dataset, _ = datasets["stretched"]
    shutil.rmtree(export_folder(dataset.resolve()))
    assert bpy.ops.irgspp.import_dataset(directory=str(dataset), wait=False) == {"FINISHED"}
    assert not bpy.data.objects
    bpy.ops.wm.read_homefile(use_empty=True)
    job = jobs.wait(jobs.all_jobs()[0], timeout=300)
    assert job.state == "done" and "another file is open" in (job.error or "") and not bpy.data.objects


def test_job_brings_it_in_at_its_end(registered, datasets):
    dataset, truth = datasets["stretched"]
    shutil.rmtree(export_folder(dataset.resolve()))
    assert bpy.ops.irgspp.import_dataset(directory=str(dataset), wait=False, up_axis="Y_UP") == {"FINISHED"}
    job = jobs.wait(jobs.all_jobs()[0], timeout=300)
    assert job.state == "done" and job.error is None
    assert len(imported_cameras()) == len(truth["cameras"])
