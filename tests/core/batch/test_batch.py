# SPDX-License-Identifier: GPL-3.0-or-later
"""Job lists on this machine: failures, resuming, cancelling, the table. A stand-in replaces the commands."""

import io
import json
import sys

import pytest
from irgspp.core.batch import batch as batches
from irgspp.core.batch.batch import run_batch
from irgspp.core.batch.job_state import JobFolder, JobProgress, State
from irgspp.core.batch.table import BatchTable, progress_text, row_line, summary
from irgspp.core.cli.main import main
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.io.file_lock import FileLock


def never() -> bool:
    return False


def starts(job) -> list[str]:
    return (job.run / "starts.txt").read_text().splitlines()


@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
def test_one_failure_never_stops_the_rest(stand_in, notes):
    jobs = [stand_in("a"), stand_in("b", "bad"), stand_in("c", "crash"), stand_in("d")]
    states = run_batch(jobs, notes, never, at_once=2)
    assert {name: state.state for name, state in states.items()} == {"a": "done", "b": "failed", "c": "failed", "d": "done"}
    assert states["b"].error == "bad: no such thing"
    assert states["c"].error.startswith("its process was ended by signal 9")
    assert JobFolder(notes / "b").read() == states["b"] and states["a"].seconds > 0


def test_what_is_done_is_left_alone_and_what_failed_is_tried_again(stand_in, notes, tmp_path):
    made = tmp_path / "a.glb"
    jobs = [stand_in("a", "good", ("export", "a", "-o", str(made))), stand_in("b", "bad")]
    run_batch(jobs, notes, never)
    made.unlink()
    states = run_batch([jobs[0], stand_in("b")], notes, never)
    assert {state.state for state in states.values()} == {"done"}
    assert len(starts(jobs[0])) == 1 and made.read_text() == "made"  # only what was missing is made again
    (jobs[0].run / "run.json").unlink()  # a run that was thrown away
    run_batch(jobs[:1], notes, never)
    assert len(starts(jobs[0])) == 2


def test_a_stopped_run_goes_on(stand_in, notes):
    """A killed batch leaves "running" in the run's and the job's saved state."""
    job = stand_in("a", "long")
    job.run.mkdir(parents=True)
    (job.run / "run.json").write_text(json.dumps({"status": "running", "phases": {}, "settings": {}}))
    JobFolder(notes / "a").prepare()
    JobFolder(notes / "a").write(State("running", seconds=5.0))
    states = run_batch([job], notes, never)
    assert states["a"].state == "done" and states["a"].seconds > 5 and starts(job)[-1].endswith("--resume")


def test_cancelling_saves_what_runs_and_leaves_the_rest(stand_in, notes):
    jobs = [stand_in("a"), stand_in("b", "long"), stand_in("c")]
    b = jobs[1].run / "starts.txt"
    with pytest.raises(Cancelled, match="1 of 3 jobs are done"):
        run_batch(jobs, notes, b.exists)
    assert [JobFolder(notes / name).read().state for name in "abc"] == ["done", "cancelled", "waiting"]
    states = run_batch(jobs, notes, never)
    assert {state.state for state in states.values()} == {"done"} and starts(jobs[1])[-1].endswith("--resume")


def test_cores_are_shared_by_jobs_that_run_at_a_time(stand_in, notes, monkeypatch):
    monkeypatch.setattr("irgspp.core.batch.workers.cores", lambda: 8)
    run_batch([stand_in("a", "good", ("evaluate",))], notes, never, at_once=3)
    run_batch([stand_in("b", "good", ("evaluate",))], notes, never)
    assert "evaluate by 2" in (notes / "a" / "log.txt").read_text()
    assert "evaluate by None" in (notes / "b" / "log.txt").read_text()


def test_two_batches_of_one_list(stand_in, notes):
    notes.mkdir()
    lock = FileLock(notes / batches.LOCK)
    with pytest.raises(InputError, match="another process works on this list"):
        run_batch([stand_in("a")], notes, never)
    lock.release()


def test_a_fault_of_ours_is_a_failed_job(stand_in, notes, monkeypatch):
    monkeypatch.setattr("irgspp.core.batch.job_runner._run", lambda *_: 1 / 0)
    assert run_batch([stand_in("a")], notes, never)["a"] == State("failed", "ZeroDivisionError: division by zero")


