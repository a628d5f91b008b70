# SPDX-License-Identifier: GPL-3.0-or-later
"""Minimum cuts of single views: a part of the table's colours is found where only the room can be behind it."""

import numpy as np
from irgspp.core.capture.background_evidence import beyond_plane
from irgspp.core.capture.colour_model import lab_bins
from irgspp.core.capture.segmentation import Cutout, cut, edge_weight, learn_colours
from irgspp.core.scene.camera import Camera, look_at
from patterned_table import BOUND, PLANE, on_table

ROOM, TABLE, BODY = (0.1, 0.3, 0.2), (0.5, 0.35, 0.2), (0.2, 0.4, 0.8)
SIDE, HORIZON = 60, 30  # pixels: the room is above, the table below


def view():
    """A blue body over the horizon with a handle of the table's colour above it; the crop and both parts (SIDE, SIDE) bool."""
    body, handle = np.zeros((2, SIDE, SIDE), bool)
    body[22:45, 20:40], handle[8:22, 27:33] = True, True
    colour = np.where(np.arange(SIDE)[:, None, None] < HORIZON, np.float32(ROOM), np.float32(TABLE)) + np.zeros((SIDE, SIDE, 3), np.float32)
    colour[body], colour[handle] = BODY, TABLE
    colour = np.clip(colour + 0.01 * np.random.default_rng(0).normal(size=colour.shape), 0, 1).astype(np.float32)
    seed = np.zeros((SIDE, SIDE), np.int8)
    return Cutout((0, 0, SIDE, SIDE), colour, lab_bins(colour), seed, edge_weight(colour)), body, handle


def test_a_part_of_the_tables_colours_is_found_before_the_room():
    cutout, body, handle = view()
    room = np.broadcast_to(np.arange(SIDE)[:, None] < HORIZON, (SIDE, SIDE))
    sure = np.where(body, 1, np.where(handle, 0, -1)).astype(np.float32)
    prior = np.where(body, 0.9, np.where(handle, 0.7, 0.1)).astype(np.float32)
    for beyond, found in ((room, True), (np.zeros_like(room), False)):
        model = learn_colours([cutout], [sure], [beyond], 12.0)[0]
        mask = cut(cutout, model, beyond, prior, 1.0, prior) > 0.5
        assert (mask[handle].mean() > 0.9) == found
        assert mask[body].mean() > 0.95 and mask[~body & ~handle].mean() < 0.05


def test_only_unknown_pixels_away_from_the_foot_are_beyond_the_plane():
    camera = Camera(SIDE, SIDE, 50.0, 50.0, 30.0, 30.0, look_at((2.0, 0, 0.5), (0, 0, 0.3)))
    evidence = np.zeros((SIDE, SIDE), np.float32)
    evidence[:, :10] = 1.0  # the table's texture is known at the left
    found = beyond_plane(evidence, camera, PLANE, BOUND)
    x, y = on_table(camera)
    near = (camera.rays()[..., 2] < -1e-3) & (np.hypot(x, y) < BOUND.radius)
    assert near[:, 10:].any() and (found == ((evidence == 0) & ~near)).all()
