# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground truth arrays that claim a wrong size or hold objects are refused."""

import pickle

import numpy as np
from irgspp.core.datasets.ground_truth import ground_truth_layers
from irgspp.core.datasets.load import load_dataset
from PIL import Image
from refused import refused


def test_arrays_with_wrong_sizes_or_objects_are_refused(tmp_path, ball_dataset):
    scene = tmp_path / "blender_LDR" / "thing"
    truth = tmp_path / "ground_truth" / "thing" / "z_depth"
    truth.mkdir(parents=True)
    (scene / "test").mkdir(parents=True)
    Image.new("RGB", (8, 8)).save(scene / "test" / "0000.png")
    ball_dataset.transforms()
    view = load_dataset(ball_dataset.folder).train[0]
    view = type(view)(view.name, view.camera, scene / "test" / "0000.png", view.colour, None)
    path = truth / "0000.npy"
    np.save(path, np.ones((8, 8), np.float32))
    assert ground_truth_layers("stanford-orb", view).depth.shape == (8, 8)
    whole = path.read_bytes()
    for data in (
        pickle.dumps(1),
        whole[:100],
        b"",
        whole.replace(b"(8, 8), }" + 8 * b" ", b"(99999, 99999), }"),
        whole.replace(b"}", b" "),
    ):
        path.write_bytes(data)
        with refused(r"0000\.npy"):
            ground_truth_layers("stanford-orb", view)
    for value in (np.array([{}], object), np.zeros((2, 2), int), np.zeros((2, 2, 2, 2)), np.zeros((4, 4, 7))):
        np.save(path, value, allow_pickle=True)
        with refused(r"0000\.npy"):
            ground_truth_layers("stanford-orb", view)
