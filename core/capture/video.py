# SPDX-License-Identifier: GPL-3.0-or-later
"""Sharp frames of a video, evenly spaced in time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import av.error
import cv2
import numpy as np
from av.video.reformatter import Interpolation

from ..errors import Cancelled, InputError
from ..io.exr import check_pixels
from ..progress.protocol import Progress
from .exif import Orientation
from .video_colour import frame_to_srgb

SHARPNESS_SIDE = 640  # longest side at which sharpness is measured, pixels
BURST_FRAMES = 10  # frames that are decoded for each one that is taken of a long video
LONG_VIDEO_FRAMES = 1.5 * BURST_FRAMES  # frames for each one that is taken from which on a video is long
MIN_KEYFRAME_FRACTION = 0.9  # fraction of the windows that must have a keyframe for bursts
MIN_DURATION_FRACTION = 0.9  # fraction of the stated duration before which a video ends early
MAX_PROBLEMS = 100  # packets that can't be decoded after which a video is given up
FIX = "copy the video again, or convert it to MP4"


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """Frame that was chosen.

    Attributes:
        number: number of the frame in the video at its mean frame rate, from 0.
        colour: (H, W, 3) uint8 sRGB, upright.
        turned: quarter turns anticlockwise from the stored pixels to the upright frame.
    """

    number: int
    colour: np.ndarray
    turned: int


@dataclass(frozen=True)
class Timing:
    """Times of a video, in seconds.

    Attributes:
        start, duration: start and duration of the stream.
        rate: frames in a second on average.
        keyframes: times of the known keyframes.
    """

    start: float
    duration: float
    rate: float
    keyframes: tuple[float, ...]

    def window(self, time: float, count: int) -> int:
        """Return which of `count` equal windows a time lies in."""
        return min(max(int((time - self.start) / self.duration * count), 0), count - 1)

    def in_bursts(self, count: int) -> bool:
        """Return True for a long video of which only the frames after keyframes need decoding."""
        windows = {self.window(t, count) for t in self.keyframes}
        return self.duration * self.rate > LONG_VIDEO_FRAMES * count and len(windows) >= MIN_KEYFRAME_FRACTION * count


def sharp_frames(path: Path, count: int, progress: Progress) -> Iterator[VideoFrame]:
    """Yield the sharpest frame of each of `count` equal windows of time; the video is read once, one frame at a time.

    Sharpness is the variance of the Laplacian. Of a long video, only BURST_FRAMES frames after a keyframe are decoded in each window.

    Args:
        path: the video.
        count: number of windows; fewer frames are yielded where the video has fewer or ends early.
        progress: receives warnings, and may cancel.

    Raises:
        InputError: if the file is no video, or no frame can be decoded.
        Cancelled: once the user stops the job.
    """
    with _opened(path) as container:
        if not container.streams.video:
            raise InputError(path, "has no video stream", "give a video or photographs")
        stream: Any = container.streams.video[0]
        if stream.codec_context is None:
            raise InputError(path, "has a video stream of an unknown codec", FIX)
        check_pixels(path, stream.width, stream.height)
        yield from _sharpest(path, container, stream, count, progress)


def _opened(path: Path) -> Any:
    """Open a video."""
    try:
        return av.open(str(path))
    except (av.error.FFmpegError, OSError, ValueError) as error:
        reason = _reason(error)
    # Not in the handler: FFmpeg refuses impossible sizes as a lack of memory, and the error must not pass for one.
    raise InputError(path, f"not a readable video ({reason})", FIX)


def _sharpest(path: Path, container: Any, stream: Any, count: int, progress: Progress) -> Iterator[VideoFrame]:
    """Yield the sharpest frame of each window."""
    timing = _timing(path, container, stream)
    best: tuple[float, float, Any] | None = None  # sharpness, time, frame
    window, last, number, size = 0, timing.start, -1, None
    for time, frame in _decoded(path, container, stream, timing, count, progress):
        size, last = size or (frame.width, frame.height), max(last, time)
        if (frame.width, frame.height) != size:
            continue
        now = timing.window(time, count)
        if best and now > window:
            number = max(round((best[1] - timing.start) * timing.rate), number + 1)
            yield _upright(best[2], number)
            best = None
        window = max(now, window)
        sharpness = _sharpness(frame)
        if best is None or sharpness > best[0]:
            best = sharpness, time, frame
    if best is None:
        raise InputError(path, "has no frame that can be decoded", FIX)
    yield _upright(best[2], max(round((best[1] - timing.start) * timing.rate), number + 1))
    if last - timing.start < MIN_DURATION_FRACTION * timing.duration - 1 / timing.rate:
        progress.message(f"{path.name}: ends after {last - timing.start:.1f} of {timing.duration:.1f} seconds; the frames before are used")


def _timing(path: Path, container: Any, stream: Any) -> Timing:
    """Read the times of a video; the packets are counted where the duration is not stated."""
    base = float(stream.time_base or 0)
    start = float(stream.start_time or 0) * base
    rate = float(stream.average_rate or stream.guessed_rate or 30)
    duration = float(stream.duration or 0) * base or float(container.duration or 0) / av.time_base
    if duration <= 0:
        duration = _counted_duration(path, start, base)
    if not base > 0 or not 0 < duration < 1e9 or not 0 < rate < 1e6:
        raise InputError(path, "has impossible times", FIX)
    keyframes = tuple(entry.timestamp * base for entry in stream.index_entries if entry.is_keyframe)
    return Timing(start, duration, rate, keyframes)


def _counted_duration(path: Path, start: float, base: float) -> float:
    """Return the time of the last packet, in seconds after the start."""
    with _opened(path) as container:
        times = (float(packet.pts) * base for packet in _packets(container, container.streams.video[0]) if packet.pts is not None)
        return max(times, default=start) - start + base


def _decoded(path: Path, container: Any, stream: Any, timing: Timing, count: int, progress: Progress) -> Iterator[tuple[float, Any]]:
    """Yield (time, frame) of the frames to choose from in the order of presentation."""
    stream.thread_type = "AUTO"
    bursts = timing.in_bursts(count)
    if not bursts and timing.duration * timing.rate > LONG_VIDEO_FRAMES * count:
        stream.codec_context.skip_frame = "NONREF"  # such frames are decoded for themselves alone
    time = timing.start
    for frame in _in_bursts(container, stream, timing, count) if bursts else _frames(container, stream, path, progress):
        if progress.cancelled:
            raise Cancelled("stopped while frames of the video were read")
        time = time + 1 / timing.rate if frame.pts is None else frame.pts * float(stream.time_base)
        if not frame.is_corrupt:
            yield time, frame


def _frames(container: Any, stream: Any, path: Path, progress: Progress) -> Iterator[Any]:
    """Yield all frames that can be decoded."""
    problems = 0
    for packet in _packets(container, stream):
        try:
            yield from packet.decode()
        except av.error.FFmpegError:
            problems += 1
            if problems > MAX_PROBLEMS:
                break
    if problems:
        progress.message(f"{path.name}: is damaged; {problems} parts of it could not be decoded")


def _in_bursts(container: Any, stream: Any, timing: Timing, count: int) -> Iterator[Any]:
    """Yield BURST_FRAMES frames from the first keyframe of each window on."""
    done, left, first = -1, 0, 0
    for packet in _packets(container, stream):
        if packet.pts is None:
            continue
        window = timing.window(float(packet.pts * stream.time_base), count)
        if packet.is_keyframe and window > done and not left:
            done, left, first = window, BURST_FRAMES, packet.pts
        if left:
            left -= 1
            yield from (f for f in _decode(stream, packet, not left) if f.pts is None or f.pts >= first)
    if left:
        yield from (f for f in _decode(stream, None, True) if f.pts is None or f.pts >= first)


def _decode(stream: Any, packet: Any, last: bool) -> list[Any]:
    """Decode a packet; after the last one of a burst, also the frames that the decoder holds back."""
    try:
        frames = [] if packet is None else list(packet.decode())
        if last:
            frames += stream.codec_context.decode(None)
    except av.error.FFmpegError:  # a damaged burst: its other frames are used
        frames = []
    if last:
        stream.codec_context.flush_buffers()
    return frames


def _packets(container: Any, stream: Any) -> Iterator[Any]:
    """Yield the packets of a stream up to the end or to damage, which the caller sees as an early end."""
    try:
        yield from container.demux(stream)
    except (av.error.FFmpegError, OSError):
        return


def _sharpness(frame: Any) -> float:
    """Return the variance of the Laplacian of a reduced grey frame."""
    scale = min(SHARPNESS_SIDE / max(frame.width, frame.height), 1)
    size = {"width": max(round(frame.width * scale), 1), "height": max(round(frame.height * scale), 1)}
    grey = frame.to_ndarray(format="gray", interpolation=Interpolation.AREA, **size)
    return float(cv2.Laplacian(grey, cv2.CV_32F).var())


def _upright(frame: Any, number: int) -> VideoFrame:
    """Convert a frame to sRGB and turn it upright by its display matrix."""
    turned = round(frame.rotation / 90) % 4
    return VideoFrame(number, Orientation(turned).upright(frame_to_srgb(frame)), turned)


def _reason(error: Exception) -> str:
    """Return the reason of an error without the file's name."""
    return getattr(error, "strerror", None) or str(error)[:120] or type(error).__name__
