# SPDX-License-Identifier: GPL-3.0-or-later
"""Schedule of the first stage: degrees, rays and weights by the number of steps done."""

import math
from dataclasses import replace

from irgspp.core.settings.schema import FirstStageSettings
from irgspp.core.stages.first.schedule import OPEN_EDGE_DISAGREEMENT, anchors_due, loss_weights, rays_per_side, sh_degree

TEN = replace(FirstStageSettings(), iterations=10, sh_growth=0.6, single_rays=0.4, subpixels=2, open_edges=0.5)


def test_degrees_grow_to_three():
    assert [sh_degree(TEN, done) for done in range(10)] == [0, 0, 1, 1, 2, 2, 3, 3, 3, 3]
    assert sh_degree(replace(TEN, sh_growth=0.0), 0) == 3


def test_first_part_renders_single_rays():
    assert [rays_per_side(TEN, done) for done in range(10)] == [1] * 4 + [2] * 6


def test_edges_are_open_in_the_first_part():
    weights = [loss_weights(TEN, done) for done in range(10)]
    assert [one.edge for one in weights] == [OPEN_EDGE_DISAGREEMENT] * 5 + [math.inf] * 5
    assert {(one.mask, one.normal) for one in weights} == {(TEN.mask_weight, TEN.normal_weight)}
    assert loss_weights(replace(TEN, open_edges=0.0), 0).edge == math.inf


def test_anchors_come_after_the_first_steps():
    assert [anchors_due(TEN, done) for done in range(10)] == [False] * 3 + [True] * 7
    assert not anchors_due(replace(TEN, anchor_weight=0.0), 9)
