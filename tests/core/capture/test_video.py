# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of videos: sharp, evenly spaced in time, upright, in sRGB; damage keeps what was read."""

import av
import cv2
import numpy as np
import pytest
from irgspp.core.capture import video
from irgspp.core.capture.video import sharp_frames
from irgspp.core.capture.video_colour import frame_to_srgb
from irgspp.core.errors import Cancelled
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.progress.protocol import Silent
from refused import refused

SIZE = (96, 128)


@pytest.fixture(scope="module")
def moving(views):
    """Function that makes frames that move, of which every third alone is sharp."""

    def make(count):
        base = views(0, SIZE)
        frames = [np.roll(base, 2 * i, 1) for i in range(count)]
        return [f if i % 3 == 0 else cv2.GaussianBlur(f, (0, 0), 1.5) for i, f in enumerate(frames)]

    return make


def numbers(path, count, progress=Silent()):  # noqa: B008
    return [f.number for f in sharp_frames(path, count, progress)]


@pytest.mark.parametrize(
    ("suffix", "codec"), [(".mp4", "libx264"), (".mov", "libx264"), (".mkv", "libx264"), (".webm", "libvpx"), (".avi", "mpeg4")]
)
def test_sharp_frames_evenly_spaced(tmp_path, writers, moving, suffix, codec):
    options = {"bit_rate": 4_000_000, "options": {"bf": "0"} if suffix == ".avi" else {}}
    writers.write_video(tmp_path / f"v{suffix}", moving(60), codec=codec, **options)
    found = numbers(tmp_path / f"v{suffix}", 10)
    assert len(found) == 10 and all(n % 3 == 0 for n in found) and np.abs(np.subtract(found, 6 * np.arange(10) + 2.5)).max() <= 3.5


@pytest.mark.parametrize("turned", range(4))
def test_rotation_is_applied(tmp_path, writers, turned):
    corner = np.full((*SIZE, 3), 40, np.uint8)
    corner[:48, :64] = 220
    writers.write_video(tmp_path / "v.mp4", [corner] * 5, turned)
    (frame,) = sharp_frames(tmp_path / "v.mp4", 1, Silent())
    right = np.rot90(corner, turned).astype(int)
    assert frame.turned == turned and frame.colour.shape == right.shape and np.abs(frame.colour - right).mean() < 4


def test_long_video_is_decoded_in_bursts(tmp_path, writers, moving, monkeypatch):
    writers.write_video(tmp_path / "v.mp4", moving(300))
    measured = []
    sharpness = video._sharpness
    monkeypatch.setattr(video, "_sharpness", lambda frame: measured.append(frame.pts) or sharpness(frame))
    found = numbers(tmp_path / "v.mp4", 10)
    assert len(measured) <= 10 * video.BURST_FRAMES and all(n % 3 == 0 for n in found) and np.abs(np.diff(found) - 30).max() <= 12


def test_long_video_with_few_keyframes(tmp_path, writers, moving):
    writers.write_video(tmp_path / "v.mp4", moving(300), options={"g": "300"})
    found = numbers(tmp_path / "v.mp4", 10)
    assert len(found) == 10 and np.abs(np.diff(found) - 30).max() <= 30


def test_fewer_frames_than_asked_for(tmp_path, writers, moving):
    writers.write_video(tmp_path / "v.mp4", moving(5))
    assert numbers(tmp_path / "v.mp4", 20) == [0, 1, 2, 3, 4]


def test_variable_frame_rate(tmp_path, writers, moving):
    times = [*range(30), *range(30, 330, 10)]  # one second at 30 frames a second, then ten seconds at 3
    writers.write_video(tmp_path / "v.mp4", moving(60), times=times)
    frames = list(sharp_frames(tmp_path / "v.mp4", 11, Silent()))
    assert len(frames) == 11 and len({f.number for f in frames}) == 11


def test_same_frames_each_time(tmp_path, writers, moving):
    writers.write_video(tmp_path / "v.mp4", moving(40))
    first, second = (list(sharp_frames(tmp_path / "v.mp4", 6, Silent())) for _ in range(2))
    assert all(a.number == b.number and np.array_equal(a.colour, b.colour) for a, b in zip(first, second, strict=True))


