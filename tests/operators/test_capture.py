# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs without cameras: the job that finds them, its import, and the sphere by which the object's bound is changed."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from blender_side import ENGINE, ROOT, in_engine
from captured_dataset import CENTRE, RADIUS, write_state
from engine_jobs import registry as registry
from engine_jobs import until
from irgspp.core.errors import IrgsppError
from irgspp.irgspp_addon.importer.measure import PARTS, find_ends, place_ends
from irgspp.irgspp_addon.importer.object_sphere import BOUND, bound_settings, find_sphere, is_changed, own_frame
from irgspp.irgspp_addon.jobs import process as job_process
from irgspp.irgspp_addon.jobs import queue as jobs
from irgspp.operators.capture import found
from irgspp.panels import registration
from mathutils import Matrix

SUPPORT = ROOT / "tests" / "support"


@pytest.fixture(scope="session")
def turned(tmp_path_factory):
    """A COLMAP dataset whose own frame is not the engine's, and the matrix between them."""
    folder = tmp_path_factory.mktemp("turned")
    in_engine(SUPPORT / "posed_photographs.py", "distorted", folder)
    return folder / "dataset", np.array(json.loads((folder / "truth.json").read_text())["to_world"])


@pytest.fixture(autouse=True)
def extension(registry, monkeypatch, captured):
    """The extension, with a stand-in for `irgspp capture`."""
    monkeypatch.setenv("IRGSPP_PYTHON", ENGINE)
    monkeypatch.setenv("IRGSPP_CAPTURED", str(captured))
    real = job_process.engine_command

    def command(*arguments):
        return [ENGINE, str(SUPPORT / "fake_capture.py"), *arguments] if arguments[0] == "capture" else real(*arguments)

    monkeypatch.setattr(job_process, "engine_command", command)
    bpy.ops.wm.read_homefile(use_empty=True)
    registration.register()
    yield
    registration.unregister()


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("a.jpg", "b.jpg", "go"):
        (folder / name).touch()
    return folder.resolve()


def cameras() -> list[bpy.types.Object]:
    return [thing for thing in bpy.context.scene.objects if thing.type == "CAMERA"]


def sphere_of(dataset: Path) -> bpy.types.Object:
    sphere = find_sphere(bpy.context.scene, dataset.resolve())
    assert sphere is not None
    return sphere


def test_a_script_gets_cameras_points_and_sphere(photos):
    assert bpy.ops.irgspp.capture(directory=str(photos), marker=0.05, seed=3, settings="capture.frames=40", wait=True) == {"FINISHED"}
    folder = photos.with_name("photos_capture")
    words = ["capture", str(photos), "-o", str(folder), "--seed", "3", "--set", "capture.marker=0.05", "--set", "capture.frames=40"]
    assert next(job for job in jobs.all_jobs() if job.kind == "capture").arguments == words
    settings = bpy.context.scene.irgspp
    assert Path(settings.dataset) == folder and json.loads(settings.inspected)["format"] == "capture"
    assert len(cameras()) == 12 and all(placed.data.background_images for placed in cameras())
    sphere = sphere_of(folder)
    assert (sphere.name, sphere.empty_display_type) == ("photos_capture object", "SPHERE") and sphere.parent.type == "EMPTY"
    assert np.allclose(sphere.matrix_basis.translation, CENTRE, atol=1e-5) and np.allclose(sphere.scale, RADIUS, atol=1e-5)


def test_the_panels_choices_are_taken_where_none_are_given(photos, monkeypatch):
    settings = bpy.context.scene.irgspp
    settings.dataset, settings.capture_marker, settings.capture_turntable, settings.seed = str(photos), 0.08, "on", 5
    settings.overrides = "first.iterations=9 capture.masks=off"
    bpy.ops.irgspp.capture(wait=True, import_result=False)
    (job,) = jobs.all_jobs()
    told = ["capture.marker=0.08", "capture.turntable=on", "capture.masks=off"]
    assert job.arguments[4:] == ["--seed", "5", *[word for one in told for word in ("--set", one)]]
    assert not cameras()


def test_a_job_imports_at_its_end_and_the_panel_uses_it(photos):
    bpy.context.scene.irgspp.dataset = str(photos)
    assert bpy.ops.irgspp.capture(wait=False) == {"FINISHED"}
    until(cameras)
    capture = next(job for job in jobs.all_jobs() if job.kind == "capture")
    assert (capture.state, capture.error) == ("done", None)
    assert Path(bpy.context.scene.irgspp.dataset) == photos.with_name("photos_capture")


