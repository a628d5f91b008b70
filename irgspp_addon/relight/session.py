# SPDX-License-Identifier: GPL-3.0-or-later
"""Client of the relighting workers (`irgspp serve`), one per run: requests and images are files, so that Blender never waits."""

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
from ...core.scene.lamps import Lamp, lamp_records
from ..engine.child import detached
from ..engine.process import engine_command, engine_environment, require_engine

STATE = ("gaussians.ply", "mesh.ply", "environment.exr", "reconstruction.json")  # files that a worker loads
OPTIONS = ("samples", "denoise", "backend", "albedo_scale", "backdrop", "progressive", "ground")  # of requests, sent as they are
LENS = ("width", "height", "fx", "fy", "cx", "cy")
PATIENCE = 180.0  # seconds that a worker may take to get ready


@dataclass(frozen=True, eq=False)
class RelightRequest:
    """Request for an image.

    Attributes:
        camera: camera in the run's frame.
        light: environment map in the run's frame; None for the recovered light.
        lamps: lamps in the run's frame.
        samples: light samples per pixel, or the name of a setting such as "hq".
        denoise: True to denoise the image.
        backend: "mesh" or "gaussian", the geometry that secondary rays are traced on.
        albedo_scale: RGB factors for the albedo.
        backdrop: True to show the light behind the object, False for a transparent background.
        progressive: True to receive coarse images before the finished one.
        ground: plane in the run's frame that receives the object's shadow, unit normal and offset, or None.
    """

    camera: Camera
    light: EnvironmentMap | None
    lamps: tuple[Lamp, ...] = ()
    samples: int | str = 32
    denoise: bool = True
    backend: str = "mesh"
    albedo_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    backdrop: bool = False
    progressive: bool = True
    ground: tuple[float, float, float, float] | None = None

    def key(self) -> tuple:
        """Return a key that is equal for requests of the same image."""
        c, light = self.camera, self.light
        view = (c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.to_world.tobytes())
        lighting = None if light is None else (id(light.texels), light.turn.tobytes(), light.strength)
        return (view, lighting, self.lamps, *(getattr(self, name) for name in OPTIONS))


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer of the worker to a request.

    Attributes:
        number: number of the request.
        image: latest image, (H, W, 4) linear premultiplied RGBA, top row first, or None.
        fraction: fraction of the work done, 0..1.
        done: True for the finished image.
    """

    number: int
    image: np.ndarray | None
    fraction: float
    done: bool


class Session:
    """Connection to one worker process that has loaded one run; the constructor raises InputError if no engine works."""

    def __init__(self, run: Path) -> None:
        require_engine()
        self.run, self.stamp = run, stamp(run)
        self._folder = Path(tempfile.mkdtemp(prefix="irgspp-relight-"))
        self._numbers: dict[str, int] = {}
        self._last_answers: dict[str, str] = {}  # channel -> text of the answer read last
        self._light_count = 0
        self._lights: dict[str, np.ndarray] = {}  # file -> texels, a reference that keeps their id() unique
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
        """True when the run is loaded; requests can be sent before."""
        return (self._folder / "ready.json").is_file()

    @property
    def alive(self) -> bool:
        """True while the worker runs."""
        return self._worker.poll() is None

    def send(self, channel: str, request: RelightRequest) -> int:
        """Send a request, which replaces the channel's earlier one.

        Args:
            channel: name of the channel.
            request: requested image.

        Returns:
            Number of the request.

        Raises:
            IrgsppError: if the worker has stopped or the request can't be written.
        """
        light, sent = request.light, None
        if light is not None:
            sent = {"map": self._light_file(light.texels), "turn": light.turn.reshape(-1).tolist(), "strength": float(light.strength)}
        camera = {name: getattr(request.camera, name) for name in LENS} | {"to_world": request.camera.to_world.tolist()}
        values = {name: getattr(request, name) for name in OPTIONS}
        return self._write(channel, {"camera": camera, "light": sent, "lamps": lamp_records(request.lamps), **values})

    def cancel(self, channel: str) -> None:
        """Cancel the channel's request."""
        if self.alive and channel in self._numbers:
            self._write(channel, {"cancel": True})

    def poll(self, channel: str) -> Answer | None:
        """Return the new answer to the channel's latest request, or None; raise IrgsppError with the worker's message if it failed."""
        values = self._read(channel)
        if values is None:
            if not self.alive:
                raise IrgsppError(f"the engine stopped: {self.last_log_line()}")
            return None
        if values["error"]:
            raise IrgsppError(values["error"])
        image = None
        if values["picture"]:
            try:
                image = np.load(self._folder / values["picture"], allow_pickle=False)
            except (OSError, ValueError):
                return None  # a newer image has just replaced it
        return Answer(values["number"], image, values["share"], values["done"])

    def wait(
        self,
        channel: str,
        request: RelightRequest,
        show: Callable[[Answer], None] = lambda answer: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> np.ndarray:
        """Send a request and wait for the finished image.

        Args:
            channel: name of the channel.
            request: requested image.
            show: function called with each answer.
            stop: function that returns True to cancel.

        Returns:
            (H, W, 4) linear premultiplied RGBA, top row first.

        Raises:
            Cancelled: if `stop` returned True.
            IrgsppError: if the worker fails or does not get ready in time.
        """
        self.send(channel, request)
        began = time.monotonic()
        while True:
            answer = self.poll(channel)
            if answer is not None:
                show(answer)
                if answer.done and answer.image is not None:
                    return answer.image
            if stop():
                self.cancel(channel)
                raise Cancelled("the image was cancelled")
            if not self.ready and time.monotonic() - began > PATIENCE:
                raise IrgsppError(f"the engine was not ready within {PATIENCE:.0f} seconds: {self.last_log_line()}")
            time.sleep(0.01)

    def close(self) -> None:
        """End the worker and delete its files."""
        if self._worker.stdin is not None:
            self._worker.stdin.close()  # the worker ends at the end of its stdin
        try:
            self._worker.wait(3)
        except subprocess.TimeoutExpired:
            self._worker.kill()
            self._worker.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    def last_log_line(self) -> str:
        """Return the last line of the worker's log."""
        lines = self._log.read_text(encoding="utf-8", errors="replace").strip().splitlines() if self._log.is_file() else []
        return lines[-1].removeprefix("irgspp: ") if lines else "its log is empty"

    def _read(self, channel: str) -> dict[str, Any] | None:
        """Return the answer to the channel's latest request, or None if there is none or it was read before."""
        try:
            text = (self._folder / f"answer-{channel}.json").read_text("utf-8")
            values = json.loads(text)
        except (OSError, ValueError):
            return None  # not written yet, or just being replaced
        if values["number"] != self._numbers.get(channel) or text == self._last_answers.get(channel):
            return None
        self._last_answers[channel] = text
        return values

    def _write(self, channel: str, values: dict[str, Any]) -> int:
        """Write a request file and return the request's number."""
        if not self.alive:
            raise IrgsppError(f"the engine stopped: {self.last_log_line()}")
        number = self._numbers[channel] = self._numbers.get(channel, 0) + 1
        partial = self._folder / f".request-{channel}.part"
        try:
            partial.write_text(json.dumps({"number": number, **values}), encoding="utf-8")
            replace(partial, self._folder / f"request-{channel}.json")
        except OSError as error:
            raise IrgsppError(f"{self._folder}: can't be written ({error.strerror})") from error
        return number

    def _light_file(self, texels: np.ndarray) -> str:
        """Return the name of the file of an environment map (H, W, 3), written once; the last few files stay for the worker to read."""
        for name, written in self._lights.items():
            if written is texels:
                return name
        self._light_count += 1  # the worker identifies a light by its file's name, so no name is used twice
        name = f"light-{self._light_count}.npy"
        partial = self._folder / f".{name}.part.npy"
        try:
            np.save(partial, texels)
            os.replace(partial, self._folder / name)
        except OSError as error:
            raise IrgsppError(f"{self._folder}: the light can't be written ({error.strerror})") from error
        for old in list(self._lights)[: max(0, len(self._lights) - 3)]:
            del self._lights[old]
            with suppress(OSError):  # Windows: being read; it is deleted with the folder
                (self._folder / old).unlink()
        self._lights[name] = texels
        return name


_sessions: dict[Path, Session] = {}


def session_of(run: Path) -> Session:
    """Return the session of a run's worker; a new worker is started if there is none, it has stopped, or the run has changed.

    Raises:
        InputError: if no engine works.
        IrgsppError: if the worker can't be started.
    """
    run = run.resolve()
    session = _sessions.get(run)
    if session is not None and session.alive and session.stamp == stamp(run):
        return session
    if session is not None:
        _sessions.pop(run).close()
    _sessions[run] = Session(run)
    return _sessions[run]


def stamp(run: Path) -> tuple:
    """Return the modification times of the run's files, which change when its result does."""
    return tuple((run / name).stat().st_mtime_ns if (run / name).is_file() else 0 for name in STATE)


def close_all() -> None:
    """End all workers and delete their files."""
    while _sessions:
        _sessions.popitem()[1].close()


def register() -> None:
    """End all workers when Blender ends."""
    atexit.register(close_all)


def unregister() -> None:
    """End all workers when the extension is disabled."""
    atexit.unregister(close_all)
    close_all()
