# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `irgspp serve`: a run kept warm, which answers requests for pictures through the files of a session folder.

    ready.json            written when the run is loaded: {"irgspp": version, "pid": ..., "gaussians": ...}
    request-CHANNEL.json  a request (`read_request`), replaced by the asker; its "number" grows, the newest wins, {"cancel": true} stops
    answer-CHANNEL.json   {"number", "pass", "passes", "share" (0..1 done), "picture" (a file or null), "done", "error" (a line or null)}
    CHANNEL-N-P.npy       the picture of request N, pass P: (H, W, 4) float32 linear premultiplied, top row first
    stop                  ends the worker; so does the end of its stdin, of its parent, or of the folder

All files appear whole. A channel is one asker: several may work side by side, first pictures go before refined ones.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .datasets.camera import Camera
from .errors import InputError, IrgsppError
from .terminal import Terminal

if TYPE_CHECKING:
    from .warm_run import LightSource, Request, WarmRun

IDLE = 0.01  # seconds between looks for requests
NOTE = 0.2  # seconds between notes on how much is done
PIXELS = 1 << 28


class Stopped(Exception):
    """The picture in work is not wanted any more."""


def serve(args: argparse.Namespace, terminal: Terminal) -> int:
    """Answer requests until told to end."""
    session = args.session
    if not session.is_dir():
        raise InputError(session, "is not a folder", "make it before")
    ended = _when_to_end(session, terminal)
    from .warm_run import WarmRun

    desk = Desk(session, ended)
    run = WarmRun(args.run, desk.tick)
    run.warm_up()
    _write_json(session / "ready.json", {"irgspp": _version(), "pid": os.getpid(), "gaussians": run.reconstruction.gaussians.count})
    desk.work(run)
    return 0


def add_options(one: argparse.ArgumentParser) -> None:
    """What the command understands beside the run folder."""
    one.add_argument("--session", type=Path, required=True, metavar="DIR", help="folder for requests and pictures (core/serve_command.py)")


def _when_to_end(session: Path, terminal: Terminal) -> Callable[[], bool]:
    """True when the folder says so or is gone, stdin is closed, the parent died or Ctrl-C was pressed."""
    closed, parent = threading.Event(), os.getppid()

    def watch() -> None:
        try:
            while os.read(0, 1 << 16):  # not sys.stdin, whose lock would be held when the process ends
                continue
        except OSError:
            return  # there never was one
        closed.set()

    threading.Thread(target=watch, daemon=True, name="stdin").start()

    def ended() -> bool:
        orphan = sys.platform != "win32" and os.getppid() != parent
        return closed.is_set() or terminal.cancelled or orphan or (session / "stop").exists() or not session.is_dir()

    return ended


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


class Desk:
    """Takes requests from the session folder and puts answers there."""

    def __init__(self, session: Path, ended: Callable[[], bool]) -> None:
        self._session, self._ended = session, ended
        self._seen: dict[str, tuple[int, int]] = {}  # channel -> time and size of the request file last read
        self._tasks: dict[str, Task] = {}
        self._now: Task | None = None
        self._looked = self._noted = 0.0

    def work(self, run: WarmRun) -> None:
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

    def _advance(self, run: WarmRun, task: Task) -> None:
        picture = run.picture(task.request, *task.passes[task.made])
        self._collect()
        if self._tasks.get(task.channel) is not task:
            return
        name = f"{task.channel}-{task.number}-{task.made}.npy"
        _write_array(self._session / name, picture)
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

    def _answer(self, task: Task, picture: str | None, share: float) -> None:
        """A note of progress names the last picture there is."""
        shown = picture or (f"{task.channel}-{task.number}-{task.made - 1}.npy" if task.made else None)
        about = {"pass": task.made, "passes": len(task.passes), "share": round(share, 4), "picture": shown}
        done = task.made == len(task.passes)
        self._put(task.channel, {"number": task.number, **about, "done": done, "error": None})

    def _fail(self, channel: str, number: int, text: str) -> None:
        self._tasks.pop(channel, None)
        about = {"pass": 0, "passes": 0, "share": 0.0, "picture": None}
        self._put(channel, {"number": number, **about, "done": True, "error": text})

    def _put(self, channel: str, answer: dict[str, Any]) -> None:
        if self._session.is_dir():
            _write_json(self._session / f"answer-{channel}.json", answer)

    def _tidy(self, channel: str, latest: str) -> None:
        """Remove pictures but the latest two: the asker may just be reading the one before."""
        pictures = [p for p in self._session.glob(f"{channel}-*.npy") if p.name != latest]
        for old in sorted(pictures, key=lambda p: p.stat().st_mtime_ns)[:-1]:
            _delete(old)


