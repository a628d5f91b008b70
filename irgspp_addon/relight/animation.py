# SPDX-License-Identifier: GPL-3.0-or-later
"""Animation of the light as numbered image files: the frames of the scene, or one turn of World and lamps, rendered one after the other.

Blender stays usable: a timer sends a frame to the worker, and saves it when it is finished.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent  # pyright: ignore[reportMissingImports]

from ...core.errors import InputError, IrgsppError
from ..translations import translated
from ..windows import enlarged, redraw
from .final_request import final_request, full_size
from .session import Session, session_of

CHANNEL = "animation"
BEAT = 0.05  # seconds between looks at the worker's answer
IMAGE = "IRGS++ Frame"  # datablock that frames are saved from


class LightAnimation:
    """Rendering of an animation, frame by frame: call `tick` until it has ended.

    Args:
        scene: scene to render, with its camera, image size and file format.
        layer: view layer.
        frames: numbers of the frames.
        output: path of the files, to which number and suffix are added, as in the scene's Output; "//" is the folder of the .blend file.
        turn: True: World and lamps turn once about the object during the frames, while the scene stays at its present frame.

    Raises:
        InputError: if there are no frames, no path or no format for single images.
    """

    def __init__(self, scene: bpy.types.Scene, layer: bpy.types.ViewLayer, frames: Sequence[int], output: str, turn: bool) -> None:
        if not frames:
            raise InputError("frames", "there are none between first and last", "check the frame range")
        if not output:
            raise InputError("output", "no folder is named", "set the scene's Output Path, or give output=")
        if scene.render.is_movie_format:
            raise InputError(f"scene {scene.name}", "is set to write a video", "choose an image format in Output")
        self._scene, self._layer, self._output, self._turn = scene.name, layer.name, output, turn
        self._frames, self._back = list(frames), scene.frame_current
        self._session: Session | None = None
        self.finished, self.share, self.error, self.ended = 0, 0.0, "", False
        self.folder: Path | None = None  # of the latest file

    @property
    def fraction(self) -> float:
        """Return the finished fraction of the animation, 0..1."""
        return min(1.0, (self.finished + self.share) / len(self._frames))

    @property
    def text(self) -> str:
        """Return the progress as text, such as "Frame 3 of 24"."""
        count = len(self._frames)
        return translated("Frame {number} of {count}", number=min(self.finished + 1, count), count=count)

    def tick(self) -> None:
        """Send the next frame, or save the one that is finished, without waiting; an error ends the animation."""
        try:
            scene = bpy.data.scenes.get(self._scene)
            if scene is None:
                raise InputError(self._scene, "the scene was removed", "render another scene")
            if self._session is None:
                self._start_frame(scene)
            else:
                self._finish_frame(scene)
        except (IrgsppError, RuntimeError, OSError) as error:  # RuntimeError is Blender's, for a file that can't be written
            self.error = str(error).strip()
            self.close()

    def close(self) -> None:
        """End the animation; the files of finished frames stay, and the scene returns to its frame."""
        if self.ended:
            return
        self.ended = True
        if self._session is not None and self._session.alive:
            self._session.cancel(CHANNEL)
        scene, image = bpy.data.scenes.get(self._scene), bpy.data.images.get(IMAGE)
        if image is not None:
            bpy.data.images.remove(image)
        if scene is not None and not self._turn and scene.frame_current != self._back:
            scene.frame_set(self._back)

    def _start_frame(self, scene: bpy.types.Scene) -> None:
        """Send the next frame to the worker; frames that exist are left out where the scene does not overwrite files."""
        frame = self._frames[self.finished]
        if not scene.render.use_overwrite and _path(scene, self._output, frame).is_file():
            self._next()
            return
        if not self._turn:
            scene.frame_set(frame)
        layer = scene.view_layers.get(self._layer) or scene.view_layers[0]
        layer.update()
        angle = 2 * math.pi * self.finished / len(self._frames) if self._turn else 0.0
        request, run = final_request(layer.depsgraph, full_size(scene.render), angle)
        session = session_of(run)
        session.send(CHANNEL, request)
        self._session = session

    def _finish_frame(self, scene: bpy.types.Scene) -> None:
        """Save the frame once it is finished."""
        assert self._session is not None
        answer = self._session.poll(CHANNEL)
        if answer is None:
            return
        self.share = answer.fraction
        if answer.done and answer.image is not None:
            path = _path(scene, self._output, self._frames[self.finished])
            _save(scene, answer.image, path)
            self.folder = path.parent
            self._session = None
            self._next()

    def _next(self) -> None:
        """Go on to the next frame, or end."""
        self.finished, self.share = self.finished + 1, 0.0
        if self.finished == len(self._frames):
            self.close()


def _path(scene: bpy.types.Scene, output: str, frame: int) -> Path:
    """Return the file of a frame: `output` with the frame's number, or in place of its #, and the format's suffix."""
    path = Path(bpy.path.abspath(output))
    folder, name = (path, "") if output.endswith(("/", "\\")) or path.is_dir() else (path.parent, path.name)
    digits = name.count("#")
    name = name.replace("#" * digits, f"{frame:0{digits}}") if digits and "#" * digits in name else f"{name}{frame:04}"
    suffix = scene.render.file_extension
    return folder / (name if name.lower().endswith(suffix) else name + suffix)


def _save(scene: bpy.types.Scene, pixels: np.ndarray, path: Path) -> None:
    """Write pixels (H, W, 4), linear and premultiplied, in the scene's file format and through its view transform."""
    height, width = pixels.shape[:2]
    path.parent.mkdir(parents=True, exist_ok=True)
    image = bpy.data.images.get(IMAGE)
    if image is None or tuple(image.size) != (width, height):
        if image is not None:
            bpy.data.images.remove(image)
        image = bpy.data.images.new(IMAGE, width, height, alpha=True, float_buffer=True)
        image.alpha_mode = "PREMUL"
    image.pixels.foreach_set(enlarged(pixels, width, height))
    image.update()
    image.save_render(str(path), scene=scene)


_running: list[LightAnimation] = []  # the latest one


def animation() -> LightAnimation | None:
    """Return the animation that is rendered, or the last one."""
    return _running[0] if _running else None


def start(rendering: LightAnimation) -> None:
    """Render an animation in the background of Blender, in place of an earlier one."""
    stop()
    _running[:] = [rendering]
    if not bpy.app.timers.is_registered(_pulse):
        bpy.app.timers.register(_pulse)


def stop() -> None:
    """Stop the animation, if one is rendered."""
    if _running:
        _running[0].close()


def finish(rendering: LightAnimation) -> None:
    """Render an animation and wait for its end.

    Raises:
        IrgsppError: if it fails.
    """
    while not rendering.ended:
        rendering.tick()
        time.sleep(BEAT / 5)
    if rendering.error:
        raise IrgsppError(rendering.error)


def _pulse() -> float | None:
    rendering = animation()
    if rendering is None or rendering.ended:
        return None
    rendering.tick()
    redraw("VIEW_3D")
    return None if rendering.ended else BEAT


@persistent
def _before_load(*_: Any) -> None:
    stop()
    _running.clear()  # its scene goes with the file


def register() -> None:
    """Forget an animation where another file is opened."""
    bpy.app.handlers.load_pre.append(_before_load)


def unregister() -> None:
    """Stop the animation, and remove handler and timer."""
    stop()
    _running.clear()
    if bpy.app.timers.is_registered(_pulse):
        bpy.app.timers.unregister(_pulse)
    bpy.app.handlers.load_pre.remove(_before_load)
