# SPDX-License-Identifier: GPL-3.0-or-later
"""Warm workers (`irgspp serve`), one per run: wishes go there and images come back as files, and Blender never waits."""

from __future__ import annotations

import atexit
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import Cancelled, IrgsppError
from ...core.io.atomic import replace
from ...core.scene.camera import Camera
from ...core.scene.environment_map import EnvironmentMap
from ..engine.child import detached
from ..engine.process import engine_command, engine_environment, require_engine

STATE = ("gaussians.ply", "mesh.ply", "environment.exr", "reconstruction.json")  # what a worker has loaded
PATIENCE = 180.0  # seconds that a worker may take to get ready


@dataclass(frozen=True, eq=False)
class Wish:
    """An image that is wanted; camera and light are in the run's frame. light: None is the recovered one."""

    camera: Camera
    light: EnvironmentMap | None
    samples: int | str = 32
    denoise: bool = True
    backend: str = "mesh"
    albedo_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    backdrop: bool = False
    progressive: bool = True

    def key(self) -> tuple:
        """Equal for wishes of the same image."""
        c, light = self.camera, self.light
        lens = (c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.to_world.tobytes())
        shine = None if light is None else (id(light.texels), light.turn.tobytes(), light.strength)
        return (lens, shine, self.samples, self.denoise, self.backend, self.albedo_scale, self.backdrop, self.progressive)


@dataclass(frozen=True, eq=False)
class Answer:
    """What the worker says of a wish: the latest image (H, W, 4) linear premultiplied, top row first, or None; the share of work done."""

    number: int
    image: np.ndarray | None
    share: float
    done: bool


