# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources see the same points at a like scale and a helpful angle."""

from dataclasses import replace

import numpy as np
from irgspp.core.stereo.view_selection import choose_sources, choose_witnesses

POINTS = np.random.default_rng(0).normal(0, 0.4, (500, 3))


def test_neighbours_come_first(camera_arc):
    sources = choose_sources(camera_arc(12), POINTS, 3)
    assert all(len(own) == 3 and max(abs(i - k) for k in own) <= 3 for i, own in enumerate(sources))
    assert all(i not in own for i, own in enumerate(sources))


def test_cameras_that_look_away_have_no_sources(camera_arc):
    cameras = camera_arc(4)
    cameras[3] = replace(cameras[3], to_world=cameras[3].to_world @ np.diag([-1.0, 1.0, -1.0, 1.0]))
    sources = choose_sources(cameras, POINTS, 3)
    assert sources[3] == [] and all(3 not in own for own in sources) and all(len(own) == 2 for own in sources[:3])


def test_opposite_cameras_are_no_sources(camera_arc):
    camera = camera_arc(1)[0]
    behind = replace(camera, to_world=np.diag([-1.0, 1.0, -1.0, 1.0]) @ camera.to_world)
    assert choose_sources([camera, behind], POINTS, 3) == [[], []]


def test_coinciding_cameras_are_no_sources(camera_arc):
    camera = camera_arc(1)[0]
    assert choose_sources([camera, camera], POINTS, 3) == [[], []]


def test_no_points_no_sources(camera_arc):
    assert choose_sources(camera_arc(3), np.zeros((0, 3)), 3) == [[], [], []]


def test_like_scales_are_preferred(camera_arc):
    cameras = camera_arc(3)
    far = replace(cameras[0], to_world=cameras[0].to_world.copy())
    far.to_world[:3, 3] *= 4
    assert choose_sources([cameras[1], far, cameras[2]], POINTS, 1)[0] == [2]


def test_witnesses_are_sources_both_ways():
    assert choose_witnesses([[1], [2], [], [0]], 9) == [(1, 3), (2, 0), (1,), (0,)]
    assert choose_witnesses([[1, 2], [], []], 1) == [(1,), (0,), (0,)]
