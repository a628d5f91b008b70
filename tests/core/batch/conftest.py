# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs whose commands are replaced by a small program; the dataset's name decides how it ends."""

from pathlib import Path

import pytest
from irgspp.core.batch import job_runner as work
from irgspp.core.batch.jobs import Job

STAND_IN = '''
"""core.cli.batch_child LOCK reconstruct DATASET -o RUN ...: the dataset's name decides what happens."""
import json, os, pathlib, sys, threading, time
_, lock, command, *words = sys.argv[1:]
if command != "reconstruct":
    print(command, "by", os.environ.get("IRGSPP_THREADS"))
    if "-o" in words:
        pathlib.Path(words[words.index("-o") + 1]).write_text("made")
    sys.exit(0)
dataset, run = pathlib.Path(words[0]).name, pathlib.Path(words[2])
if dataset == "bad":
    print("irgspp: bad: no such thing", file=sys.stderr)
    sys.exit(2)
if dataset == "crash":
    os.kill(os.getpid(), 9)
run.mkdir(parents=True, exist_ok=True)
starts = run / "starts.txt"
with starts.open("a") as file:
    file.write(" ".join(words) + "\\n")
state = {"status": "running", "phases": {}, "settings": {}}
(run / "run.json").write_text(json.dumps(state))
with (pathlib.Path(os.environ["IRGSPP_JOB"]) / "events.jsonl").open("a") as file:
    file.write(json.dumps({"phase": "first stage", "step": 3, "of": 12, "eta": 75.0}) + "\\n")
if dataset == "long" and "--resume" not in words:
    ended = threading.Event()
    threading.Thread(target=lambda: (os.read(0, 1), ended.set()), daemon=True).start()
    sys.exit(130 if ended.wait(60) else 1)
(run / "run.json").write_text(json.dumps({**state, "status": "done"}))
'''


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """Return a function that makes a job of one of the stand-in's kinds: good, bad, crash, long."""
    script = tmp_path / "stand_in.py"
    script.write_text(STAND_IN)
    monkeypatch.setattr(work, "LAUNCHER", script)
    monkeypatch.delenv("IRGSPP_THREADS", raising=False)

    def job(name: str, kind: str = "good", *after: tuple[str, ...]) -> Job:
        run = tmp_path / "runs" / name
        return Job(name, run, (("reconstruct", kind, "-o", str(run)), *after), tmp_path)

    return job


@pytest.fixture
def notes(tmp_path) -> Path:
    return tmp_path / "jobs.batch"