def test_another_choice_made_meanwhile_stays(photos, tmp_path):
    bpy.context.scene.irgspp.dataset = str(photos)
    bpy.ops.irgspp.capture(wait=False)
    bpy.context.scene.irgspp.dataset = str(tmp_path)
    until(cameras)
    assert Path(bpy.context.scene.irgspp.dataset) == tmp_path


def test_a_stopped_capture_goes_on(photos):
    (photos / "go").unlink()
    bpy.ops.irgspp.capture(directory=str(photos), wait=False)
    (job,) = jobs.all_jobs()
    until(lambda: job.phase == "match photographs")
    with pytest.raises(RuntimeError, match="Find cameras of photos is running for this folder"):
        bpy.ops.irgspp.capture(directory=str(photos), wait=False)
    bpy.ops.irgspp.job_cancel(job=job.id)
    until(lambda: job.finished)
    assert job.state == "cancelled" and not cameras()
    (photos / "go").touch()
    words = list(job.arguments)
    assert bpy.ops.irgspp.job_resume(job=job.id) == {"FINISHED"} and job.arguments == words
    until(cameras)


def test_the_folder_of_a_stopped_capture_leads_to_its_photographs(photos, tmp_path):
    folder = tmp_path / "elsewhere"
    write_state(folder, status="running", inputs={"source": str(photos)})
    bpy.ops.irgspp.capture(directory=str(folder), wait=True, import_result=False)
    assert jobs.all_jobs()[0].arguments[1:4] == [str(photos), "-o", str(folder.resolve())]


def test_a_video_has_folders_without_its_suffix(tmp_path, monkeypatch):
    def start(kind, title, folder, *_, **__):
        raise IrgsppError(f"would write {folder.name}")

    monkeypatch.setattr(jobs, "start", start)
    (tmp_path / "turn.MOV").touch()
    assert bpy.ops.irgspp.choose_video(filepath=str(tmp_path / "turn.MOV")) == {"FINISHED"}
    with pytest.raises(RuntimeError, match="would write turn_capture"):
        bpy.ops.irgspp.capture(wait=False)
    with pytest.raises(RuntimeError, match="would write turn_irgspp"):
        bpy.ops.irgspp.reconstruct(wait=False)
    (tmp_path / "text.txt").touch()
    with pytest.raises(RuntimeError, match="is not a video"):
        bpy.ops.irgspp.choose_video(filepath=str(tmp_path / "text.txt"))


@pytest.mark.parametrize(
    ("content", "message"), [(None, "no such file or folder"), ("{}", "can't be read"), ("{", "can't be read; choose the photographs")]
)
def test_bad_input_is_an_exception_of_one_line(tmp_path, content, message):
    folder = tmp_path / "folder"
    if content is not None:
        folder.mkdir()
        (folder / "capture.json").write_text(content)
    with pytest.raises(RuntimeError, match=message) as caught:
        bpy.ops.irgspp.capture(directory=str(folder))
    assert len(str(caught.value).strip().splitlines()) == 1 and not jobs.all_jobs()


def test_the_outcome_names_what_was_left_out(captured):
    from irgspp.irgspp_addon.importer.capture_file import read_capture

    text = found(read_capture(captured))
    assert text == "cameras of 12 photographs found, 2 left out (IMG_7.jpg: blurred; IMG_9.jpg: shows something else)"
    assert found(None) == "no cameras were found"


# --- the sphere


def asked(monkeypatch, **words) -> list[str]:
    """Arguments with which a reconstruction would be started."""
    seen = []

    def start(kind, title, folder, arguments, *_, **__):
        seen.extend(arguments)
        raise IrgsppError("stop here")

    with monkeypatch.context() as patch, pytest.raises(RuntimeError, match="stop here"):
        patch.setattr(jobs, "start", start)
        bpy.ops.irgspp.reconstruct(wait=False, **words)
    return seen


