# SPDX-License-Identifier: GPL-3.0-or-later
"""Cache of the G-buffers of many cameras, rendered on first use."""

from __future__ import annotations

from collections.abc import Sequence

from ..machine.lazy_sequence import LazySequence
from ..scene.camera import Camera
from ..scene.gbuffer import GBuffer
from ..scene.reconstruction import Reconstruction
from .gbuffer import render_gbuffer

FLOATS = 13  # per pixel of a G-buffer with confidence


class GBufferCache(LazySequence[GBuffer]):
    """Sequence of G-buffers without radiance; all of a large capture at once would take tens of gigabytes.

    Each pixel is one ray: the surface is fused from their depths, and a mean over an edge lies on no surface.

    Args:
        reconstruction: what is rendered.
        cameras: one camera per G-buffer.
        memory: largest number of bytes to keep.
    """

    def __init__(self, reconstruction: Reconstruction, cameras: Sequence[Camera], memory: int = 1 << 30) -> None:
        super().__init__(len(cameras), memory)
        self._reconstruction, self._cameras = reconstruction, list(cameras)

    def make(self, index: int) -> GBuffer:
        """Render the G-buffer of a camera."""
        return render_gbuffer(self._reconstruction, self._cameras[index], subpixels=1, shaded=False)

    def size(self, index: int, item: GBuffer) -> int:
        """Return the bytes that a G-buffer takes."""
        return self._cameras[index].width * self._cameras[index].height * FLOATS * 4
