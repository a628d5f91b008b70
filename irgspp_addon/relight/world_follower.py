# SPDX-License-Identifier: GPL-3.0-or-later
"""Environment map of a scene's World that follows the World's changes, and the record of when scenes changed."""

from __future__ import annotations

import time
from dataclasses import dataclass

import bpy

from ...core.errors import IrgsppError
from ...core.scene.environment_map import EnvironmentMap
from ..world.plain_world import plain_light
from ..world.world_light import WorldBake, ask_world

STILL = 0.3  # seconds without change before a World is rendered


@dataclass
class SceneChanges:
    """Counter of the changes of scenes.

    Attributes:
        count: number of changes so far.
        when: monotonic time of the last change in seconds.
    """

    count: int = 0
    when: float = 0.0

    def note(self) -> None:
        """Count a change."""
        self.count, self.when = self.count + 1, time.monotonic()

    def since(self) -> float:
        """Return the seconds since the last change."""
        return time.monotonic() - self.when


changes = SceneChanges()


class WorldFollower:
    """Environment map of a scene's current World, which is read directly or rendered in the background."""

    def __init__(self) -> None:
        self._light: EnvironmentMap | None = None
        self._bake: WorldBake | None = None
        self._seen = -1  # `changes.count` when the World was examined last
        self.error: IrgsppError | None = None

    def light(self, scene: bpy.types.Scene) -> EnvironmentMap | None:
        """Return the light; while a new World is rendered the former light, or None before the first.

        Raises:
            IrgsppError: if the scene has no World or it can't be rendered.
        """
        if self._seen != changes.count:
            self._examine(scene)
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
        """Stop rendering the World."""
        if self._bake is not None:
            self._bake.close()
            self._bake = None

    def _examine(self, scene: bpy.types.Scene) -> None:
        """Read the scene's World or start to render it."""
        seen, world, frame = changes.count, scene.world, scene.frame_current
        try:
            light = plain_light(world)
            if light is None and self._light is not None and changes.since() < STILL:
                return  # the user is still dragging a slider: examine it again at the next call
            self._seen, self.error = seen, None
            if light is None and self._bake is not None and self._bake.shows(world, frame):
                return
            self.close()
            result = light or ask_world(world, frame)
        except IrgsppError as error:
            self._seen, self.error = seen, error
            return
        if isinstance(result, EnvironmentMap):
            self._light = result
        else:
            self._bake = result

    def _finish(self) -> None:
        """Take over the light if its rendering has ended."""
        assert self._bake is not None
        try:
            light = self._bake.poll()
        except IrgsppError as error:
            self.error, light = error, None
        if light is not None:
            self._light = light
        if light is not None or self.error is not None:
            self.close()
