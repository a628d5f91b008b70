# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a warm worker takes requests and puts images: the files of a session folder, which `serve_command` describes."""

from __future__ import annotations

import io
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import IrgsppError
from ...io.atomic import replace
from ...scene.camera import Camera
from ..sample_counts import sample_counts
from .loaded_run import LoadedRun, Request
from .request import read_request

IDLE = 0.01  # seconds between looks for requests
NOTE = 0.2  # seconds between notes on how much is done


class Stopped(Exception):
    """The image in work is not wanted any more."""


@dataclass
class Task:
    """A request in work."""

    channel: str
    number: int
    request: Request
    passes: list[tuple[Camera, str | int]]
    made: int = 0
    weights: list[float] = field(default_factory=list)

    def share(self, of_pass: float) -> float:
        """How much of the work is done, with `of_pass` of the current pass."""
        return (sum(self.weights[: self.made]) + of_pass * self.weights[self.made]) / sum(self.weights)


class RequestServer:
    """Takes requests from the session folder and puts answers there."""

    def __init__(self, session: Path, ended: Callable[[], bool]) -> None:
        self._session, self._ended = session, ended
        self._seen: dict[str, tuple[int, int]] = {}  # channel -> time and size of the request file last read
        self._tasks: dict[str, Task] = {}
        self._now: Task | None = None
        self._looked = self._noted = 0.0

    def work(self, run: LoadedRun) -> None:
        """Pass by pass, those first that have shown least, until the end."""
        while not self._ended():
            self._collect()
            if not self._tasks:
                time.sleep(IDLE)
                continue
            task = min(self._tasks.values(), key=lambda task: task.made)  # of equal ones the oldest
            self._now = task
            try:
                self._advance(run, task)
            except Stopped:
                pass  # _collect has put the newer request in its place
            except IrgsppError as error:
                self._fail(task.channel, task.number, str(error))
            except Exception as error:  # one bad request must not end the worker; the asker is told
                self._fail(task.channel, task.number, f"{type(error).__name__}: {' '.join(str(error).split())}")

    def tick(self, share: float) -> None:
        """Between chunks of rays: stop where something newer is wanted, and note the progress. Raises Stopped."""
        task, now = self._now, time.monotonic()
        if task is None or now - self._looked < IDLE:
            return
        self._looked = now
        if self._ended():
            raise Stopped
        self._collect()
        if self._tasks.get(task.channel) is not task:
            raise Stopped
        if now - self._noted > NOTE:
            self._noted = now
            self._answer(task, None, task.share(share))

    def _advance(self, run: LoadedRun, task: Task) -> None:
        image = run.image(task.request, *task.passes[task.made])
        self._collect()
        if self._tasks.get(task.channel) is not task:
            return
        name = f"{task.channel}-{task.number}-{task.made}.npy"
        _write_array(self._session / name, image)
        share = task.share(1.0)
        task.made += 1
        self._answer(task, name, share)
        self._tidy(task.channel, name)
        if task.made == len(task.passes):
            del self._tasks[task.channel]

    def _collect(self) -> None:
        """Read the request files that changed."""
        for channel, path in self._requests():
            try:
                about = path.stat()
                stamp = (about.st_mtime_ns, about.st_size)
                if self._seen.get(channel) == stamp:
                    continue
                values = json.loads(path.read_text("utf-8"))
            except OSError:
                continue  # just being replaced; it is there at the next look
            except ValueError as error:
                self._seen[channel] = stamp
                self._fail(channel, -1, f"{path}: is no JSON ({error})")
                continue
            self._seen[channel] = stamp
            self._take(channel, values)

    def _requests(self) -> Iterator[tuple[str, Path]]:
        try:
            names = os.listdir(self._session)
        except OSError:
            return  # the folder is gone, which ends the work
        for name in sorted(names):
            if name.startswith("request-") and name.endswith(".json"):
                yield name[len("request-") : -len(".json")], self._session / name

    def _take(self, channel: str, values: Any) -> None:
        self._tasks.pop(channel, None)
        number = values.get("number", -1) if isinstance(values, dict) else -1
        if isinstance(values, dict) and values.get("cancel"):
            return
        try:
            request = read_request(values, self._session)
        except IrgsppError as error:
            self._fail(channel, number, str(error))
            return
        passes = request.passes()
        weights = [float(camera.width * camera.height * _rays(samples)) for camera, samples in passes]
        self._tasks[channel] = Task(channel, number, request, passes, weights=weights)

    def _answer(self, task: Task, image: str | None, share: float) -> None:
        """A note of progress names the last image there is."""
        shown = image or (f"{task.channel}-{task.number}-{task.made - 1}.npy" if task.made else None)
        about = {"pass": task.made, "passes": len(task.passes), "share": round(share, 4), "picture": shown}
        done = task.made == len(task.passes)
        self._put(task.channel, {"number": task.number, **about, "done": done, "error": None})

    def _fail(self, channel: str, number: int, text: str) -> None:
        self._tasks.pop(channel, None)
        about = {"pass": 0, "passes": 0, "share": 0.0, "picture": None}
        self._put(channel, {"number": number, **about, "done": True, "error": text})

    def _put(self, channel: str, answer: dict[str, Any]) -> None:
        if self._session.is_dir():
            write_json(self._session / f"answer-{channel}.json", answer)

    def _tidy(self, channel: str, latest: str) -> None:
        """Remove images but the latest two: the asker may just be reading the one before."""
        images = [p for p in self._session.glob(f"{channel}-*.npy") if p.name != latest]
        for old in sorted(images, key=lambda p: p.stat().st_mtime_ns)[:-1]:
            with suppress(OSError):  # Windows: being read; the next tidying gets it
                old.unlink()


def _rays(samples: str | int) -> int:
    return sum(sample_counts(samples, glossy=False))


def write_json(path: Path, values: dict[str, Any]) -> None:
    _write(path, json.dumps(values).encode())


def _write_array(path: Path, values: np.ndarray) -> None:
    data = io.BytesIO()
    np.save(data, np.ascontiguousarray(values, np.float32))
    _write(path, data.getvalue())


def _write(path: Path, data: bytes) -> None:
    """Whole, but not through to the disk: nobody needs it after a crash."""
    partial = path.with_name(f".{path.name}.part")
    partial.write_bytes(data)
    replace(partial, path)
