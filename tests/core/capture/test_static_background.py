# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns of the light about the object, and what the static background of a turntable tells of the undistorted images."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from irgspp.core.capture.photograph import Photograph
from irgspp.core.capture.static_background import SeenBackground, light_rotations
from irgspp.core.capture.turntable import Turntable
from irgspp.core.datasets.parsed_dataset import Lens
from irgspp.core.scene.camera import Camera, look_at

SIZE = 64


def image(number, angle=0.0):
    """Undistorted image of a camera on a ring."""
    camera = Camera(SIZE, SIZE, 60.0, 60.0, SIZE / 2, SIZE / 2, look_at((3 * np.cos(angle), 3 * np.sin(angle), 1.5)))
    name = f"{number}"
    photograph = Photograph(name, Path(name), Path(name), SIZE, SIZE, "lens")
    lens = Lens("PINHOLE", SIZE, SIZE, 60.0, 60.0, SIZE / 2, SIZE / 2)
    return SimpleNamespace(
        camera=camera, view=SimpleNamespace(name=name, camera=camera), posed=SimpleNamespace(photograph=photograph, lens=lens)
    )


def test_the_light_stands_still_in_the_frame_of_the_camera():
    images = [image(i, 0.5 * i) for i in range(5)]
    similarity = np.eye(4)
    similarity[:3, :3] = 2 * np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turns = light_rotations(images, similarity)
    assert np.allclose(turns["0"], np.eye(3))
    lamp = np.array([0.3, 0.8, 0.5])  # a direction in the frame of the camera
    seen = [np.array(turns[f"{i}"]) @ one.camera.moved(similarity).to_world[:3, :3] @ lamp for i, one in enumerate(images)]
    assert np.allclose(seen, seen[0])
    assert np.allclose(np.array(turns["2"])[2], [0, 0, 1])  # the turntable's axis is +Z


def test_background_and_gains_are_those_of_the_registered_photographs():
    moving = np.zeros((3, 32, 32), bool)
    for i in range(3):
        moving[i, 12:20, 4 * i + 6 : 4 * i + 14] = True
    photographs = [image(i).posed.photograph for i in range(3)]
    gains = np.array([[1.0, 1, 1], [2, 2, 2], [3, 3, 3]])
    seen = SeenBackground.of(Turntable(moving, gains), photographs, [image(0), image(2)])
    assert np.array_equal(seen.gains, gains[[0, 2]]) and set(seen.masks) == {"0", "2"}
    mask = seen.masks["2"]
    assert mask.shape == (SIZE, SIZE) and not mask[24:40, 28:44].any() and mask[:10].all() and 0.3 < mask.mean() < 0.8
