# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that follow the scene: when camera, World or object change, a new one is wished for, and shown as it gets better.

One timer looks after all of them while there are any; handlers only note that something changed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent  # pyright: ignore[reportMissingImports]

from ...core.errors import InputError, IrgsppError
from ...core.scene.camera import Camera
from ...core.scene.environment_map import EnvironmentMap
from ..importer.run_frame import Frame, albedo_scale, chosen_run, frame_of, run_object
from ..windows import redraw
from ..world.plain_world import plain_light
from ..world.world_light import WorldBake, ask_world, forget
from .session import Session, Wish, session_of

BEAT = 0.04  # seconds
STILL = 0.3  # seconds without change before a World is rendered

Eye = Callable[[bpy.types.Scene, Frame, int, int], Camera]  # may raise InputError


class WorldFollower:
    """The light of a scene's World as it is now, as soon as it is known."""

    def __init__(self) -> None:
        self._light: EnvironmentMap | None = None
        self._bake: WorldBake | None = None
        self._seen = -1  # changes, when looked last
        self.error: IrgsppError | None = None

    def light(self, scene: bpy.types.Scene) -> EnvironmentMap | None:
        """The light, the former one while a new one is rendered; None before the first. Raises IrgsppError where it can't be had."""
        if self._seen != _changes.count:
            self._look(scene)
        elif self._bake is not None:
            self._finish()
        if self.error is not None:
            raise self.error
        return self._light

    @property
    def busy(self) -> bool:
        """True while a World is rendered."""
        return self._bake is not None

    def close(self) -> None:
        """Stop what is being rendered."""
        if self._bake is not None:
            self._bake.close()
            self._bake = None

    def _look(self, scene: bpy.types.Scene) -> None:
        seen, world, frame = _changes.count, scene.world, scene.frame_current
        try:
            light = plain_light(world)
            if light is None and self._light is not None and _changes.since() < STILL:
                return  # a person is still dragging a slider: look again at the next beat
            self._seen, self.error = seen, None
            if light is None and self._bake is not None and self._bake.shows(world, frame):
                return
            self.close()
            asked = light or ask_world(world, frame)
        except IrgsppError as error:
            self._seen, self.error = seen, error
            return
        if isinstance(asked, EnvironmentMap):
            self._light = asked
        else:
            self._bake = asked

    def _finish(self) -> None:
        assert self._bake is not None
        try:
            light = self._bake.poll()
        except IrgsppError as error:
            self.error, light = error, None
        if light is not None:
            self._light = light
        if light is not None or self.error is not None:
            self.close()


@dataclass
class _Changes:
    """How often the scene has changed, and when it did last."""

    count: int = 0
    when: float = 0.0

    def note(self) -> None:
        self.count, self.when = self.count + 1, time.monotonic()

    def since(self) -> float:
        return time.monotonic() - self.when


_changes = _Changes()


