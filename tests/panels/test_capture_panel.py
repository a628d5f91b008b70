# SPDX-License-Identifier: GPL-3.0-or-later
"""Step 2 for photographs without cameras, for what a capture found, and the panel in which masks are painted."""

import json
import time
from types import SimpleNamespace

import bpy
import irgspp
import pytest
from captured_dataset import write_state
from irgspp.irgspp_addon.engine import process as engine
from irgspp.irgspp_addon.importer.mask_image import MASK
from irgspp.irgspp_addon.importer.measure import PARTS
from irgspp.irgspp_addon.importer.object_sphere import BOUND
from irgspp.irgspp_addon.importer.ownership import KEY
from irgspp.irgspp_addon.importer.placement import TO_WORLD
from irgspp.irgspp_addon.jobs import queue as jobs
from irgspp.irgspp_addon.jobs.job import Job
from irgspp.irgspp_addon.properties import show_jobs
from irgspp.panels import cameras, capture_state, mask, photographs, reconstruct, run_state
from recording_layout import draw

FOUND = [{"name": f"{i}", "mask": "found"} for i in range(8)]


@pytest.fixture
def settings():
    bpy.ops.wm.read_homefile(use_empty=True)
    irgspp.register()
    run_state._known.clear()
    capture_state.forget()
    jobs.clear()
    show_jobs([])
    yield bpy.context.scene.irgspp
    irgspp.unregister()


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("a.jpg", "b.jpg", "c.png"):
        (folder / name).touch()
    return folder


def write_capture(folder, **values):
    write_state(folder, **{"inputs": {"source": "/photos"}, "photographs": FOUND, "left_out": []} | values)
    capture_state.forget()
    return folder


def test_photographs_without_cameras_offer_to_find_them(settings, photos):
    settings.dataset = str(photos)
    chosen = draw(photographs.IRGSPP_PT_photographs)
    assert "Photographs without cameras: 3 files" in chosen.words and not chosen.buttons("irgspp.inspect_dataset")
    drawn = draw(cameras.IRGSPP_PT_cameras)
    assert {"capture_marker", "capture_turntable"} <= set(drawn.properties)
    (button,) = drawn.buttons("irgspp.capture")
    assert (button.text, button.values, button.live) == ("Find Cameras", {"directory": str(photos)}, engine.status().usable)
    assert not drawn.buttons("irgspp.import_dataset")
    start = draw(reconstruct.IRGSPP_PT_reconstruct)
    assert start.buttons("irgspp.reconstruct")[0].live == engine.status().usable
    assert not engine.status().usable or "The cameras are found first" in start.words
    assert "On the CPU" not in drawn.words + start.words
    expected = {
        "capture": {"text": "about 3 min"},
        "jobs": {"balanced": {"text": "about 9 min"}},
        "rows": [["dataset", "x"]],
        "warnings": [],
    }
    settings.inspected = json.dumps(expected)
    assert "On the CPU: about 3 min." in draw(cameras.IRGSPP_PT_cameras).words
    whole = "On the CPU, with the search for cameras: about 9 min."
    assert not engine.status().usable or whole in draw(reconstruct.IRGSPP_PT_reconstruct).words
    assert "Dataset" not in draw(photographs.IRGSPP_PT_photographs).words
    (photos / "transforms.json").touch()
    assert draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.capture")  # the folder is not looked at each time
    capture_state.forget()
    drawn = draw(cameras.IRGSPP_PT_cameras)
    assert not drawn.buttons("irgspp.capture") and drawn.buttons("irgspp.import_dataset")


def test_without_an_engine_there_is_no_finding(settings, photos, monkeypatch):
    monkeypatch.setattr(engine, "status", lambda: engine.Status("missing", "No engine"))
    settings.dataset = str(photos)
    assert not draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.capture")[0].live


