# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the engine and of jobs: scripts get results and exceptions; jobs are queued on request."""

import json

import bpy
import pytest
from blender_side import warm
from engine_jobs import DATASET, TINY, leave_finished, until
from engine_jobs import counter as counter
from engine_jobs import registry as registry
from irgspp.core.errors import IrgsppError
from irgspp.core.machine.version import VERSION
from irgspp.irgspp_addon import properties
from irgspp.irgspp_addon.engine import managed as managed_engine
from irgspp.irgspp_addon.engine import process as engine
from irgspp.irgspp_addon.jobs import queue as jobs
from irgspp.irgspp_addon.jobs import result_import, session
from irgspp.panels import registration

SETTINGS = " ".join(f"{key}={value}" for key, value in TINY.items())


@pytest.fixture(autouse=True)
def extension(registry, monkeypatch):
    monkeypatch.setenv("IRGSPP_PYTHON", warm())
    bpy.ops.wm.read_homefile(use_empty=True)
    registration.register()
    yield
    registration.unregister()


def meshes():
    return [thing for thing in bpy.context.scene.objects if thing.type == "MESH"]


def test_reconstruct_to_the_end_and_into_the_scene(tmp_path, tmp_path_factory):
    run = str(tmp_path / "run")
    words = {"dataset": str(DATASET), "run": run, "preset": "draft", "materials": "low-gloss", "seed": 3, "settings": SETTINGS}
    assert bpy.ops.irgspp.reconstruct(**words) == {"FINISHED"}
    noted = json.loads((tmp_path / "run" / "run.json").read_text())
    assert (noted["status"], noted["seed"], noted["settings"]["materials"]) == ("done", 3, "low-gloss")
    assert len(meshes()) == 1
    with pytest.raises(RuntimeError, match="holds another run"):
        bpy.ops.irgspp.reconstruct(**words)
    assert bpy.ops.irgspp.reconstruct(dataset=str(DATASET), run=run, resume=True, import_result=False) == {"FINISHED"}  # with its settings
    assert json.loads((tmp_path / "run" / "run.json").read_text())["seed"] == 3
    leave_finished(tmp_path / "run", tmp_path_factory)  # for the tests of results, which else make one


def test_reconstruct_as_a_job_with_the_panels_settings(tmp_path):
    panel = bpy.context.scene.irgspp
    panel.dataset, panel.run, panel.preset, panel.seed, panel.overrides = str(DATASET), str(tmp_path / "run"), "draft", 5, SETTINGS
    assert bpy.ops.irgspp.reconstruct(wait=False) == {"FINISHED"}
    (job,) = jobs.all_jobs()
    assert [item.name for item in bpy.context.window_manager.irgspp_jobs] == [job.id]
    assert job.state == "running" and job.on_done == "import_result"
    until(lambda: job.phase)
    with pytest.raises(RuntimeError, match="Reconstruct bowl is running for this folder"):
        bpy.ops.irgspp.reconstruct(wait=False)
    assert bpy.ops.irgspp.job_cancel(job=job.id) == {"FINISHED"}
    until(lambda: job.finished)
    assert job.state == "cancelled" and not meshes()
    assert bpy.ops.irgspp.job_resume(job=job.id) == {"FINISHED"}
    assert job.state == "running" and "--resume" in job.arguments and job.arguments[job.arguments.index("--seed") + 1] == "5"
    until(lambda: job.phase)
    bpy.ops.irgspp.job_cancel(job=job.id)
    until(lambda: job.finished)
    assert bpy.ops.irgspp.job_log(job=job.id) == {"FINISHED"}
    assert bpy.ops.irgspp.job_forget(job=job.id) == {"FINISHED"}
    assert jobs.all_jobs() == [] and len(bpy.context.window_manager.irgspp_jobs) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({}, "no folder is chosen"),
        ({"dataset": "/no/such/folder"}, "/no/such/folder: no such folder"),
        ({"dataset": str(DATASET), "settings": "nonsense=1"}, "nonsense"),
        ({"dataset": str(DATASET), "settings": "surface.texture=-5"}, "surface.texture"),
        ({"dataset": str(DATASET), "settings": "data.masks='"}, "[Qq]uot"),
    ],
)
def test_bad_words_are_exceptions_of_one_line(tmp_path, words, message):
    with pytest.raises(RuntimeError, match=message) as caught:
        bpy.ops.irgspp.reconstruct(**({"run": str(tmp_path / "run")} | words))
    assert "Traceback" not in str(caught.value) and len(str(caught.value).strip().splitlines()) == 1
    assert not (tmp_path / "run").exists()


def test_run_folder_beside_the_photographs(tmp_path, monkeypatch):
    def start(kind, title, folder, *_, **__):
        raise IrgsppError(f"would write {folder}")

    monkeypatch.setattr(jobs, "start", start)
    (tmp_path / "photos").mkdir()
    with pytest.raises(RuntimeError, match=r"would write .*photos_irgspp"):
        bpy.ops.irgspp.reconstruct(dataset=str(tmp_path / "photos"), wait=False)


def test_demo_as_a_job(tmp_path):
    assert bpy.ops.irgspp.demo(folder=str(tmp_path / "demo"), wait=False, settings=SETTINGS) == {"FINISHED"}
    (job,) = jobs.all_jobs()
    until(lambda: job.phase)
    assert job.state == "running", job.log_tail()
    assert "draft" in job.arguments  # whoever tries the demo waits for it
    bpy.ops.irgspp.job_cancel(job=job.id)
    until(lambda: job.finished)


