# SPDX-License-Identifier: GPL-3.0-or-later
"""Writers of photographs and videos as cameras make them: RAW as DNG, MP4 and MKV with a display matrix."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import tifffile

BYTE, SHORT, LONG, RATIONAL, SIGNED = 1, 3, 4, 5, 10  # types of TIFF tags
BLACK, WHITE = 512, 16383  # levels of the sensor
COLOUR_FILTER_ARRAY, D65 = 32803, 21
XYZ = ((0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505))  # of linear sRGB
EXIF = {33434: (RATIONAL, (1, 60)), 33437: (RATIONAL, (18, 10)), 34855: (SHORT, 200), 37386: (RATIONAL, (45, 10)), 41989: (SHORT, 28)}


def write_dng(path: Path, linear: np.ndarray, orientation: int = 1) -> None:
    """Write linear colours as the RAW file of a camera whose primaries are those of sRGB; EXIF states 1/60 s, f/1.8, ISO 200, 28 mm.

    Args:
        path: the file.
        linear: (H, W, 3) in 0..1 with even sides.
        orientation: of EXIF.
    """
    mosaic = linear[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = linear[::2, ::2, 0], linear[1::2, 1::2, 2]
    levels = np.round(BLACK + np.clip(mosaic, 0, 1) * (WHITE - BLACK)).astype(np.uint16)
    matrix = [int(n) for value in np.linalg.inv(XYZ).ravel() for n in (round(value * 10_000), 10_000)]
    tags: dict[int, tuple[int, Any]] = {
        274: (SHORT, orientation),
        33421: (SHORT, (2, 2)),  # the colour filter's pattern: red, green; green, blue
        33422: (BYTE, (0, 1, 1, 2)),
        50706: (BYTE, (1, 4, 0, 0)),  # DNG's version
        50707: (BYTE, (1, 1, 0, 0)),
        50714: (LONG, BLACK),
        50717: (LONG, WHITE),
        50721: (SIGNED, tuple(matrix)),  # XYZ to the camera's colours
        50728: (RATIONAL, (1, 1) * 3),  # neutral colour as shot
        50778: (SHORT, D65),
        **EXIF,
    }
    listed = [(tag, type, _count(type, value), value, True) for tag, (type, value) in tags.items()]
    names = [(tag, 2, None, name, True) for tag, name in ((271, "Lab"), (272, "Camera"), (50708, "Lab Camera"))]
    tifffile.imwrite(path, levels, photometric=COLOUR_FILTER_ARRAY, extratags=[*listed, *names], metadata=None)


def _count(type: int, value: Any) -> int:
    """Return the number of values of a tag."""
    count = len(value) if isinstance(value, tuple) else 1
    return count // 2 if type in (RATIONAL, SIGNED) else count


def write_video(
    path: Path, frames: Iterable[np.ndarray], turned: int = 0, codec: str = "libx264", times: list[int] | None = None, **options: Any
) -> None:
    """Write a video of 30 frames a second.

    Args:
        path: the file; its suffix selects the container.
        frames: (H, W, 3) uint8 with even sides.
        turned: quarter turns anticlockwise that a player has to make.
        codec: of the video.
        times: of the frames in thirtieths of a second; None: one after the other.
        **options: attributes of the stream, such as `pix_fmt`, and options of the codec in `options`.
    """
    coded = {"g": "12", "bf": "2", "threads": "1", **options.pop("options", {})}
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=30, options=coded)
        stream.pix_fmt = options.pop("pix_fmt", "yuv420p")
        stream.codec_context.time_base = Fraction(1, 30)
        for name, value in options.items():
            setattr(stream.codec_context, name, value)
        for number, pixels in enumerate(frames):
            if number == 0:
                stream.height, stream.width = pixels.shape[:2]
                if turned:
                    stream.set_display_rotation(90 * turned if turned < 3 else -90)
            frame: Any = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
            frame.pts, frame.time_base = times[number] if times else number, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