def test_a_video_can_be_chosen(settings, tmp_path):
    assert draw(photographs.IRGSPP_PT_photographs).buttons("irgspp.choose_video")
    (tmp_path / "turn.mp4").touch()
    settings.dataset = str(tmp_path / "turn.mp4")
    assert "Photographs without cameras: 1 video" in draw(photographs.IRGSPP_PT_photographs).words


def test_the_job_is_shown_below_its_button(settings, photos):
    settings.dataset = str(photos)
    folder = photos.resolve().with_name("photos_capture")
    job = Job("j1", "capture", "Find cameras of photos", folder, photos, state="running", phase="match photographs", step=1, of=4)
    job.data, job.made = {"run": str(folder)}, time.time() + 1
    jobs._jobs[job.id] = job
    drawn = draw(cameras.IRGSPP_PT_cameras)
    assert ("progress", 0.25, "25 %") in drawn.drawn and "Step 3 of 7: Matching photographs" in drawn.words
    job.state, job.error = "failed", "the photographs do not overlap"
    drawn = draw(cameras.IRGSPP_PT_cameras)
    assert "the photographs do not overlap" in drawn.words and not drawn.buttons("irgspp.job_resume")  # nothing to go on from
    write_capture(folder, status="running")
    assert draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.job_resume")[0].values == {"job": "j1"}


def test_a_stopped_capture_goes_on_from_its_folder(settings, tmp_path):
    settings.dataset = str(write_capture(tmp_path / "x_capture", status="running"))
    drawn = draw(cameras.IRGSPP_PT_cameras)
    assert "Find Cameras goes on" in drawn.words and drawn.buttons("irgspp.capture") and not drawn.buttons("irgspp.import_dataset")


def test_what_a_capture_found_and_left_out(settings, tmp_path):
    left_out = [{"name": f"IMG_{i}.jpg", "reason": "blurred"} for i in range(6)]
    states = [{"name": "a", "mask": "found"}, {"name": "b", "mask": "touches the border"}, {"name": "c", "mask": "none"}]
    folder = write_capture(tmp_path / "x_capture", left_out=left_out, photographs=states)
    settings.dataset = str(folder)
    drawn = draw(cameras.IRGSPP_PT_cameras)
    assert "Used 3 photographs, 6 left out" in drawn.words and "Masks 2, 1 doubtful: b" in drawn.words
    assert "Left out IMG_3.jpg: blurred" in drawn.words and "IMG_4.jpg" not in drawn.words and "2 more" in drawn.words
    assert "unknown; a marker in the photographs or two measured points" in drawn.words and drawn.buttons("irgspp.import_dataset")
    assert drawn.buttons("wm.path_open")[0].values == {"filepath": str(folder / "report.html")}
    assert drawn.buttons("irgspp.show_image")[0].values == {"filepath": str(folder / "contact_sheet.png")}
    write_capture(folder, metres_per_unit=1.0, photographs=[{"name": "a", "mask": "none"}])
    words = draw(cameras.IRGSPP_PT_cameras).words
    assert "true, in metres" in words and "none: the whole scene is reconstructed" in words
    (folder / "capture.json").write_text("{")
    capture_state.forget()
    assert draw(photographs.IRGSPP_PT_photographs).buttons("irgspp.inspect_dataset")  # which says what is wrong