class Session:
    """One worker on one run. Raises InputError where the engine or the run is missing."""

    def __init__(self, run: Path) -> None:
        require_engine()
        self.run, self.stamp = run, stamp(run)
        self._folder = Path(tempfile.mkdtemp(prefix="irgspp-relight-"))
        self._numbers: dict[str, int] = {}
        self._shown: dict[str, str] = {}  # channel -> the answer read last
        self._written = 0
        self._lights: dict[str, np.ndarray] = {}  # file -> texels, which keeps their id
        self._log = self._folder / "log.txt"
        command = engine_command("serve", str(run), "--session", str(self._folder))
        try:
            with self._log.open("wb") as log:
                self._worker = subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=log, stderr=log, env=engine_environment(), **detached()
                )
        except OSError as error:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise IrgsppError(f"{command[0]}: the engine can't be started ({error.strerror})") from error

    @property
    def ready(self) -> bool:
        """True when the run is loaded; wishes may be made before."""
        return (self._folder / "ready.json").is_file()

    @property
    def alive(self) -> bool:
        """True while the worker runs."""
        return self._worker.poll() is None

    def ask(self, channel: str, wish: Wish) -> int:
        """Wish for an image in the place of the channel's earlier wish; its number."""
        light = None
        if wish.light is not None:
            turn = wish.light.turn.reshape(-1).tolist()
            light = {"map": self._keep(wish.light.texels), "turn": turn, "strength": float(wish.light.strength)}
        camera = {name: getattr(wish.camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
        values = {name: getattr(wish, name) for name in ("samples", "denoise", "backend", "albedo_scale", "backdrop", "progressive")}
        return self._put(channel, {"camera": {**camera, "to_world": wish.camera.to_world.tolist()}, "light": light, **values})

    def cancel(self, channel: str) -> None:
        """Nothing is wanted any more."""
        if self.alive and channel in self._numbers:
            self._put(channel, {"cancel": True})

    def look(self, channel: str) -> Answer | None:
        """What is new for the channel's latest wish, or None. Raises IrgsppError where the worker failed, in its words."""
        about = self._read(channel)
        if about is None:
            if not self.alive:
                raise IrgsppError(f"the engine stopped: {self.last_words()}")
            return None
        if about["error"]:
            raise IrgsppError(about["error"])
        image = None
        if about["picture"]:
            try:
                image = np.load(self._folder / about["picture"], allow_pickle=False)
            except (OSError, ValueError):
                return None  # a newer one has just replaced it
        return Answer(about["number"], image, about["share"], about["done"])

    def wait(
        self, channel: str, wish: Wish, show: Callable[[Answer], None] = lambda answer: None, stop: Callable[[], bool] = lambda: False
    ) -> np.ndarray:
        """The finished image, `show`ing what comes before. Raises Cancelled when `stop`, IrgsppError where it can't be had."""
        self.ask(channel, wish)
        began = time.monotonic()
        while True:
            answer = self.look(channel)
            if answer is not None:
                show(answer)
                if answer.done and answer.image is not None:
                    return answer.image
            if stop():
                self.cancel(channel)
                raise Cancelled("the image was cancelled")
            if not self.ready and time.monotonic() - began > PATIENCE:
                raise IrgsppError(f"the engine was not ready within {PATIENCE:.0f} seconds: {self.last_words()}")
            time.sleep(0.01)

    def close(self) -> None:
        """End the worker and leave no file."""
        if self._worker.stdin is not None:
            self._worker.stdin.close()  # which it takes for the end
        try:
            self._worker.wait(3)
        except subprocess.TimeoutExpired:
            self._worker.kill()
            self._worker.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    def last_words(self) -> str:
        """The last line that the worker printed."""
        try:
            lines = self._log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        except OSError:
            lines = []
        return lines[-1].removeprefix("irgspp: ") if lines else "it said nothing"

    def _read(self, channel: str) -> dict[str, Any] | None:
        """The answer to the channel's latest wish where it was not read before."""
        try:
            text = (self._folder / f"answer-{channel}.json").read_text("utf-8")
            about = json.loads(text)
        except (OSError, ValueError):
            return None  # not there, or just being replaced
        if about["number"] != self._numbers.get(channel) or text == self._shown.get(channel):
            return None
        self._shown[channel] = text
        return about

    def _put(self, channel: str, values: dict[str, Any]) -> int:
        if not self.alive:
            raise IrgsppError(f"the engine stopped: {self.last_words()}")
        number = self._numbers[channel] = self._numbers.get(channel, 0) + 1
        partial = self._folder / f".request-{channel}.part"
        try:
            partial.write_text(json.dumps({"number": number, **values}), encoding="utf-8")
            replace(partial, self._folder / f"request-{channel}.json")
        except OSError as error:
            raise IrgsppError(f"{self._folder}: can't be written ({error.strerror})") from error
        return number

    def _keep(self, texels: np.ndarray) -> str:
        """The file of a light, written once; of earlier ones a few stay, which the worker may still be reading."""
        for name, kept in self._lights.items():
            if kept is texels:
                return name
        self._written += 1  # a name stands for what it holds, so none is used twice
        name = f"light-{self._written}.npy"
        partial = self._folder / f".{name}.part.npy"
        try:
            np.save(partial, texels)
            os.replace(partial, self._folder / name)
        except OSError as error:
            raise IrgsppError(f"{self._folder}: the light can't be written ({error.strerror})") from error
        for old in list(self._lights)[: max(0, len(self._lights) - 3)]:
            del self._lights[old]
            with suppress(OSError):  # Windows: being read; it goes with the folder
                (self._folder / old).unlink()
        self._lights[name] = texels
        return name


_sessions: dict[Path, Session] = {}


def session_of(run: Path) -> Session:
    """The warm worker of a run: the one there is, or a new one where that died or the run was made anew meanwhile."""
    run = run.resolve()
    session = _sessions.get(run)
    if session is not None and session.alive and session.stamp == stamp(run):
        return session
    if session is not None:
        _sessions.pop(run).close()
    _sessions[run] = Session(run)
    return _sessions[run]


def stamp(run: Path) -> tuple:
    """What changes when the run's result does."""
    return tuple((run / name).stat().st_mtime_ns if (run / name).is_file() else 0 for name in STATE)


def close_all() -> None:
    """End all workers."""
    while _sessions:
        _sessions.popitem()[1].close()


def register() -> None:
    """Workers end with Blender."""
    atexit.register(close_all)


def unregister() -> None:
    """And with the extension."""
    atexit.unregister(close_all)
    close_all()
