# SPDX-License-Identifier: GPL-3.0-or-later
"""The keeping of jobs: who waits for whom, one job a folder, the history, files that are saved; a quick script stands for the engine."""

import bpy
import pytest
from engine_jobs import PATIENCE, until
from engine_jobs import counter as counter
from engine_jobs import registry as registry
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.io.file_lock import FileLock
from irgspp.irgspp_addon.jobs import queue as jobs

pytestmark = pytest.mark.usefixtures("registry")


def test_jobs_wait_for_each_other_but_short_ones_do_not(counter):
    first, second, third = counter(), counter(), counter()
    short = counter(3, kind="inspect")
    assert [job.state for job in (first, second, third, short)] == ["running", "queued", "queued", "running"]
    assert jobs.all_jobs() == [short, third, second, first] and set(jobs.running()) == {first, short}
    jobs.cancel(third)
    assert third.state == "cancelled"
    until(lambda: short.finished and first.step > 2)
    assert short.state == "done" and short.output().strip() == "counted 3"
    jobs.cancel(first)
    until(lambda: first.finished)
    assert second.state == "running"
    assert 0 < first.fraction < 1 and first.of == 1000
    jobs.cancel(second)
    jobs.wait(second, PATIENCE)


def test_failing_import_of_the_result_is_told_and_spoils_nothing(counter):
    def broken(job):
        raise IrgsppError("another file is open")

    jobs.ON_DONE["broken"] = broken
    job = jobs.wait(counter(2, on_done="broken"), PATIENCE)
    del jobs.ON_DONE["broken"]
    assert job.state == "done" and "another file is open" in job.error


def test_one_job_per_folder(tmp_path, counter):
    counter(folder=tmp_path / "run", kind="reconstruct")
    with pytest.raises(InputError, match=r"count to 1000 is running for this folder"):
        counter(folder=tmp_path / "run", kind="reconstruct")
    assert counter(folder=tmp_path / "run", kind="render").state == "queued"  # reads it later


def test_folder_that_another_program_works_in(tmp_path, counter):
    (tmp_path / "run").mkdir()
    lock = FileLock(tmp_path / "run" / ".lock")
    with pytest.raises(InputError, match="in use by another Blender"):
        counter(folder=tmp_path / "run", kind="reconstruct")
    lock.release()
    assert jobs.all_jobs() == []
    assert counter(folder=tmp_path / "run", kind="reconstruct").state == "running"


def test_forgetting_takes_the_notes_and_nothing_else(tmp_path, counter):
    (tmp_path / "run").mkdir()
    job = counter(2, folder=tmp_path / "run", kind="reconstruct")
    with pytest.raises(InputError, match="cancel it first"):
        jobs.forget(job)
    jobs.wait(job, PATIENCE)
    jobs.forget(job)
    assert jobs.all_jobs() == [] and not job.notes.exists() and (tmp_path / "run").exists()
    assert jobs.find(job.id) is None


def test_history_is_short(counter, monkeypatch):
    monkeypatch.setattr(jobs, "HISTORY", 2)
    made = [jobs.wait(counter(1), PATIENCE) for _ in range(4)]
    counter(1)
    assert [job.id for job in jobs.all_jobs()[1:]] == [made[3].id, made[2].id]
    assert not made[0].notes.exists()


def test_listeners_hear_of_jobs(counter):
    heard = []
    jobs.CHANGED.append(heard.append)
    job = counter(1)
    jobs.CHANGED.remove(heard.append)
    assert heard == [[job.id]]


def test_saving_a_file_leaves_jobs_alone(tmp_path, counter):
    job = counter(30)
    until(lambda: job.step > 2)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    jobs.refresh()
    assert jobs.find(job.id) is job and job.state == "running"
    assert jobs.wait(job, PATIENCE).state == "done"


def test_notes_that_are_broken_are_no_jobs(counter):
    job = jobs.wait(counter(1), PATIENCE)
    for name, text in (("a", "{"), ("b", "[]"), ("c", '{"id": 1}')):
        (jobs.jobs_folder() / name).mkdir()
        (jobs.jobs_folder() / name / "job.json").write_text(text)
    with (job.notes / "events.jsonl").open("a") as events:
        events.write('{"phase": "tru\n[1]\nnull\n{"phase": "late", "step": 1, "of": 2}\n{"phase": "unfinished li')
    jobs.clear()
    jobs.refresh()
    (found,) = jobs.all_jobs()
    assert (found.id, found.state, found.phase, found.step) == (job.id, "done", "late", 1)