def test_damaged_tail_keeps_what_was_read(tmp_path, writers, moving, heard):
    writers.write_video(tmp_path / "v.mkv", moving(60))
    data = (tmp_path / "v.mkv").read_bytes()
    (tmp_path / "v.mkv").write_bytes(data[: len(data) // 2])
    progress = heard()
    found = numbers(tmp_path / "v.mkv", 10, progress)
    assert 3 <= len(found) <= 7 and "ends after" in progress.messages[0]


def test_damage_in_the_middle_is_told(tmp_path, writers, moving, heard):
    writers.write_video(tmp_path / "v.mp4", moving(60))
    data = bytearray((tmp_path / "v.mp4").read_bytes())
    data[len(data) // 3 : len(data) // 2] = bytes(len(data) // 2 - len(data) // 3)
    (tmp_path / "v.mp4").write_bytes(data)
    progress = heard()
    assert len(numbers(tmp_path / "v.mp4", 10, progress)) >= 4 and "is damaged" in progress.messages[0]


def test_files_that_are_no_videos_are_refused(tmp_path, writers, moving):
    writers.write_video(tmp_path / "v.mp4", moving(10))
    (tmp_path / "cut.mp4").write_bytes((tmp_path / "v.mp4").read_bytes()[:2000])
    (tmp_path / "empty.mov").write_bytes(b"")
    for name in ("cut.mp4", "empty.mov"):
        with refused(name, "not a readable video"):
            numbers(tmp_path / name, 3)
    with av.open(str(tmp_path / "sound.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        stream.layout = "mono"
        container.mux(stream.encode(_silence()))
        container.mux(stream.encode())
    with refused("sound.mkv", "has no video stream"):
        numbers(tmp_path / "sound.mkv", 3)


def _silence():
    frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
    frame.sample_rate, frame.pts = 8000, 0
    return frame


def test_cancellation(tmp_path, writers, moving, heard):
    writers.write_video(tmp_path / "v.mp4", moving(10))
    with pytest.raises(Cancelled):
        numbers(tmp_path / "v.mp4", 3, heard(0))


def coded(signal, transfer, primaries, matrix, pixel_format="yuv444p10le"):
    """Frame of one grey or coloured signal (3,) in 0..1, with its colours described."""
    deep = np.tile(np.round(65535 * np.asarray(signal)).astype(np.uint16), (16, 16, 1))
    frame = av.VideoFrame.from_ndarray(deep, format="rgb48le").reformat(format=pixel_format, dst_colorspace=matrix, dst_color_range=1)
    frame.color_trc, frame.color_primaries, frame.colorspace = transfer, primaries, matrix
    return frame


@pytest.mark.parametrize(("signal", "level"), [(0.75, 255), (1.0, 255), (0.5, 152), (0.25, 79), (0.0, 0)])
def test_hlg_has_white_at_three_quarters_and_is_linear_below(signal, level):
    # By BT.2100, the signal 0.5 is a twelfth of the peak and 0.75 is 0.2650 of it; the sRGB code of their ratio is 152.
    found = frame_to_srgb(coded([signal] * 3, 18, 9, 9))
    assert np.abs(found[8, 8].astype(int) - level).max() <= 2


@pytest.mark.parametrize("level", [20, 118, 200, 255])
def test_pq_has_white_at_203_candelas(level):
    power = (203 / 10_000 * decode_srgb(np.array(level / 255))) ** 0.1593017578125  # the inverse EOTF of SMPTE ST 2084
    signal = ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375
    assert np.abs(frame_to_srgb(coded([signal] * 3, 16, 9, 9))[8, 8].astype(int) - level).max() <= 2


def test_wide_gamut_becomes_srgb():
    grey = frame_to_srgb(coded([0.6, 0.6, 0.6], 13, 12, 1))[8, 8]
    red = frame_to_srgb(coded([0.6, 0.3, 0.3], 13, 12, 1))[8, 8].astype(int)
    assert np.abs(grey.astype(int) - 153).max() <= 2 and red[0] > 155 and red[1] < 76  # P3's red is purer than sRGB's


@pytest.mark.parametrize("matrix", [1, 5])
def test_stated_matrix_is_used(matrix):
    pixels = np.tile(np.array([200, 60, 30], np.uint8), (16, 16, 1))
    frame = av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(format="yuv444p", dst_colorspace=matrix, dst_color_range=1)
    frame.colorspace = matrix
    assert np.abs(frame_to_srgb(frame)[8, 8].astype(int) - pixels[8, 8]).max() <= 3
