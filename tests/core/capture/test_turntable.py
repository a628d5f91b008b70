# SPDX-License-Identifier: GPL-3.0-or-later
"""Turntable: the static background of a fixed camera is found, with exposures and what moves; moving cameras are not taken for one."""

import numpy as np
import pytest
from irgspp.core.capture.photograph import Photograph
from irgspp.core.capture.turntable import find_turntable
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from irgspp.core.progress.protocol import Silent
from PIL import Image
from scipy.ndimage import gaussian_filter, shift

WIDTH, HEIGHT, COUNT = 160, 120, 12


def texture(seed, height=HEIGHT, width=WIDTH):
    """Return an encoded texture (H, W, 3) of medium contrast."""
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(height, width, 3)), (1.5, 1.5, 0))
    return np.clip(0.45 + 0.5 * noise, 0.1, 0.8)


def inside():
    """Return the mask (H, W) of the object, a disc in the middle."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return (rows - HEIGHT / 2) ** 2 + (columns - WIDTH / 2) ** 2 < 30**2


def images(gains=(1.0,) * COUNT):
    """Return encoded photographs of a textured object that turns before a static background, with exposure gains."""
    behind = texture(0)
    for i, gain in enumerate(gains):
        front = np.roll(texture(1), 11 * i, 1)
        yield encode_srgb(np.clip(decode_srgb(np.where(inside()[..., None], front, behind)) * gain, 0, 1))


def written(folder, pictures, lens="lens"):
    """Write photographs and return them."""
    found = []
    for i, picture in enumerate(pictures):
        path = folder / f"{i:02d}.png"
        Image.fromarray(np.round(255 * picture).astype(np.uint8)).save(path)
        found.append(Photograph(f"{i:02d}", path, path, picture.shape[1], picture.shape[0], lens))
    return found


def test_what_turns_is_told_from_what_stays(tmp_path):
    turntable = find_turntable(written(tmp_path, images()), "auto", Silent())
    assert turntable is not None
    agreed = (turntable.moving == inside()).mean((1, 2))
    assert agreed.min() > 0.95
    middle, corner = turntable.moving_features(3, np.array([[0.5, 0.5], [0.05, 0.05]]))
    assert middle and not corner


def test_the_static_background_tells_the_exposure(tmp_path):
    gains = np.exp(np.random.default_rng(2).uniform(-0.3, 0.3, COUNT))
    turntable = find_turntable(written(tmp_path, images(gains)), "auto", Silent())
    assert turntable is not None
    expected = gains / np.exp(np.log(gains).mean())
    assert np.abs(turntable.gains / expected[:, None] - 1).max() < 0.01
    assert (turntable.moving == inside()).mean() > 0.95


def moving_camera():
    """Return photographs of a camera that moves sideways past everything."""
    wide = texture(0, HEIGHT, 4 * WIDTH)
    return [wide[:, 15 * i : 15 * i + WIDTH] for i in range(COUNT)]


def test_moving_cameras_are_no_turntable(tmp_path):
    photographs = written(tmp_path, moving_camera())
    assert find_turntable(photographs, "auto", Silent()) is None
    with pytest.raises(InputError, match="the camera moved"):
        find_turntable(photographs, "on", Silent())


def test_shaking_cameras_are_no_turntable(tmp_path):
    """A hand that trembles by some pixels leaves no texture at its place."""
    random = np.random.default_rng(3)
    shaken = [np.clip(shift(one, (*random.uniform(-6, 6, 2), 0), mode="nearest"), 0, 1) for one in images()]
    assert find_turntable(written(tmp_path, shaken), "auto", Silent()) is None


def test_plain_backgrounds_need_the_setting(tmp_path):
    plain = [np.where(inside()[..., None], one, 0.7) for one in images()]
    photographs = written(tmp_path, plain)
    assert find_turntable(photographs, "auto", Silent()) is None
    turntable = find_turntable(photographs, "on", Silent())
    assert turntable is not None and (turntable.moving == inside()).mean() > 0.95


def test_what_is_no_turntable_is_said(tmp_path):
    photographs = written(tmp_path, images())
    assert find_turntable(photographs, "off", Silent()) is None
    assert find_turntable(photographs[:5], "auto", Silent()) is None
    with pytest.raises(InputError, match="there are 5 photographs, fewer than 8"):
        find_turntable(photographs[:5], "on", Silent())
    two_lenses = photographs[:6] + written(tmp_path, images(), "other")[6:]
    assert find_turntable(two_lenses, "auto", Silent()) is None
    with pytest.raises(InputError, match="several sizes or lenses"):
        find_turntable(two_lenses, "on", Silent())
    with pytest.raises(InputError, match="nothing moves"):
        find_turntable(written(tmp_path, [texture(0)] * COUNT), "on", Silent())


def test_cancelled(tmp_path):
    class Stopped(Silent):
        cancelled = True

    with pytest.raises(Cancelled):
        find_turntable(written(tmp_path, images()), "auto", Stopped())
