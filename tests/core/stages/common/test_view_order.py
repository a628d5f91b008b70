# SPDX-License-Identifier: GPL-3.0-or-later
"""Shuffled epochs of the training views."""

import torch
from irgspp.core.stages.common.view_order import next_view


def test_each_view_comes_once_per_epoch_and_held_back_ones_never():
    held_back = torch.tensor([False, True, False, False, False])
    generator, order = torch.Generator().manual_seed(0), torch.zeros(0, dtype=torch.long)
    epochs = []
    for _ in range(3):
        epoch = []
        for _ in range(4):
            view, order = next_view(order, held_back, generator)
            epoch.append(view)
        assert sorted(epoch) == [0, 2, 3, 4]
        epochs.append(epoch)
    assert epochs[0] != epochs[1] or epochs[1] != epochs[2]
