# SPDX-License-Identifier: GPL-3.0-or-later
"""Cache of the G-buffers of many cameras, rendered on first use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

from ..scene.camera import Camera
from ..scene.gbuffer import GBuffer
from ..scene.reconstruction import Reconstruction
from .gbuffer import render_gbuffer

FLOATS = 13  # per pixel of a G-buffer with confidence


class GBufferCache(Sequence[GBuffer]):
    """Sequence of G-buffers without radiance; it keeps those rendered first, up to a memory limit, and renders the others at each access.

    Each pixel is one ray: the surface is fused from their depths, and a mean over an edge lies on no surface.

    All views of a large capture at once would take tens of gigabytes. Keeping the first ones rather than the last used ones saves the same
    fraction of the work in every pass over the whole sequence.

    Args:
        reconstruction: what is rendered.
        cameras: one camera per G-buffer.
        memory: largest number of bytes to keep.
    """

    def __init__(self, reconstruction: Reconstruction, cameras: Sequence[Camera], memory: int = 1 << 30) -> None:
        self._reconstruction, self._cameras, self._free = reconstruction, list(cameras), memory
        self._cached: dict[int, GBuffer] = {}

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
        if index in self._cached:
            return self._cached[index]
        camera = self._cameras[index]
        gbuffer = render_gbuffer(self._reconstruction, camera, subpixels=1, shaded=False)
        size = camera.width * camera.height * FLOATS * 4
        if size <= self._free:
            self._free -= size
            self._cached[index] = gbuffer
        return gbuffer