@pytest.mark.parametrize("options", [{}, {"up_axis": "NEG_Y_UP", "scale": 0.3, "recentre": True}], ids=["as it is", "placed"])
def test_a_moved_sphere_is_the_bound_in_the_datasets_own_frame(turned, monkeypatch, options):
    dataset, to_world = turned
    bpy.ops.irgspp.import_dataset(directory=str(dataset), **options)
    assert bound_settings(bpy.context.scene, dataset) == [] and not is_changed(sphere_of(dataset))
    assert not [word for word in asked(monkeypatch, dataset=str(dataset)) if word.startswith("data.")]
    bpy.context.view_layer.update()
    sphere, own, radius = sphere_of(dataset), np.array([0.31, -0.22, 0.47]), 0.6
    to_scene = np.array(sphere.parent.matrix_world, float) @ to_world
    place = to_scene[:3, :3] @ own + to_scene[:3, 3]
    size = radius * np.cbrt(np.linalg.det(to_scene[:3, :3]))
    sphere.matrix_world = Matrix.Translation(place.tolist()) @ Matrix.Diagonal((size, size, size, 1.0))
    words = asked(monkeypatch, dataset=str(dataset), settings="data.masks=off")
    values = dict(word.split("=") for word in words if word.startswith("data."))
    assert np.allclose([float(v) for v in values["data.centre"].split(",")], own, atol=1e-5)
    assert float(values["data.radius"]) == pytest.approx(radius, rel=1e-5)
    assert words[words.index(f"data.centre={values['data.centre']}") - 1] == "--set" and words[-1] == "data.masks=off"


def test_the_engine_reads_the_bound_that_was_set(turned):
    dataset, _ = turned
    bpy.ops.irgspp.import_dataset(directory=str(dataset))
    sphere = sphere_of(dataset)
    sphere.location.x += 0.2
    sphere.scale *= 0.5
    words = [word for setting in bound_settings(bpy.context.scene, dataset) for word in ("--set", setting)]
    job = jobs.start("inspect", "inspect", None, ["inspect", str(dataset), "--json", *words])
    until(lambda: job.finished)
    facts = json.loads(job.output().splitlines()[-1])
    assert np.allclose(facts["centre"], sphere.location, atol=1e-5) and facts["radius"] == pytest.approx(sphere.scale.x, rel=1e-5)


def test_a_stretched_or_resized_sphere_is_read_by_its_longest_axis(turned):
    dataset, _ = turned
    bpy.ops.irgspp.import_dataset(directory=str(dataset))
    sphere = sphere_of(dataset)
    radius = sphere[BOUND][3]
    sphere.scale.z *= 2
    sphere.empty_display_size = 1.5
    assert bound_settings(bpy.context.scene, dataset)[1] == f"data.radius={3 * radius:.7g}"
    sphere.empty_display_size, sphere.scale.z = 1.0, radius * 1.0001
    assert not is_changed(sphere)  # rounding is no change


def test_importing_again_keeps_a_changed_sphere_and_moves_an_unchanged_one(turned):
    dataset, _ = turned
    bpy.ops.irgspp.import_dataset(directory=str(dataset))
    sphere = sphere_of(dataset)
    right = list(sphere[BOUND])
    sphere.location = sphere.location + Matrix.Identity(3)[0]
    bpy.ops.irgspp.import_dataset(directory=str(dataset), scale=2.0)
    assert sphere_of(dataset) == sphere and sphere.location.x == pytest.approx(right[0] + 1, abs=1e-5)
    sphere.location, sphere[BOUND] = (5, 5, 5), [5, 5, 5, right[3]]  # as an earlier import with another bound left it
    bpy.ops.irgspp.import_dataset(directory=str(dataset))
    assert np.allclose(sphere.location, right[:3], atol=1e-5) and list(sphere[BOUND]) == right


def test_a_marker_is_told_for_photographs_without_cameras_alone(photos, captured, monkeypatch):
    bpy.context.scene.irgspp.capture_marker = 0.05
    assert "capture.marker=0.05" in asked(monkeypatch, dataset=str(photos))
    assert "capture.marker=0.05" not in asked(monkeypatch, dataset=str(captured))


# --- the sphere of a capture, which chooses the object


@pytest.fixture
def moved_sphere(photos):
    """A finished capture that is imported, and its sphere, which was moved and scaled afterwards."""
    bpy.ops.irgspp.capture(directory=str(photos), wait=True)
    folder = photos.with_name("photos_capture")
    sphere = sphere_of(folder)
    sphere.location.x += 0.25
    sphere.scale = (0.5, 0.5, 0.5)
    return folder, sphere


def test_a_moved_sphere_of_a_capture_cuts_the_object_out_again(moved_sphere):
    folder, sphere = moved_sphere
    assert bpy.ops.irgspp.capture(directory=str(folder), wait=True) == {"FINISHED"}
    cut = next(job for job in jobs.all_jobs() if job.title == "Cut out the object of photos_capture")
    centre = ",".join(f"{value:.7g}" for value in sphere.location)
    assert cut.arguments == ["capture", str(folder), "--set", f"capture.centre={centre}", "--set", "capture.radius=0.5"]
    assert sphere_of(folder) == sphere and not is_changed(sphere)  # it is the capture's own now
    assert np.allclose(sphere.location, np.add(CENTRE, (0.25, 0, 0)), atol=1e-5)


