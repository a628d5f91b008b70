# SPDX-License-Identifier: GPL-3.0-or-later
"""Job queue: order of jobs, one job per folder, history, saved files; a quick script replaces the engine."""

import bpy
import pytest
from engine_jobs import PATIENCE, until
from engine_jobs import counter as counter
from engine_jobs import registry as registry
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.io.file_lock import FileLock
from irgspp.irgspp_addon.jobs import queue

pytestmark = pytest.mark.usefixtures("registry")


def test_jobs_wait_for_each_other_but_short_ones_do_not(counter):
    first, second, third = counter(), counter(), counter()
    short = counter(3, kind="inspect")
    assert [job.state for job in (first, second, third, short)] == ["running", "queued", "queued", "running"]
    assert queue.all_jobs() == [short, third, second, first] and set(queue.running()) == {first, short}
    queue.cancel(third)
    assert third.state == "cancelled"
    until(lambda: short.finished and first.step > 2)
    assert short.state == "done" and short.output().strip() == "counted 3"
    queue.cancel(first)
    until(lambda: first.finished)
    assert second.state == "running"
    assert 0 < first.fraction < 1 and first.of == 1000
    queue.cancel(second)
    queue.wait(second, PATIENCE)


def test_failing_import_of_the_result_is_reported_and_does_not_stop_the_queue(counter):
    def broken(job):
        raise IrgsppError("another file is open")

    queue.ON_DONE["broken"] = broken
    job = queue.wait(counter(2, on_done="broken"), PATIENCE)
    del queue.ON_DONE["broken"]
    assert job.state == "done" and "another file is open" in job.error


def test_one_job_per_folder(tmp_path, counter):
    counter(folder=tmp_path / "run", kind="reconstruct")
    with pytest.raises(InputError, match=r"count to 1000 is running for this folder"):
        counter(folder=tmp_path / "run", kind="reconstruct")
    assert counter(folder=tmp_path / "run", kind="render").state == "queued"  # reads it later


def test_folder_in_use_by_another_program(tmp_path, counter):
    (tmp_path / "run").mkdir()
    lock = FileLock(tmp_path / "run" / ".lock")
    with pytest.raises(InputError, match="in use by another Blender"):
        counter(folder=tmp_path / "run", kind="reconstruct")
    lock.release()
    assert queue.all_jobs() == []
    assert counter(folder=tmp_path / "run", kind="reconstruct").state == "running"


def test_forgetting_deletes_the_private_folder_alone(tmp_path, counter):
    (tmp_path / "run").mkdir()
    job = counter(2, folder=tmp_path / "run", kind="reconstruct")
    with pytest.raises(InputError, match="cancel it first"):
        queue.forget(job)
    queue.wait(job, PATIENCE)
    queue.forget(job)
    assert queue.all_jobs() == [] and not job.notes.exists() and (tmp_path / "run").exists()
    assert queue.find(job.id) is None


def test_history_is_limited(counter, monkeypatch):
    monkeypatch.setattr(queue, "HISTORY", 2)
    made = [queue.wait(counter(1), PATIENCE) for _ in range(4)]
    counter(1)
    assert [job.id for job in queue.all_jobs()[1:]] == [made[3].id, made[2].id]
    assert not made[0].notes.exists()


def test_listeners_are_called_with_job_ids(counter):
    calls = []
    queue.CHANGED.append(calls.append)
    job = counter(1)
    queue.CHANGED.remove(calls.append)
    assert calls == [[job.id]]


def test_saving_a_file_leaves_jobs_alone(tmp_path, counter):
    job = counter(30)
    until(lambda: job.step > 2)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    queue.refresh()
    assert queue.find(job.id) is job and job.state == "running"
    assert queue.wait(job, PATIENCE).state == "done"


def test_damaged_job_files_are_ignored(counter):
    job = queue.wait(counter(1), PATIENCE)
    for name, text in (("a", "{"), ("b", "[]"), ("c", '{"id": 1}')):
        (queue.jobs_folder() / name).mkdir()
        (queue.jobs_folder() / name / "job.json").write_text(text)
    with (job.notes / "events.jsonl").open("a") as events:
        events.write('{"phase": "tru\n[1]\nnull\n{"phase": "late", "step": 1, "of": 2}\n{"phase": "unfinished li')
    queue.clear()
    queue.refresh()
    (found,) = queue.all_jobs()
    assert (found.id, found.state, found.phase, found.step) == (job.id, "done", "late", 1)