def test_result_comes_into_its_scene_by_itself(run_folder, counter):
    """Even where the window shows another scene by then."""
    scene = bpy.context.scene
    job = counter(20, folder=run_folder, on_done="import_result", data=result_import.place_of(scene, "attributes", True))
    other = bpy.data.scenes.new("other")
    bpy.context.window.scene = other
    until(lambda: job.finished)
    assert (job.state, job.error) == ("done", None)
    assert [thing.type for thing in scene.objects].count("MESH") == 1
    assert not other.objects[:]


def test_result_does_not_go_into_another_file(tmp_path, counter):
    place = result_import.place_of(bpy.context.scene, "textures", True)
    job = counter(20, kind="reconstruct", folder=tmp_path / "run", on_done="import_result", data=place)
    bpy.ops.wm.read_homefile(use_empty=True)
    until(lambda: job.finished)
    assert job.state == "done" and "another file is open" in job.error and str(job.folder) in job.error
    assert not meshes()


def quit_and_open(file="") -> None:
    """End the session as quitting Blender does, and open a file in the next."""
    jobs.clear()
    session.end_session()
    bpy.ops.wm.read_homefile(use_empty=True) if not file else bpy.ops.wm.open_mainfile(filepath=str(file))
    jobs.refresh()


def stopped_job(counter, run_folder):
    """A job of the open file that was cancelled."""
    place = result_import.place_of(bpy.context.scene, "textures", True)
    job = counter(1000, kind="reconstruct", folder=run_folder, on_done="import_result", data=place)
    until(lambda: job.step)
    jobs.cancel(job)
    until(lambda: job.finished)
    return job


def resumed(job):
    """Resume a job of an earlier session by its button, to its end."""
    job = jobs.find(job.id)
    job.arguments = ["3"]
    jobs.resume, resume = lambda job: None, jobs.resume
    try:
        assert bpy.ops.irgspp.job_resume(job=job.id) == {"FINISHED"}
    finally:
        jobs.resume = resume
    result_import.import_result(job)
    return job


def test_scene_saved_after_the_start_gets_the_result_in_another_session(tmp_path, run_folder, counter):
    job = stopped_job(counter, run_folder)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "later.blend"))
    quit_and_open(tmp_path / "later.blend")
    resumed(job)
    assert len(meshes()) == 1


def test_scene_that_was_never_saved_is_replaced_by_the_one_of_the_resumption(run_folder, counter):
    job = stopped_job(counter, run_folder)
    quit_and_open()
    resumed(job)
    assert len(meshes()) == 1


def test_result_of_a_file_that_exists_does_not_go_where_it_was_resumed(tmp_path, run_folder, counter):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    job = stopped_job(counter, run_folder)
    quit_and_open()
    with pytest.raises(IrgsppError, match="another file is open"):
        resumed(job)


def test_result_that_is_none_is_told(tmp_path, counter):
    place = result_import.place_of(bpy.context.scene, "textures", True)
    job = counter(1, kind="reconstruct", folder=tmp_path / "run", on_done="import_result", data=place)
    until(lambda: job.finished)
    assert job.state == "done" and "done, but" in job.error


@pytest.mark.parametrize("name", ["cancel", "finish", "resume", "forget", "log"])
def test_unknown_job_is_an_exception(name):
    with pytest.raises(RuntimeError, match="does not exist; choose it in the list"):
        getattr(bpy.ops.irgspp, f"job_{name}")(job="nonsense")


def test_wishes_that_do_not_fit_the_state(tmp_path, counter):
    job = counter(1, kind="reconstruct", folder=tmp_path / "run")
    until(lambda: job.finished)
    for name, message in (("finish", "not optimising"), ("resume", "is done, which can't be resumed")):
        with pytest.raises(RuntimeError, match=message):
            getattr(bpy.ops.irgspp, f"job_{name}")(job=job.id)


def test_engine_operators(tmp_path, monkeypatch):
    assert bpy.ops.irgspp.check_engine() == {"FINISHED"}
    assert VERSION in engine.status().text
    assert not bpy.ops.irgspp.remove_engine.poll() and not bpy.ops.irgspp.open_engine_folder.poll()
    with pytest.raises(RuntimeError, match=r"\*\.whl"):
        bpy.ops.irgspp.install_engine(device="cpu", wheels=str(tmp_path))
    managed_engine.folder().mkdir(parents=True)
    assert bpy.ops.irgspp.remove_engine() == {"FINISHED"} and not managed_engine.folder().exists()
    monkeypatch.setenv("IRGSPP_PYTHON", str(tmp_path / "none"))
    with pytest.raises(RuntimeError, match="does not exist"):
        bpy.ops.irgspp.check_engine()
    with pytest.raises(RuntimeError, match="does not exist"):
        bpy.ops.irgspp.reconstruct(dataset=str(DATASET), run=str(tmp_path / "run"))
    with pytest.raises(RuntimeError, match="does not exist"):
        bpy.ops.irgspp.demo(folder=str(tmp_path / "run"))


def test_every_operator_says_what_it_does():
    for cls in registration.CLASSES:
        if issubclass(cls, bpy.types.Operator):
            told = getattr(bpy.ops.irgspp, cls.bl_idname.split(".")[1]).get_rna_type()
            assert told.description, cls
            shown = [p for p in told.properties if not p.is_hidden and p.identifier not in ("rna_type", "directory", "filepath")]
            assert not [p.identifier for p in shown if not p.description], cls


def test_registering_twice_leaves_nothing_behind():
    for _ in range(2):
        registration.unregister()
        assert not bpy.app.timers.is_registered(registration.job_timer._tick)
        assert not [f for f in bpy.app.handlers.load_post if "irgspp" in f.__module__]
        assert properties.show_jobs not in jobs.CHANGED
        registration.register()
    assert jobs.CHANGED.count(properties.show_jobs) == 1
