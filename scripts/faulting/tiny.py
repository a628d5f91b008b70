# SPDX-License-Identifier: GPL-3.0-or-later
"""Job of some seconds, in processes of its own that may be killed at any moment."""

from __future__ import annotations

import atexit
import functools
import json
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings, preset

VIEWS, CHECKS = 20, 1  # training and test views of the demonstration
SETTINGS = (
    "materials=low-gloss",
    "data.resolution=32",
    "first.iterations=80",
    "first.gaussians=1000",
    "second.points=200",
    "second.rows=4",
    "second.views=4",
    "second.iterations=8",
    "second.pool=1000",
    "second.radiance_iterations=8",
    "second.normal_iterations=8",
    "surface.voxels=24",
    "surface.triangles=500",
    "surface.texture=64",
)
CHECKPOINT_SECONDS = 0.05
EVENTS = ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "shutil.rmtree")  # audit events of operations on files
LOGS = ("events.jsonl", "log.txt")  # files that are only appended to
VARYING = ("run.json", "scene.blend", "first_stage.pt")  # hold times, addresses or the moment of a checkpoint


def settings() -> Settings:
    """Return the settings of the job."""
    return with_overrides(preset("draft"), SETTINGS)


def write_dataset(folder: Path) -> Path:
    """Write a few views of the demonstration's photographs, and return the folder."""
    for name, count in (("train", VIEWS), ("test", CHECKS)):
        content = json.loads((DEMO_DATA / f"transforms_{name}.json").read_text())
        content["frames"] = content["frames"][:: len(content["frames"]) // count][:count]
        for entry in content["frames"]:
            image = Path(entry["file_path"] if entry["file_path"].endswith(".png") else entry["file_path"] + ".png")
            (folder / image).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(DEMO_DATA / image, folder / image)
        (folder / f"transforms_{name}.json").write_text(json.dumps(content))
    return folder


@dataclass(frozen=True)
class KillPoint:
    """Operation on files of the run before which a process kills itself.

    Attributes:
        operation: number of the operation, 0 for none.
        counted: file for the number of operations; "" for none.
    """

    operation: int = 0
    counted: str = ""


def work(dataset: str, run: str, resume: bool, kill_point: KillPoint, overwrite: bool = False, output: str = "") -> None:
    """Run the job from its command line and end the process with its exit status.

    Args:
        dataset: folder of the photographs.
        run: run folder.
        resume: True to resume the run.
        kill_point: operation before which the process kills itself.
        overwrite: True to replace an existing run.
        output: file for the job's messages; "" for RUN.txt.
    """
    redirect_output(Path(output or f"{run}.txt"))
    from irgspp.core.cli.main import main
    from irgspp.core.stages.first import trainer

    trainer.CHECKPOINT_SECONDS = CHECKPOINT_SECONDS
    operations = watch_operations(Path(run), kill_point)
    words = [word for text in SETTINGS for word in ("--set", text)]
    given = [] if resume else ["--preset", "draft", *words]
    status = main(["reconstruct", dataset, "-o", run, *given, *(["--resume"] if resume else []), *(["--overwrite"] if overwrite else [])])
    if kill_point.counted:
        Path(kill_point.counted).write_text(str(len(operations)), encoding="utf-8")
    sys.stdout.flush()
    os._exit(status)


def redirect_output(file: Path) -> None:
    """Write everything that this process says to a file."""
    with open(file, "w", encoding="utf-8") as said:
        for stream in (1, 2):
            os.dup2(said.fileno(), stream)


def watch_operations(run: Path, kill_point: KillPoint) -> list[str]:
    """Count the operations on a folder's files, and kill the process before one of them.

    Args:
        run: folder of the run or the dataset.
        kill_point: operation before which the process kills itself.

    Returns:
        The operations so far; it grows.
    """
    operations: list[str] = []

    def look(event: str, arguments: tuple[Any, ...]) -> None:
        """Count an operation."""
        if event not in EVENTS or not arguments or not isinstance(arguments[0], (str, bytes, os.PathLike)):
            return
        path = os.fsdecode(arguments[0])
        writes = event != "open" or (isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"))
        if not writes or not path.startswith(str(run)) or path.endswith(LOGS):
            return
        operations.append(f"{event} {path}")
        if len(operations) == kill_point.operation:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(look)
    return operations


class JobStarter:
    """Starter of jobs that copies a process in which the libraries are loaded already."""

    def __init__(self) -> None:
        name = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
        self._context = multiprocessing.get_context(name)
        if name == "forkserver":
            self._context.set_forkserver_preload(["irgspp.core.pipeline", "irgspp.core.cli.main", "faulting.tiny"])

    def start(self, function: Callable[..., None], *arguments: Any) -> BaseProcess:
        """Start a process.

        Args:
            function: function to call.
            *arguments: arguments of the function.
        """
        process = self._context.Process(target=function, args=arguments)  # pyright: ignore[reportAttributeAccessIssue]
        process.start()
        return process

    def run(self, function: Callable[..., None], *arguments: Any) -> int:
        """Run a process to its end and return its exit status, negative where a signal ended it.

        Args:
            function: function to call.
            *arguments: arguments of the function.
        """
        process = self.start(function, *arguments)
        process.join()
        assert process.exitcode is not None
        return process.exitcode


@functools.cache
def reference_run() -> tuple[Path, Path, int]:
    """Return photographs, the run folder of an undisturbed job, and its number of operations on files; made once in a process."""
    folder = Path(tempfile.mkdtemp(prefix="irgspp-faults-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    data, run, count = write_dataset(folder / "photographs"), folder / "reference", folder / "operations"
    status = JobStarter().run(work, str(data), str(run), False, KillPoint(counted=str(count)))
    if status:
        raise RuntimeError(f"the undisturbed job ended with status {status}: {user_lines(Path(f'{run}.txt'))}")
    return data, run, int(count.read_text("utf-8"))


def kill_after(process: BaseProcess, seconds: float) -> bool:
    """Kill a process after some time.

    Args:
        process: process to kill.
        seconds: seconds from now.

    Returns:
        False where it had ended before.
    """
    process.join(seconds)
    if process.exitcode is not None:
        return False
    process.kill()
    process.join()
    return True


def differing_files(run: Path, other: Path) -> list[str]:
    """Return the names of the files that differ in any bit between two runs, or are in one alone.

    Args:
        run: run folder.
        other: run folder.
    """
    found = {p.relative_to(f).as_posix() for f in (run, other) for p in f.rglob("*") if p.is_file()}
    names = [n for n in sorted(found) if not n.endswith((*VARYING, *LOGS)) and not n.startswith("previews/") and n != ".lock"]
    return [n for n in names if not (run / n).is_file() or not (other / n).is_file() or (run / n).read_bytes() != (other / n).read_bytes()]


def phase_of(run: Path) -> str:
    """Return the last phase of a run by its events."""
    return next((str(event["phase"]) for event in reversed(_events(run)) if event.get("phase")), "read")


def phase_seconds(run: Path) -> list[tuple[str, float]]:
    """Return the phases of a finished run in order, with the seconds until the next one begins."""
    begun = [(event["phase"], event["time"]) for event in _events(run) if event.get("step") == 0]
    ends = [time for _, time in begun[1:]] + [_events(run)[-1]["time"]]
    return [("read", 0.3), *((name, end - time) for (name, time), end in zip(begun, ends, strict=True))]


def _events(run: Path) -> list[dict[str, Any]]:
    """Return the events of a run."""
    try:
        lines = (run / "events.jsonl").read_text("utf-8").splitlines()
    except OSError:
        return []
    return [json.loads(line) for line in lines if line.endswith("}")]  # a killed process may have left half a line


def user_lines(file: Path) -> list[str]:
    """Return the lines of a job's output that are meant for the user."""
    return [line for line in file.read_text("utf-8").splitlines() if line.startswith(("irgspp: ", "Traceback"))]
