# SPDX-License-Identifier: GPL-3.0-or-later
"""The layers of many cameras, rendered when they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

from ..scene.camera import Camera
from ..scene.gbuffer import GBuffer
from ..scene.reconstruction import Reconstruction
from .gbuffer import render_gbuffer

FLOATS = 13  # of a pixel of ViewBuffers


class GBufferCache(Sequence[GBuffer]):
    """A sequence of `ViewBuffers`: the first ones that fit into `memory` bytes are kept, the others rendered again each time.

    All views of a large capture at once would take tens of gigabytes. Keeping the first (not the last used) makes every pass over
    the whole sequence save the same share of the work.
    """

    def __init__(self, reconstruction: Reconstruction, cameras: Sequence[Camera], memory: int = 2 << 30) -> None:
        self._reconstruction, self._cameras, self._free = reconstruction, list(cameras), memory
        self._kept: dict[int, GBuffer] = {}

    def __len__(self) -> int:
        return len(self._cameras)

    @overload
    def __getitem__(self, index: int) -> GBuffer: ...

    @overload
    def __getitem__(self, index: slice) -> list[GBuffer]: ...

    def __getitem__(self, index: int | slice) -> GBuffer | list[GBuffer]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        index = range(len(self))[index]
        if index in self._kept:
            return self._kept[index]
        camera = self._cameras[index]
        buffers = render_gbuffer(self._reconstruction, camera)
        size = camera.width * camera.height * FLOATS * 4
        if size <= self._free:
            self._free -= size
            self._kept[index] = buffers
        return buffers