def test_reconstruct_cuts_the_object_out_first(moved_sphere, monkeypatch):
    folder, sphere = moved_sphere
    told, real = [], jobs.start

    def start(kind, title, place, arguments, *rest, **more):
        told.append(arguments)
        if kind == "reconstruct":
            raise IrgsppError("stop here")
        return real(kind, title, place, arguments, *rest, **more)

    monkeypatch.setattr(jobs, "start", start)
    options = {"dataset": str(folder), "preset": "draft", "seed": 4, "settings": "surface.texture=64"}
    with pytest.raises(RuntimeError, match="stop here"):
        bpy.ops.irgspp.reconstruct(wait=True, **options)
    assert [words[0] for words in told] == ["capture", "inspect", "reconstruct"] and "capture.radius=0.5" in told[0]
    assert not any("centre" in word for word in told[-1]) and told[-1][-1] == "surface.texture=64"
    told.clear()
    sphere.location.x += 0.25
    assert bpy.ops.irgspp.reconstruct(wait=False, **options) == {"FINISHED"}  # a button: the reconstruction follows on the cut
    until(lambda: any(words[0] == "reconstruct" for words in told))
    assert [words[0] for words in told if words[0] != "inspect"] == ["capture", "reconstruct"]
    (words,) = [words for words in told if words[0] == "reconstruct"]
    assert words[words.index("--preset") + 1] == "draft" and words[words.index("--seed") + 1] == "4"


def test_a_run_that_is_refused_cuts_nothing(moved_sphere, tmp_path):
    folder, _ = moved_sphere
    run = tmp_path / "run"
    run.mkdir()
    (run / "run.json").write_text("{}")
    with pytest.raises(RuntimeError, match="holds another run"):
        bpy.ops.irgspp.reconstruct(dataset=str(folder), run=str(run), wait=False)
    assert not any(job.title.startswith("Cut out") for job in jobs.all_jobs())


def test_resuming_goes_on_with_the_object_of_the_run(moved_sphere, monkeypatch, tmp_path):
    folder, _ = moved_sphere
    run = tmp_path / "run"
    run.mkdir()
    (run / "run.json").write_text("{}")
    assert asked(monkeypatch, dataset=str(folder), run=str(run), resume=True)[-1] == "--resume"


# --- two measured points, which give the true size


def test_two_measured_points_are_told_in_the_datasets_own_frame(photos, monkeypatch):
    bpy.ops.irgspp.capture(directory=str(photos), wait=True)
    folder = photos.with_name("photos_capture")
    assert bpy.ops.irgspp.place_ends(directory=str(folder)) == {"FINISHED"}
    ends, root = find_ends(bpy.context.scene, folder), sphere_of(folder).parent
    assert set(bpy.context.selected_objects) == set(ends.values()) and all(end.parent == root for end in ends.values())
    assert place_ends(bpy.context.scene, folder) == [ends[part] for part in PARTS]  # once
    ends[PARTS[0]].location, ends[PARTS[1]].location = (0.1, 0.2, 0), (0.1, -0.3, 1e-6)
    bpy.context.view_layer.update()
    told, own = [], own_frame(root)
    monkeypatch.setattr(jobs, "start", lambda kind, title, place, words, *rest: told.append(words))
    assert bpy.ops.irgspp.true_size(directory=str(folder), distance=0.125, wait=False) == {"FINISHED"}
    words = told[0]
    assert words[:3] == ["capture", str(folder), "--distance"] and words[-1] == "0.125000000m"
    expected = np.array([(0.1, 0.2, 0), (0.1, -0.3, 1e-6)]) @ own[:3, :3].T + own[:3, 3]
    assert np.allclose([float(word) for word in words[3:-1]], expected.ravel(), atol=1e-6)


def test_what_no_size_can_be_told_from(photos, tmp_path):
    with pytest.raises(RuntimeError, match="is not a finished capture"):
        bpy.ops.irgspp.place_ends(directory=str(tmp_path))
    bpy.ops.irgspp.capture(directory=str(photos), wait=True, import_result=False)
    folder = photos.with_name("photos_capture")
    with pytest.raises(RuntimeError, match="is not in the scene"):
        bpy.ops.irgspp.place_ends(directory=str(folder))
    with pytest.raises(RuntimeError, match="no measured points"):
        bpy.ops.irgspp.true_size(directory=str(folder), distance=1.0)
    with pytest.raises(RuntimeError, match="distance: is 0"):
        bpy.ops.irgspp.true_size(directory=str(folder))