# --- from the command line


@pytest.fixture
def listed(stand_in, tmp_path):
    def write(*kinds: str) -> str:
        tables = "".join(f'[[job]]\ndataset = "{kind}"\noutput = "runs/{i}"\n' for i, kind in enumerate(kinds))
        (tmp_path / "jobs.toml").write_text(tables)
        return str(tmp_path / "jobs.toml")

    return write


def test_exit_statuses_and_a_line_for_each_job(listed, capsys, tmp_path, monkeypatch):
    assert main(["batch", listed("good", "good"), "-j", "2"]) == 0
    assert capsys.readouterr().out.splitlines() == ["0: done", "1: done"]
    assert main(["batch", listed("good", "bad")]) == 1
    captured = capsys.readouterr()
    assert captured.out.splitlines() == ["0: done", f"1: failed: bad: no such thing (more in {tmp_path / 'jobs.batch' / '1' / 'log.txt'})"]
    assert "1                    failed    bad: no such thing" in captured.err
    monkeypatch.setattr(batches, "_watch", lambda tickets, states, *_: states.update(dict.fromkeys(tickets, State("cancelled"))))
    assert main(["batch", listed("good", "bad")]) == 130
    assert "irgspp: cancelled: 1 of 2 jobs are done; run the same command again to continue with the others" in capsys.readouterr().err


def test_a_bad_list_starts_nothing(tmp_path, capsys):
    (tmp_path / "jobs.toml").write_text('[[job]]\ndataset = "d"\noutput = "o"\npreset = 3\n')
    assert main(["batch", str(tmp_path / "jobs.toml")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["jobs.toml"]


def test_dask_without_a_scheduler(listed, capsys, monkeypatch):
    monkeypatch.setattr("irgspp.core.batch.workers.CONNECT_SECONDS", 0.2)
    assert main(["batch", listed("good"), "--dask", "tcp://127.0.0.1:9"]) == 2
    assert "no scheduler answers there" in capsys.readouterr().err.splitlines()[-1]


# --- the table

ROWS = [
    ("bear", State("done", seconds=65.0), JobProgress()),
    ("fox", State("running"), JobProgress("first stage", 30, 120, 75.0)),
    ("owl", State("failed", "photos: no such folder"), JobProgress()),
    ("elk", State(), JobProgress()),
]


def test_rows_say_how_far_each_is():
    assert [row_line(*row).split(maxsplit=1)[1] for row in ROWS] == [
        "done      in 1:05",
        "running   first stage  25%  1:15 left",
        "failed    photos: no such folder",
        "waiting",
    ]
    assert summary(ROWS) == "4 jobs: 1 done, 1 running, 1 waiting, 1 failed"
    assert progress_text(JobProgress()) == "starting" and progress_text(JobProgress("scene", 0, 0)) == "scene"


def test_in_a_file_a_line_is_a_change():
    stream = io.StringIO()
    board = BatchTable(stream)
    board.show(ROWS, last=True)
    board.show(ROWS, last=True)
    changed = [*ROWS[:1], ("fox", State("done", seconds=80.0), JobProgress()), *ROWS[2:]]
    board.show(changed, last=True)
    assert [line.split()[:2] for line in stream.getvalue().splitlines()] == [
        ["bear", "done"],
        ["fox", "running"],
        ["owl", "failed"],
        ["fox", "done"],
    ]


def test_on_a_terminal_the_table_stays_in_its_place(monkeypatch):
    class Tty(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr("shutil.get_terminal_size", lambda: (40, 5))
    stream, many = Tty(), [*ROWS, *((f"job {i}", State(), JobProgress()) for i in range(20))]
    board = BatchTable(stream)
    board.show(many)
    assert "fox" in stream.getvalue() and "owl" in stream.getvalue() and "bear" not in stream.getvalue()  # no room for all
    before = len(stream.getvalue())
    board.show(many)  # too soon
    assert len(stream.getvalue()) == before
    board.show(many, last=True)
    text = stream.getvalue()[before:]
    assert text.startswith("\x1b[4A") and "bear" in text and "job 19" in text and all(len(line) < 60 for line in text.splitlines())
