# SPDX-License-Identifier: GPL-3.0-or-later
"""Pickled cameras: arrays are read in every protocol; code is refused and not run."""

import io
import os
import pickle

import numpy as np
import pytest
from irgspp.core.datasets.format_detection import parse_dataset
from irgspp.core.datasets.load import load_dataset
from irgspp.core.io.safe_pickle import read_pickle
from irgspp.core.settings.schema import DataSettings
from PIL import Image
from refused import refused


class Runs:
    """Object that creates a folder when the standard library unpickles it."""

    def __init__(self, marker):
        self.marker = str(marker)

    def __reduce__(self):
        return os.mkdir, (self.marker,)


@pytest.mark.parametrize("protocol", range(6))
def test_pickled_arrays_are_read_whatever_the_protocol(tmp_path, protocol):
    whole = [np.arange(12.0).reshape(3, 4), np.asfortranarray(np.arange(6, dtype="<f4").reshape(2, 3)), {1: "a", 2: np.int64(3)}]
    whole += [np.array(["0", "127"]), np.array(5, ">i2"), (True, None, 2.5, b"x"), np.zeros((0, 3))]
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps(whole, protocol))
    read = read_pickle(path)
    assert read[2] == {1: "a", 2: 3} and read[5] == whole[5]
    for i in (0, 1, 3, 4, 6):
        assert read[i].dtype == whole[i].dtype and np.array_equal(read[i], whole[i])


def test_pickles_that_run_code_are_refused_and_don_t(tmp_path):
    path, marker = tmp_path / "a.pkl", tmp_path / "ran"
    pickle.loads(pickle.dumps(Runs(marker)))  # it does
    marker.rmdir()
    harm = [Runs(marker), [np.eye(3), Runs(marker)], {"a": (Runs(marker),)}, np.array([Runs(marker)], object)]
    for value in harm:
        for protocol in (0, 2, 4, 5):
            path.write_bytes(pickle.dumps(value, protocol))
            with refused(r"a\.pkl", "refused"):
                read_pickle(path)
            assert not marker.exists()


@pytest.mark.parametrize(
    "data",
    [
        b"cos\nsystem\n(S'true'\ntR.",
        b"cbuiltins\neval\n(S'1'\ntR.",
        b"cnumpy.testing._private.utils\nrunstring\n(S'1'\nd(tR.",
        b"\x80\x04\x8c\x05numpy\x8c\x04load\x93\x8c\x05a.npy\x85R.",
        b"\x80\x04\x8c\x05numpy\x8c\x07ndarray\x93.",
        b"c__main__\nx\n.",
        pickle.dumps({1, 2}),
        pickle.dumps(np.zeros(2, "M8[s]")),
        pickle.dumps(np.zeros(2, [("a", "f4")])),
        pickle.dumps(io.BytesIO),
        pickle.dumps(np.eye(4))[:-40],
        b"",
        b"no pickle at all",
        pickle.dumps(np.eye(4)).replace(b"\x93", b"\x00", 1),
    ],
)
def test_pickles_of_anything_else_are_bad_input(tmp_path, data):
    path = tmp_path / "a.pkl"
    path.write_bytes(data)
    with refused(r"a\.pkl"):
        read_pickle(path)


def test_pickles_that_swell_are_refused(tmp_path):
    path, value = tmp_path / "a.pkl", []
    for _ in range(6):
        value = [value] * 100
    path.write_bytes(pickle.dumps(value))
    with refused("more than"):
        read_pickle(path)


def glossy_scene(folder, count=3):
    for i in range(count):
        camera = [np.array([[1.0, 0, 0, 0.1 * i], [0, 1, 0, 0], [0, 0, 1, 4]]), np.array([[50.0, 0, 16], [0, 50, 16], [0, 0, 1]])]
        (folder / f"{i}-camera.pkl").write_bytes(pickle.dumps(camera))
        Image.new("RGB", (32, 32), (90, 90, 90)).save(folder / f"{i}.png")
    return folder


def test_a_dataset_with_such_a_pickle_is_refused(tmp_path):
    scene, marker = glossy_scene(tmp_path), tmp_path / "ran"
    assert parse_dataset(scene, DataSettings()).format == "glossy-synthetic"
    (scene / "1-camera.pkl").write_bytes(pickle.dumps(Runs(marker)))
    with refused(r"1-camera\.pkl", "mkdir", "refused"):
        load_dataset(scene)
    for other in ([np.eye(3), np.eye(3)], np.eye(4), [np.eye(3, 4), np.full((3, 3), "1")], [np.full((3, 4), np.nan), np.eye(3)]):
        (scene / "1-camera.pkl").write_bytes(pickle.dumps(other))
        with refused(r"1-camera\.pkl"):
            load_dataset(scene)
    assert not marker.exists()
