# SPDX-License-Identifier: GPL-3.0-or-later
"""Live images that follow the scene: a change of camera, World or object requests a new image, which is shown as it is refined.

One timer updates all live images while there are any; the handlers only record that something changed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent  # pyright: ignore[reportMissingImports]

from ...core.errors import InputError, IrgsppError
from ...core.scene.camera import Camera
from ...core.scene.lamps import Lamp
from ..engine.process import engine_python, status
from ..importer.run_frame import Frame, albedo_scale, chosen_run, frame_of, run_object
from ..translations import translated
from ..windows import redraw
from ..world.scene_lamps import scene_lamps
from ..world.world_light import forget
from .ground import ground_height, ground_plane
from .left_out import seen_objects
from .session import RelightRequest, Session, session_of
from .world_follower import WorldFollower, changes

BEAT = 0.04  # seconds between updates

CameraOf = Callable[[bpy.types.Scene, Frame, int, int], Camera]  # arguments: scene, frame, width, height; may raise InputError


class Follower:
    """Live image that is kept up to date.

    Args:
        channel: name of its channel at the worker.
        scene: scene of the World and the object.
        run: run folder; None for the run that is chosen at each update.
        camera: function that returns the current camera in Blender's world, for an image of the given width and height.
        size: function that returns the image's current width and height in pixels.
        settings: function that returns the current samples, denoise, backend, use_world, use_lamps and (optionally) backdrop.
        show: function called with each image (H, W, 4), the size of the finished image, and True for the finished one.
        visible: function that returns False when the image is no longer shown; then the follower ends.
    """

    def __init__(
        self,
        channel: str,
        scene: bpy.types.Scene,
        run: Path | None,
        camera: CameraOf,
        size: Callable[[bpy.types.Scene], tuple[int, int]],
        settings: Callable[[bpy.types.Scene], dict[str, Any]],
        show: Callable[[np.ndarray, tuple[int, int], bool], None],
        visible: Callable[[], bool] = lambda: True,
    ) -> None:
        self.channel, self.run, self._scene = channel, run, scene.name
        self._camera, self._size, self._settings, self._show, self._visible = camera, size, settings, show, visible
        self._has_object = run is None or run_object(scene, run) is not None
        self._world = WorldFollower()
        self._read: tuple[tuple, tuple[Lamp, ...], float | None] | None = None  # what lamps and ground were read at, and these
        self._session: Session | None = None
        self._requested: tuple | None = None  # key of the latest request
        self._requested_size = (1, 1)
        self.message, self.share, self.ended, self.done, self.failed = translated("Starting the engine"), 0.0, False, False, False
        self._ended_at = 0
        self._engine = _engine_state()

    def tick(self) -> None:
        """Compare the scene with the latest request and read the worker's answer, without waiting; an error becomes the message."""
        if not self._visible():
            self.ended = True
            return
        before = self.message
        try:
            self._send_request()
            self._read_answer()
            self.failed = False
        except IrgsppError as error:
            self.message, self.failed = str(error), True
            if self._session is not None and not self._session.alive:
                self.ended = True  # a worker that fails at its start must not be started again and again
        if self.message != before:
            redraw("VIEW_3D", "PROPERTIES")

    def finish(self) -> None:
        """Wait for the finished image, for scripts.

        Raises:
            IrgsppError: if it can't be rendered.
        """
        while not self.done:
            self.tick()
            if self.failed or self.ended:
                raise IrgsppError(self.message)
            time.sleep(BEAT)

    def close(self) -> None:
        """End the live image and cancel its request."""
        self.ended, self._ended_at = True, changes.count
        self._world.close()
        if self._session is not None and self._session.alive:
            self._session.cancel(self.channel)

    @property
    def stale(self) -> bool:
        """True if the live image has ended and something has changed since."""
        return self.ended and (self._ended_at != changes.count or self.outdated)

    @property
    def outdated(self) -> bool:
        """True if another engine has been chosen or checked since the start, so that an error may be about the one before."""
        return self._engine != _engine_state()

    def _send_request(self) -> None:
        """Send a request if the scene has changed since the latest one."""
        scene = bpy.data.scenes.get(self._scene)
        if scene is None:
            self.ended = True
            raise InputError(self._scene, "the scene was removed", "start the preview again in another scene")
        run = self.run or chosen_run(scene)
        thing = run_object(scene, run)
        if thing is None and self._has_object:
            self.ended = self.run is not None
            raise InputError(run.name, "its object was deleted from the scene, so there is nothing to relight", "import the run again")
        self._session = session_of(run)
        size = self._size(scene)
        request = self._request(scene, thing, size)
        if request is None:
            self.message = translated("Rendering the World")
        elif request.key() != self._requested:
            self._session.send(self.channel, request)
            self._requested, self._requested_size, self.done, self.share = request.key(), size, False, 0.0

    def _request(self, scene: bpy.types.Scene, thing: bpy.types.Object | None, size: tuple[int, int]) -> RelightRequest | None:
        """Return the request for the scene as it is now; None while its World is rendered for the first time.

        Args:
            scene: the scene.
            thing: object of the run; None for a run that was not imported.
            size: width and height of the image in pixels.
        """
        settings = self._settings(scene)
        use_world, use_lamps = settings.pop("use_world"), settings.pop("use_lamps")
        light = self._world.light(scene) if use_world else None
        if use_world and light is None:
            return None
        frame = frame_of(thing)
        camera = frame.camera(self._camera(scene, frame, *size))
        lamps, ground = self._surroundings(scene, thing)
        settings["lamps"], settings["ground"] = frame.lamps(lamps) if use_lamps else (), ground_plane(ground, frame)
        turned = light.turned(frame.rotation) if light else None
        return RelightRequest(camera, turned, albedo_scale=albedo_scale(thing), **settings)

    def _surroundings(self, scene: bpy.types.Scene, thing: bpy.types.Object | None) -> tuple[tuple[Lamp, ...], float | None]:
        """Return the scene's lamps and the height of its ground, which are read again when something has changed."""
        present = changes.count, scene.irgspp.ground_shadow  # a setting that a script changes is no change of the scene for Blender
        if self._read is None or self._read[0] != present:
            things = seen_objects(scene)
            self._read = present, scene_lamps(things, thing), ground_height(scene, things, thing)
        return self._read[1:]

    def _read_answer(self) -> None:
        """Show the worker's latest image, if it is new."""
        if self._session is None or self._requested is None:
            return
        answer = self._session.poll(self.channel)
        if answer is None:
            if not self._session.ready:
                self.message = translated("Starting the engine")
            return
        self.share, self.done = answer.fraction, answer.done
        self.message = translated("Done") if answer.done else translated("Refining, {percent}", percent=f"{answer.fraction:.0%}")
        if answer.image is not None:
            self._show(answer.image, self._requested_size, answer.done)


def _engine_state() -> tuple[str, str]:
    return engine_python(), status().state


_followers: dict[str, Follower] = {}


def follow(follower: Follower) -> None:
    """Start to update a follower, in place of the earlier one of its channel."""
    stop(follower.channel)
    _followers[follower.channel] = follower
    if not bpy.app.background and not bpy.app.timers.is_registered(_pulse):
        bpy.app.timers.register(_pulse)


def follower_of(channel: str) -> Follower | None:
    """Return the follower of a channel, or None; it may have ended."""
    return _followers.get(channel)


def stop(channel: str) -> None:
    """Stop the follower of a channel, if there is one."""
    follower = _followers.pop(channel, None)
    if follower is not None:
        follower.close()


def beat() -> bool:
    """Update all followers once, as the timer does, and return False if none is left; scripts may call it."""
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
    changes.note()


@persistent
def _loaded(*_: Any) -> None:
    stop_all()
    forget()
    changes.note()


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
    """Add the handlers that record changes of scenes."""
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """Remove handlers, timer and followers."""
    stop_all()
    if bpy.app.timers.is_registered(_pulse):
        bpy.app.timers.unregister(_pulse)
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).remove(handler)
