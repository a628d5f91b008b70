# SPDX-License-Identifier: GPL-3.0-or-later
"""Server of image requests through the files of a session folder; `core/cli/serve.py` describes the protocol."""

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

POLL_SECONDS = 0.01  # between checks for new requests
PROGRESS_SECONDS = 0.2  # between progress reports


class Stopped(Exception):
    """Raised to abandon the current image: it was superseded or cancelled, or the server stops."""


@dataclass
class PendingRequest:
    """Request that is being rendered pass by pass.

    Attributes:
        channel: channel of the client.
        number: number of the request.
        request: the request.
        passes: cameras and samples of its images.
        finished: number of finished passes.
        weights: relative cost of each pass.
    """

    channel: str
    number: int
    request: Request
    passes: list[tuple[Camera, str | int]]
    finished: int = 0
    weights: list[float] = field(default_factory=list)

    def fraction(self, of_pass: float) -> float:
        """Return the finished fraction of all passes, where `of_pass` of the current pass is finished; both in 0..1."""
        return (sum(self.weights[: self.finished]) + of_pass * self.weights[self.finished]) / sum(self.weights)


class RequestServer:
    """Server that reads requests from the session folder and writes answers there.

    Args:
        session: session folder.
        should_stop: returns True when the server should stop.
    """

    def __init__(self, session: Path, should_stop: Callable[[], bool]) -> None:
        self._session, self._should_stop = session, should_stop
        self._read_stamps: dict[str, tuple[int, int]] = {}  # channel -> modification time and size of the request file last read
        self._pending: dict[str, PendingRequest] = {}
        self._current: PendingRequest | None = None
        self._polled = self._reported = 0.0

    def work(self, run: LoadedRun) -> None:
        """Render pass by pass, requests with the fewest finished passes first, until the server should stop."""
        while not self._should_stop():
            self._collect()
            if not self._pending:
                time.sleep(POLL_SECONDS)
                continue
            pending = min(self._pending.values(), key=lambda pending: pending.finished)  # the oldest of equal ones
            self._current = pending
            try:
                self._advance(run, pending)
            except Stopped:
                pass  # _collect has replaced the request by a newer one, or the server stops
            except IrgsppError as error:
                self._fail(pending.channel, pending.number, str(error))
            except Exception as error:  # one bad request must not end the server; the client receives the message
                self._fail(pending.channel, pending.number, f"{type(error).__name__}: {' '.join(str(error).split())}")

    def tick(self, fraction: float) -> None:
        """Check for new requests and report progress, between batches of rays.

        Args:
            fraction: finished fraction of the current pass in 0..1.

        Raises:
            Stopped: when the current request was superseded or cancelled, or the server should stop.
        """
        pending, now = self._current, time.monotonic()
        if pending is None or now - self._polled < POLL_SECONDS:
            return
        self._polled = now
        if self._should_stop():
            raise Stopped
        self._collect()
        if self._pending.get(pending.channel) is not pending:
            raise Stopped
        if now - self._reported > PROGRESS_SECONDS:
            self._reported = now
            self._answer(pending, None, pending.fraction(fraction))

    def _advance(self, run: LoadedRun, pending: PendingRequest) -> None:
        """Render the next pass of a request and answer."""
        image = run.image(pending.request, *pending.passes[pending.finished])
        self._collect()
        if self._pending.get(pending.channel) is not pending:
            return
        name = f"{pending.channel}-{pending.number}-{pending.finished}.npy"
        _write_array(self._session / name, image)
        fraction = pending.fraction(1.0)
        pending.finished += 1
        self._answer(pending, name, fraction)
        self._remove_old_images(pending.channel, name)
        if pending.finished == len(pending.passes):
            del self._pending[pending.channel]

    def _collect(self) -> None:
        """Read the request files that have changed."""
        for channel, path in self._requests():
            try:
                status = path.stat()
                stamp = (status.st_mtime_ns, status.st_size)
                if self._read_stamps.get(channel) == stamp:
                    continue
                values = json.loads(path.read_text("utf-8"))
            except OSError:
                continue  # just being replaced; the next check reads it
            except ValueError as error:
                self._read_stamps[channel] = stamp
                self._fail(channel, -1, f"{path}: is not valid JSON ({error})")
                continue
            self._read_stamps[channel] = stamp
            self._accept(channel, values)

    def _requests(self) -> Iterator[tuple[str, Path]]:
        """Yield channels and paths of the request files."""
        try:
            names = os.listdir(self._session)
        except OSError:
            return  # the folder was deleted, which stops the server
        for name in sorted(names):
            if name.startswith("request-") and name.endswith(".json"):
                yield name[len("request-") : -len(".json")], self._session / name

    def _accept(self, channel: str, values: Any) -> None:
        """Replace the pending request of a channel by a new one, or cancel it."""
        self._pending.pop(channel, None)
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
        self._pending[channel] = PendingRequest(channel, number, request, passes, weights=weights)

    def _answer(self, pending: PendingRequest, image: str | None, fraction: float) -> None:
        """Write an answer; without a new image it names the latest one."""
        latest = image or (f"{pending.channel}-{pending.number}-{pending.finished - 1}.npy" if pending.finished else None)
        state = {"pass": pending.finished, "passes": len(pending.passes), "share": round(fraction, 4), "picture": latest}
        done = pending.finished == len(pending.passes)
        self._put(pending.channel, {"number": pending.number, **state, "done": done, "error": None})

    def _fail(self, channel: str, number: int, text: str) -> None:
        """Answer with an error message."""
        self._pending.pop(channel, None)
        state = {"pass": 0, "passes": 0, "share": 0.0, "picture": None}
        self._put(channel, {"number": number, **state, "done": True, "error": text})

    def _put(self, channel: str, answer: dict[str, Any]) -> None:
        """Write the answer file of a channel, unless the session folder was deleted."""
        if self._session.is_dir():
            write_json(self._session / f"answer-{channel}.json", answer)

    def _remove_old_images(self, channel: str, latest: str) -> None:
        """Remove the images of a channel except the latest two: the client may still be reading the second latest."""
        images = [p for p in self._session.glob(f"{channel}-*.npy") if p.name != latest]
        for old in sorted(images, key=lambda p: p.stat().st_mtime_ns)[:-1]:
            with suppress(OSError):  # Windows: the client is reading it; it is removed the next time
                old.unlink()


def _rays(samples: str | int) -> int:
    """Return the number of samples per pixel."""
    return sum(sample_counts(samples, metallic=False))


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write a JSON file atomically.

    Args:
        path: file to write.
        values: content.
    """
    _write(path, json.dumps(values).encode())


def _write_array(path: Path, values: np.ndarray) -> None:
    """Write an array as a float32 .npy file atomically."""
    data = io.BytesIO()
    np.save(data, np.ascontiguousarray(values, np.float32))
    _write(path, data.getvalue())


def _write(path: Path, data: bytes) -> None:
    """Replace a file atomically, but without flushing to the disk: it has no use after a crash."""
    partial = path.with_name(f".{path.name}.part")
    partial.write_bytes(data)
    replace(partial, path)
