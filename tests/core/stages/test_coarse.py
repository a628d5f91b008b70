# SPDX-License-Identifier: GPL-3.0-or-later
"""A coarse start: few disks and small pictures, then all of them."""

import math
from copy import deepcopy

import numpy as np
import pytest
import torch
from irgspp.core.config import SkipSettings, preset
from irgspp.core.overrides import with_overrides
from irgspp.core.progress import Silent
from irgspp.core.stages.coarse import CHILDREN, SHARE, SHRINK, quartered, starts_coarse, thinned_out
from irgspp.core.stages.hull import initial_gaussians
from irgspp.core.stages.kind import COATED, LOW_GLOSS, METAL
from irgspp.core.stages.trainer import Trainer


@pytest.fixture
def start(sphere_dataset, camera_ring):
    return initial_gaussians(sphere_dataset(camera_ring(5, 32)), 401, np.random.default_rng(0))


def test_children_lie_in_their_parents_plane_around_its_middle(start):
    children = quartered(start)
    assert children.count == CHILDREN * start.count
    families = children.position.view(3, -1, CHILDREN)
    torch.testing.assert_close(families.mean(2), start.position, atol=1e-5, rtol=0)
    away = ((families - start.position[..., None]) * start.normals()[..., None]).sum(0)
    assert away.abs().max() < 1e-5
    assert len(families.flatten(1).T.unique(dim=0)) == children.count
    torch.testing.assert_close(children.log_scale[:, ::CHILDREN], start.log_scale - math.log(SHRINK))
    torch.testing.assert_close(children.sh[..., 1::CHILDREN], start.sh)


def test_few_disks_cover_what_all_do(start):
    few = thinned_out(start, 100, 0)
    assert few.count == 100
    area = lambda g: float(g.log_scale.sum(0).exp().sum())  # noqa: E731
    assert area(few) == pytest.approx(area(start), rel=0.02)


def test_the_schedule_turns_fine_at_its_share_and_a_checkpoint_knows(sphere_dataset, camera_ring, start):
    dataset = sphere_dataset(camera_ring(5, 32))
    settings = with_overrides(preset("draft"), ["reflective.iterations=10"]).reflective

    def trainer():
        return Trainer(dataset, settings, start, LOW_GLOSS, 0, 0, coarse=True)

    first = trainer()
    few = first.optimizer.gaussians.count
    assert few == math.ceil(start.count / CHILDREN)
    counts, states = [], []
    for _ in range(6):
        first.step()
        counts.append(first.optimizer.gaussians.count)
        states.append(deepcopy(first.state()))
    turn = int(SHARE * 10)
    assert counts == [few] * turn + [CHILDREN * few] * (6 - turn)
    for done in (2, 6):
        resumed = trainer()
        resumed.restore(states[done - 1])
        assert bool(resumed.small) == (done < turn)
        assert resumed._start == counts[done - 1]
    losses = [first.step() for _ in range(2)]
    assert [resumed.step() for _ in range(2)] == losses


def test_it_needs_metal_and_pictures_that_bear_it(sphere_dataset, camera_ring):
    small, large = sphere_dataset(camera_ring(3, 64)), sphere_dataset(camera_ring(3, 96))
    assert not starts_coarse(small, METAL, SkipSettings(), Silent())
    assert not starts_coarse(large, COATED, SkipSettings(), Silent())
    assert starts_coarse(large, METAL, SkipSettings(), Silent())
    assert starts_coarse(small, LOW_GLOSS, SkipSettings(coarse="on"), Silent())
    assert not starts_coarse(large, METAL, SkipSettings(coarse="off"), Silent())