def test_the_sphere_is_named_where_it_counts(settings, tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "status", lambda: engine.Status("ok", "Engine 1"))
    settings.dataset = str(write_capture(tmp_path / "x_capture"))
    assert "sphere" not in draw(cameras.IRGSPP_PT_cameras).words
    sphere = bpy.data.objects.new("x object", None)
    bpy.context.scene.collection.objects.link(sphere)
    sphere[KEY], sphere[BOUND] = f"{(tmp_path / 'x_capture').resolve()}#object", [0.0, 0.0, 0.0, 1.0]
    sphere.empty_display_size = 1.0
    assert 'Move or scale the sphere "x object"' in draw(cameras.IRGSPP_PT_cameras).words
    assert not draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.capture")
    root = bpy.data.objects.new("x frame", None)
    sphere.parent, root[TO_WORLD] = root, [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    sphere.location.x = 0.1
    assert "What is inside the sphere x object is cut out of the photographs first" in draw(reconstruct.IRGSPP_PT_reconstruct).words
    (button,) = draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.capture")
    assert (button.text, button.values) == ("Cut Out Again", {"directory": settings.dataset})
    write_capture(tmp_path / "x_capture", bound={"centre": [0.1, 0, 0], "radius": 1.0})  # it has been cut out
    assert not draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.capture")
    assert "What is inside the sphere x object is reconstructed" in draw(reconstruct.IRGSPP_PT_reconstruct).words


def test_two_points_are_measured_and_their_distance_is_set(settings, tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "status", lambda: engine.Status("ok", "Engine 1"))
    folder = write_capture(tmp_path / "x_capture").resolve()
    settings.dataset = str(folder)
    assert not draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.place_ends")  # it is not imported yet
    for name in ("object", *PARTS):
        thing = bpy.data.objects.new(name, None)
        bpy.context.scene.collection.objects.link(thing)
        thing[KEY] = f"{folder}#{name}"
        drawn = draw(cameras.IRGSPP_PT_cameras)
        assert bool(drawn.buttons("irgspp.place_ends")) is (name != PARTS[-1])
    assert not drawn.buttons("irgspp.true_size")[0].live
    settings.capture_distance = 0.12
    assert draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.true_size")[0].live


def test_the_job_that_cuts_again_is_shown(settings, tmp_path):
    folder = write_capture(tmp_path / "x_capture").resolve()
    settings.dataset = str(folder)
    job = Job("j1", "capture", "Cut out the object of x_capture", folder, tmp_path, state="running", phase="dense points", step=1, of=4)
    job.data, job.made = {"run": str(folder)}, time.time() + 1
    jobs._jobs[job.id] = job
    assert "Cut out the object of x_capture" in draw(cameras.IRGSPP_PT_cameras).words
    job.state = "done"
    assert "Cut out the object of x_capture" not in draw(cameras.IRGSPP_PT_cameras).words


def test_masks_are_edited_from_a_captured_camera(settings, tmp_path):
    folder = write_capture(tmp_path / "x_capture").resolve()
    settings.dataset = str(folder)
    camera = bpy.data.objects.new("train a", bpy.data.cameras.new("a"))
    camera.data["width"], camera[KEY] = 90, f"{folder}#camera train a"
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.view_layer.update()
    bpy.context.view_layer.objects.active = camera
    assert draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.edit_mask")[0].values == {"camera": "train a"}
    (folder / "capture.json").unlink()
    drawn = draw(cameras.IRGSPP_PT_cameras)
    assert not drawn.buttons("irgspp.edit_mask") and drawn.buttons("irgspp.look_through")


def test_the_panel_of_a_mask_is_in_the_image_editor(settings):
    panel, image = mask.IRGSPP_PT_mask, bpy.data.images.new("mask", 4, 4)
    assert (panel.bl_space_type, panel.bl_category) == ("IMAGE_EDITOR", "IRGS++")
    editor = SimpleNamespace(space_data=SimpleNamespace(image=image))
    assert not panel.poll(editor) and not panel.poll(SimpleNamespace(space_data=None))
    image[MASK] = "/masks/a.png"
    assert panel.poll(editor)
    drawn = draw(panel)
    assert [button.values["blend"] for button in drawn.buttons("irgspp.mask_brush")] == ["ERASE_ALPHA", "ADD_ALPHA"]
    assert drawn.buttons("irgspp.save_masks")[0].live
    assert not bpy.ops.irgspp.mask_brush.poll()  # no Image Editor here
    assert bpy.ops.irgspp.save_masks() == {"FINISHED"}
