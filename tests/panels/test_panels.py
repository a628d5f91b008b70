# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels in every state: they draw what exists, and say why a button is disabled."""

import json
import time

import bpy
import pytest
from irgspp.irgspp_addon.engine import process as engine
from irgspp.irgspp_addon.jobs import queue as jobs
from irgspp.irgspp_addon.properties import show_jobs
from irgspp.irgspp_addon.shared_properties import PRESETS
from irgspp.panels import asset, cameras, export, images, job_card, photographs, reconstruct, registration, relight, result, run_state
from irgspp.panels import engine as engine_panel
from irgspp.panels import jobs as jobs_panel
from panel_states import add_job, finished_run
from panel_states import settings as settings
from recording_layout import draw

ROWS = [["dataset", "/p"], ["format", "transforms"], ["views", "40 training, 6 test"], ["images", "64x64, png"], ["masks", "none"]]


def all_panels():
    return [
        cls
        for module in (engine_panel, photographs, cameras, reconstruct, result, relight, export, asset, jobs_panel)
        for cls in module.CLASSES
        if cls.bl_rna.base.name == "Panel"
    ]


def test_panels_are_in_the_order_of_work(settings):
    tops = [cls for cls in all_panels() if not hasattr(cls, "bl_parent_id")]
    assert [cls.bl_label for cls in sorted(tops, key=lambda cls: cls.bl_order)] == [
        "Engine", "1 Photographs", "2 Cameras and Object", "3 Reconstruct", "4 Look and Relight", "5 Export", "Jobs",
    ]  # fmt: skip
    assert {(cls.bl_space_type, cls.bl_region_type, cls.bl_category) for cls in all_panels()} == {("VIEW_3D", "UI", "IRGS++")}
    registered = {cls.__name__ for cls in bpy.types.Panel.__subclasses__()}
    assert {cls.__name__ for cls in all_panels()} <= registered


def test_tooltips_are_the_docstrings_without_the_full_stop_that_blender_adds(settings):
    operators = [cls for cls in registration.CLASSES if issubclass(cls, bpy.types.Operator)]
    assert len(operators) > 15
    for cls in operators:
        group, _, name = cls.bl_idname.partition(".")
        tooltip = getattr(getattr(bpy.ops, group), name).get_rna_type().description
        assert tooltip and cls.__doc__ == f"{tooltip}." and not tooltip.endswith("."), cls


def test_everything_draws_in_an_empty_scene(settings):
    for panel in all_panels():
        draw(panel)


def test_a_first_visit_is_guided(settings):
    drawn = draw(photographs.IRGSPP_PT_photographs)
    assert "Choose a folder of photographs" in drawn.words
    assert drawn.buttons("irgspp.demo")[0].live
    start = draw(reconstruct.IRGSPP_PT_reconstruct)
    assert not start.buttons("irgspp.reconstruct")[0].live
    assert "First choose photographs." in start.words
    assert not relight.IRGSPP_PT_relight.poll(bpy.context)


def test_without_an_engine_its_panel_is_first(settings, monkeypatch):
    monkeypatch.setattr(engine, "status", lambda: engine.Status("missing", "No engine: choose one"))
    assert engine_panel.IRGSPP_PT_engine.poll(bpy.context)
    drawn = draw(engine_panel.IRGSPP_PT_engine)
    assert "No engine: choose one" in drawn.words
    assert drawn.buttons("preferences.addon_show")[0].values["module"] == engine_panel.EXTENSION
    assert not draw(photographs.IRGSPP_PT_photographs).buttons("irgspp.demo")[0].live
    settings.dataset = str(images.__file__)  # a file, of which nothing is known to be lacking
    step = draw(cameras.IRGSPP_PT_cameras)
    assert not step.buttons("irgspp.import_dataset")[0].live and "set up the engine" in step.words
    start = draw(reconstruct.IRGSPP_PT_reconstruct)
    assert "set up the engine" in start.words and not start.buttons("irgspp.reconstruct")[0].live
    monkeypatch.setattr(engine, "status", lambda: engine.Status("ok", "Engine 1"))
    assert not engine_panel.IRGSPP_PT_engine.poll(bpy.context)


def test_what_was_found_and_its_problems(settings, tmp_path):
    (tmp_path / "transforms.json").write_text("{}")
    settings.dataset = str(tmp_path)
    settings.inspected = json.dumps({"rows": ROWS, "warnings": ["3 photographs are missing"]})
    words = draw(photographs.IRGSPP_PT_photographs).words
    assert "Views 40 training, 6 test" in words and "3 photographs are missing" in words and "/p" not in words
    button = draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.import_dataset")[0]
    assert button.values["photographs"] is True and button.values["up_axis"] == "AS_IS"
    settings.dataset = str(tmp_path / "other")
    assert settings.inspected == "" and "40 training" not in draw(photographs.IRGSPP_PT_photographs).words