class Follower:
    """One image that is kept up to date.

    Args:
        channel: its name for the worker. scene: whose World and object. run: the folder; None: the one chosen now.
        eye: where it is seen from, for an image of so many pixels. size: (width, height) now.
        how: samples, denoise, backend, use_world, backdrop now. show: gets images. wanted: False when nobody looks any more.
    """

    def __init__(
        self,
        channel: str,
        scene: bpy.types.Scene,
        run: Path | None,
        eye: Eye,
        size: Callable[[bpy.types.Scene], tuple[int, int]],
        how: Callable[[bpy.types.Scene], dict[str, Any]],
        show: Callable[[np.ndarray, tuple[int, int], bool], None],
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        self.channel, self.run, self._scene = channel, run, scene.name
        self._eye, self._size, self._how, self._show, self._wanted_still = eye, size, how, show, wanted
        self._has_object = run is None or run_object(scene, run) is not None
        self._world = WorldFollower()
        self._session: Session | None = None
        self._asked: tuple | None = None
        self._wanted = (1, 1)
        self.message, self.share, self.ended, self.done, self.failed = "Starting the engine", 0.0, False, False, False
        self._ended_at = 0

    def tick(self) -> None:
        """Look at the scene and the worker once; takes no time to speak of. Troubles become the message."""
        if not self._wanted_still():
            self.ended = True
            return
        before = self.message
        try:
            self._follow()
            self._take()
            self.failed = False
        except IrgsppError as error:
            self.message, self.failed = str(error), True
            if self._session is not None and not self._session.alive:
                self.ended = True  # a worker that dies at once must not be started again and again
        if self.message != before:
            redraw("VIEW_3D", "PROPERTIES")

    def finish(self) -> None:
        """Wait for the finished image, as scripts do. Raises IrgsppError where it can't be had."""
        while not self.done:
            self.tick()
            if self.failed or self.ended:
                raise IrgsppError(self.message)
            time.sleep(0.01)

    def close(self) -> None:
        """Stop: nothing is wanted any more."""
        self.ended, self._ended_at = True, _changes.count
        self._world.close()
        if self._session is not None and self._session.alive:
            self._session.cancel(self.channel)

    @property
    def stale(self) -> bool:
        """True where it has ended, and something has changed since."""
        return self.ended and self._ended_at != _changes.count

    def _follow(self) -> None:
        scene = bpy.data.scenes.get(self._scene)
        if scene is None:
            self.ended = True
            raise InputError(self._scene, "the scene was removed", "the preview has ended")
        run = self.run or chosen_run(scene)
        thing = run_object(scene, run)
        if thing is None and self._has_object:
            self.ended = self.run is not None
            raise InputError(run.name, "its object was deleted from the scene, so there is nothing to relight", "import the run again")
        self._session = session_of(run)
        how = self._how(scene)
        use_world = how.pop("use_world")
        light = self._world.light(scene) if use_world else None
        if use_world and light is None:
            self.message = "Rendering the World"
            return
        frame = frame_of(thing)
        width, height = self._size(scene)
        camera = frame.camera(self._eye(scene, frame, width, height))
        wish = Wish(camera, light.turned(frame.rotation) if light else None, albedo_scale=albedo_scale(thing), **how)
        if wish.key() != self._asked:
            self._session.ask(self.channel, wish)
            self._asked, self._wanted, self.done, self.share = wish.key(), (width, height), False, 0.0

    def _take(self) -> None:
        if self._session is None or self._asked is None:
            return
        answer = self._session.look(self.channel)
        if answer is None:
            if not self._session.ready:
                self.message = "Starting the engine"
            return
        self.share, self.done = answer.share, answer.done
        self.message = "Done" if answer.done else f"Refining, {answer.share:.0%}"
        if answer.image is not None:
            self._show(answer.image, self._wanted, answer.done)


_followers: dict[str, Follower] = {}


def follow(follower: Follower) -> None:
    """Look after a follower, in the place of the one of its channel."""
    stop(follower.channel)
    _followers[follower.channel] = follower
    if not bpy.app.background and not bpy.app.timers.is_registered(_pulse):
        bpy.app.timers.register(_pulse)


def follower_of(channel: str) -> Follower | None:
    """The follower of a channel, also one that has just ended."""
    return _followers.get(channel)


def stop(channel: str) -> None:
    """Stop a channel's follower, if any."""
    follower = _followers.pop(channel, None)
    if follower is not None:
        follower.close()


def beat() -> bool:
    """One look at all followers; False when none is left to look after. The timer's work, for scripts to call."""
    for follower in list(_followers.values()):
        if not follower.ended:
            follower.tick()
            if follower.ended:
                follower.close()
    return any(not follower.ended for follower in _followers.values())


def _pulse() -> float | None:
    return BEAT if beat() else None


@persistent
def _changed(*_: Any) -> None:
    _changes.note()


@persistent
def _loaded(*_: Any) -> None:
    stop_all()
    forget()
    _changes.note()


def stop_all() -> None:
    """Stop every follower."""
    for channel in list(_followers):
        stop(channel)


HANDLERS = (
    ("depsgraph_update_post", _changed),
    ("frame_change_post", _changed),
    ("undo_post", _changed),
    ("redo_post", _changed),
    ("load_post", _loaded),
)


def register() -> None:
    """Note changes of scenes."""
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """Leave no handler, timer or follower."""
    stop_all()
    if bpy.app.timers.is_registered(_pulse):
        bpy.app.timers.unregister(_pulse)
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).remove(handler)
