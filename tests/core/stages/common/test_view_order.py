# SPDX-License-Identifier: GPL-3.0-or-later
"""Shuffled epochs of the training views."""

import torch
from irgspp.core.stages.common.view_order import next_view, shuffled_epochs


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


def test_shuffled_epochs_hold_each_view_once():
    order = shuffled_epochs(7, 24, torch.Generator().manual_seed(5))
    assert len(order) == 24 and all(sorted(order[k : k + 7]) == list(range(7)) for k in (0, 7, 14))
    assert order[:7] != order[7:14] and len(set(order[21:])) == 3
    assert order == shuffled_epochs(7, 24, torch.Generator().manual_seed(5)) and shuffled_epochs(7, 0, torch.Generator()) == []


def test_shuffled_epochs_are_those_of_the_generator():
    generator = torch.Generator().manual_seed(3)
    expected = torch.cat([torch.randperm(4, generator=generator) for _ in range(2)])
    assert shuffled_epochs(4, 8, torch.Generator().manual_seed(3)) == expected.tolist()