def test_the_object_of_posed_photographs_without_masks_can_be_cut_out(settings, tmp_path):
    (tmp_path / "transforms.json").write_text("{}")
    settings.dataset = str(tmp_path)
    assert not draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.capture")
    settings.inspected = json.dumps({"rows": ROWS, "warnings": []})
    (button,) = draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.capture")
    assert button.live and button.values["directory"] == str(tmp_path) and button.values["marker"] == 0
    settings.inspected = json.dumps({"rows": [*ROWS[:-1], ["masks", "40 of 40 training views"]], "warnings": []})
    assert not draw(cameras.IRGSPP_PT_cameras).buttons("irgspp.capture")


GPU = {"cuda": [{"index": 0, "name": "RTX 5000", "memory": 1}], "notes": ["cuda can be used"]}


def test_time_and_memory_are_told_before_the_job_starts(settings, tmp_path, monkeypatch):
    (tmp_path / "transforms.json").write_text("{}")
    settings.dataset = str(tmp_path)
    assert "On the CPU" not in draw(reconstruct.IRGSPP_PT_reconstruct).words
    jobs = {
        name: {"seconds": 1, "memory": 1, "text": f"about {time} min, 1.5 GiB of memory"} for name, time in (("draft", 1), ("balanced", 3))
    }
    settings.inspected = json.dumps({"rows": ROWS, "warnings": [], "jobs": jobs})
    assert "On the CPU: about 3 min, 1.5 GiB of memory." in draw(reconstruct.IRGSPP_PT_reconstruct).words
    settings.preset = "draft"
    assert "On the CPU: about 1 min" in draw(reconstruct.IRGSPP_PT_reconstruct).words
    assert "will be used" not in draw(reconstruct.IRGSPP_PT_reconstruct).words
    monkeypatch.setattr(engine, "status", lambda: engine.Status("ok", "", GPU))
    assert "RTX 5000 will be used; the estimate is for the processor." in draw(reconstruct.IRGSPP_PT_reconstruct).words
    settings.device = "cpu"
    assert "will be used" not in draw(reconstruct.IRGSPP_PT_reconstruct).words
    settings.device = "cuda"
    monkeypatch.setattr(engine, "status", lambda: engine.Status("ok", "", {**GPU, "notes": ["cuda can't be used: too old"]}))
    assert "A graphics card will be used" in draw(reconstruct.IRGSPP_PT_reconstruct).words
    settings.preset = "paper"  # its time is not known
    assert "On the CPU" not in draw(reconstruct.IRGSPP_PT_reconstruct).words


def test_a_dataset_that_can_not_be_read_shows_the_error(settings, tmp_path):
    settings.dataset = str(tmp_path)
    add_job(tmp_path, kind="inspect", state="failed", error="transforms.json: no such file", data={"dataset": str(tmp_path.resolve())})
    assert "transforms.json: no such file" in draw(photographs.IRGSPP_PT_photographs).words


def test_a_running_reconstruction(settings, tmp_path):
    settings.dataset = str(tmp_path / "photos")
    add_job(
        tmp_path,
        state="running",
        phase="first stage",
        step=100,
        of=400,
        eta=65.0,
        metrics={"loss": 0.02, "psnr": 28.0},
        message="a word",
        made=time.time(),
    )
    drawn = draw(reconstruct.IRGSPP_PT_reconstruct)
    assert ("progress", 0.25, "25 %, 1:05 min left") in drawn.drawn
    assert "Fitting shape and radiance" in drawn.words and "PSNR 28.0 dB" in drawn.words and "a word" in drawn.words
    assert drawn.buttons("irgspp.job_finish")[0].values == {"job": "j1"}
    assert drawn.buttons("irgspp.job_cancel")[0].live
    assert not drawn.buttons("irgspp.reconstruct")  # one at a time