def read_request(values: Any, session: Path) -> Request:
    """A request from its JSON: {"number", "camera": {width, height, fx, fy, cx, cy, to_world (4 x 4)}, "light": null or {"map": .npy in the
    session, "turn": 9 numbers, "strength"}, "backdrop", "samples", "denoise", "indirect", "backend", "albedo_scale": [r, g, b],
    "progressive"}. Raises InputError.
    """
    from .warm_run import Request

    try:
        camera = _camera(values["camera"])
        light = _light(values["light"], session) if values.get("light") else None
        scale = tuple(float(factor) for factor in values.get("albedo_scale", (1, 1, 1)))
        options = {name: bool(values[name]) for name in ("denoise", "indirect", "progressive", "backdrop") if name in values}
        samples, backend = values.get("samples", 32), values.get("backend", "mesh")
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("request", f"can't be understood ({error!r})") from error
    if not isinstance(samples, int | str):
        raise InputError("request", f"samples {samples}: neither a number nor a word")
    if backend not in ("mesh", "gaussian") or len(scale) != 3 or not all(0 <= factor < float("inf") for factor in scale):
        raise InputError("request", f"backend {backend}, albedo scale {scale}: not to be had")
    from .relight.samples import sample_counts

    sample_counts(samples, glossy=False)
    return Request(camera, light, samples=samples, backend=backend, albedo_scale=scale, **options)


def _camera(values: dict[str, Any]) -> Camera:
    to_world = np.array(values["to_world"], float)
    numbers = [float(values[name]) for name in ("fx", "fy", "cx", "cy")]
    width, height = int(values["width"]), int(values["height"])
    if to_world.shape != (4, 4) or not np.isfinite(to_world).all() or not np.isfinite(numbers).all():
        raise ValueError("camera: not finite, or to_world is not 4 x 4")
    if width < 1 or height < 1 or width * height > PIXELS or numbers[0] <= 0 or numbers[1] <= 0:
        raise ValueError(f"camera: a picture of {width} x {height} with focal lengths {numbers[:2]}")
    return Camera(width, height, numbers[0], numbers[1], numbers[2], numbers[3], to_world)


def _light(values: dict[str, Any], session: Path) -> LightSource:
    from .warm_run import LightSource

    turn, strength = tuple(float(x) for x in values["turn"]), float(values["strength"])
    rows = np.array(turn).reshape(3, 3)
    if not np.allclose(rows @ rows.T, np.eye(3), atol=1e-3) or not 0 <= strength < float("inf"):
        raise ValueError(f"light: turn {turn} is no rotation, or strength {strength} is none")
    return LightSource(session / Path(values["map"]).name, turn, strength)


def _rays(samples: str | int) -> int:
    from .relight.samples import sample_counts

    return sum(sample_counts(samples, glossy=False))


def _version() -> str:
    from .run_folder import versions

    return versions().get("irgspp", "")


def _write_json(path: Path, values: dict[str, Any]) -> None:
    _write(path, json.dumps(values).encode())


def _write_array(path: Path, values: np.ndarray) -> None:
    data = io.BytesIO()
    np.save(data, np.ascontiguousarray(values, np.float32))
    _write(path, data.getvalue())


def _write(path: Path, data: bytes) -> None:
    """Whole, but not through to the disk: nobody needs it after a crash. Windows refuses while the old file is being read."""
    partial = path.with_name(f".{path.name}.part")
    partial.write_bytes(data)
    for _ in range(100):
        try:
            return os.replace(partial, path)
        except PermissionError:
            time.sleep(0.002)
    os.replace(partial, path)


def _delete(path: Path) -> None:
    try:
        path.unlink()
    except OSError:
        return  # being read on Windows; the next tidying gets it
