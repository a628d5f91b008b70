# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks that were cut again, read back from the run folder."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.io.checkpoint import load_checkpoint, save_checkpoint
from irgspp.core.stages.phase_results import MASKS, PhaseResults


class Folder:
    """Run folder with checkpoints alone."""

    def __init__(self, path) -> None:
        self.path = path

    def load(self, name, restored):
        return load_checkpoint(self.path / "checkpoint" / f"{name}.pt", restored)


@pytest.fixture
def data(sphere_dataset, camera_ring):
    return sphere_dataset(camera_ring(4))


def results(folder, data, masks):
    save_checkpoint(folder / "checkpoint" / f"{MASKS}.pt", masks)
    return PhaseResults(Folder(folder), torch.device("cpu")).with_masks(data)


def test_views_get_their_masks_and_errors(tmp_path, data):
    masks = {view.name: (np.full_like(view.alpha, i / 8), float(i), i == 2) for i, view in enumerate(data.train)}
    found = results(tmp_path, data, masks)
    for i, (view, before) in enumerate(zip(found.train, data.train, strict=True)):
        assert view.name == before.name and view.mask_error == i and view.cut_by_colours == (i == 2) and view.colour is before.colour
        assert view.alpha.dtype == np.float32 and (view.alpha == np.float32(i / 8)).all()


def test_missing_and_foreign_masks_are_one_clear_line(tmp_path, data):
    with pytest.raises(InputError, match="has no masks"):
        PhaseResults(Folder(tmp_path), torch.device("cpu")).with_masks(data)
    masks = {view.name: (view.alpha, 1.0, True) for view in data.train}
    with pytest.raises(InputError, match="can't be read"):
        results(tmp_path, replace(data, train=[replace(data.train[0], name="another")]), masks)
    with pytest.raises(InputError, match="can't be read"):
        results(tmp_path, data, masks | {data.train[1].name: (np.zeros((2, 2), np.float32), 1.0, True)})