@pytest.mark.parametrize("state", ["failed", "cancelled", "lost"])
def test_a_stopped_reconstruction_can_be_resumed(settings, tmp_path, state):
    settings.run = str(tmp_path)
    settings.dataset = str(tmp_path)
    finished_run(tmp_path, status="failed")
    add_job(tmp_path, state=state, error="disk full", began=10.0, ended=75.0)
    drawn = draw(reconstruct.IRGSPP_PT_reconstruct)
    assert "after 1:05 min" in drawn.words and "disk full" in drawn.words
    (resume,), (again,) = drawn.buttons("irgspp.job_resume"), drawn.buttons("irgspp.reconstruct")
    assert resume.values == drawn.buttons("irgspp.job_log")[0].values == {"job": "j1"}
    assert (again.text, again.values) == ("Start Over", {"overwrite": True})  # what replaces the run comes second
    operators = [entry[1] for entry in drawn.drawn if entry[0] == "operator"]
    assert operators.index("irgspp.job_resume") < operators.index("irgspp.reconstruct")
    (tmp_path / "run.json").unlink()  # refused before anything was done
    run_state._known.clear()
    assert not draw(reconstruct.IRGSPP_PT_reconstruct).buttons("irgspp.job_resume")
    finished_run(tmp_path, status="failed")
    run_state._known.clear()
    jobs.clear()  # started elsewhere: the folder alone says it
    assert {"resume": True} in [button.values for button in draw(reconstruct.IRGSPP_PT_reconstruct).buttons("irgspp.reconstruct")]


def test_a_job_of_another_run_is_not_shown(settings, tmp_path):
    settings.run = str(tmp_path / "mine")
    add_job(tmp_path / "other", state="done")
    assert job_card.current_job(settings.run_path()) is None
    add_job(tmp_path / "other", id="j2", state="running")
    assert job_card.current_job(settings.run_path()).id == "j2"  # but what is under way is


def test_list_of_jobs(settings, tmp_path):
    assert "No jobs yet" in draw(jobs_panel.IRGSPP_PT_jobs).words
    add_job(tmp_path, state="done", made=1.0)
    add_job(tmp_path, id="j2", title="Bake", kind="bake", state="running", made=2.0)
    drawn = draw(jobs_panel.IRGSPP_PT_jobs)
    assert ("list", 2) in drawn.drawn and not drawn.buttons("irgspp.job_forget")  # the newest is chosen, and it runs
    bpy.context.window_manager.irgspp_job_index = 1
    assert draw(jobs_panel.IRGSPP_PT_jobs).buttons("irgspp.job_forget")[0].values == {"job": "j1"}
    add_job(tmp_path, id="j3", state="queued", made=3.0)
    assert jobs_panel.chosen_job(bpy.context.window_manager).id == "j3"
    show_jobs(["j2", "j1"])
    assert jobs_panel.chosen_job(bpy.context.window_manager).id == "j2"


def test_a_preview_is_shown_while_it_is_there(settings, tmp_path, monkeypatch):
    now = [50.0]
    monkeypatch.setattr(images.time, "monotonic", lambda: now[0])
    latest = tmp_path / "latest.png"
    job = add_job(tmp_path, state="running", preview=latest)
    presets = len(PRESETS)  # their pictures are above
    drawn = lambda: [e for e in draw(reconstruct.IRGSPP_PT_reconstruct).drawn if e[0] == "picture"][presets:]  # noqa: E731
    assert drawn() == []
    image = bpy.data.images.new("p", 8, 8)
    image.filepath_raw, image.file_format = str(latest), "PNG"
    image.save()
    now[0] += 1
    assert len(drawn()) == 1
    latest.unlink()
    now[0] += 1
    assert drawn() == [] and job.preview == latest


def test_defaults_are_those_of_the_engine(settings):
    from irgspp.core.settings.schema import PRESETS, Settings

    defaults = Settings()
    for name in ("preset", "materials", "device", "seed"):
        assert getattr(settings, name) == getattr(defaults, name)
    assert {item.identifier for item in settings.bl_rna.properties["preset"].enum_items} == set(PRESETS)
    assert settings.source == defaults.export.material and int(settings.texture_size) == defaults.surface.texture_least
    without = [p.identifier for p in settings.bl_rna.properties if not p.description and p.identifier not in ("name", "rna_type")]
    assert not without  # every property has its tooltip


def test_run_folder_is_beside_the_photographs(settings, tmp_path):
    assert settings.run_path() is None and settings.dataset_path() is None
    settings.dataset = f"{tmp_path}/spot/"
    assert settings.run_path() == tmp_path / "spot_irgspp"
    settings.run = str(tmp_path / "elsewhere")
    assert settings.run_path() == tmp_path / "elsewhere"


def test_a_job_that_stopped_with_blender_is_not_said_to_be_cancelled(settings, tmp_path):
    settings.run = settings.dataset = str(tmp_path)
    finished_run(tmp_path, status="cancelled")
    job = add_job(tmp_path, state="cancelled", error="Blender was closed", began=10.0, ended=75.0)
    words = draw(reconstruct.IRGSPP_PT_reconstruct).words
    assert "Stopped after 1:05 min Blender was closed" in words and "Cancelled" not in words
    job.error = None
    assert "Cancelled after 1:05 min" in draw(reconstruct.IRGSPP_PT_reconstruct).words
