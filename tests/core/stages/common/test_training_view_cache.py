# SPDX-License-Identifier: GPL-3.0-or-later
"""Cache of training views: the views prepared first are kept, the others are prepared anew and are the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import View
from irgspp.core.stages.common.training_view import make_training_view
from irgspp.core.stages.common.training_view_cache import TrainingViewCache

SIDE = 16


def views(count: int) -> list[View]:
    random = np.random.default_rng(0)
    camera = Camera(SIDE, SIDE, SIDE, SIDE, SIDE / 2, SIDE / 2, np.eye(4))
    alpha = (random.random((SIDE, SIDE)) > 0.5).astype(np.float32)
    return [View(str(k), camera, Path(), random.random((SIDE, SIDE, 3)).astype(np.float32), alpha) for k in range(count)]


def test_first_views_stay_within_the_limit() -> None:
    photographs = views(4)
    one = make_training_view(photographs[0])
    assert one.size >= SIDE * SIDE * (3 * 4 + 4 + 3 + 2 * 3 * 4)
    cache = TrainingViewCache(photographs, memory=2 * one.size + one.size // 2)
    kept = [cache[k] is cache[k] for k in range(4)]
    assert kept == [True, True, False, False]


def test_views_are_the_same_kept_or_not() -> None:
    photographs = views(3)
    for memory in (0, 1 << 30):
        cache = TrainingViewCache(photographs, reduction=2, memory=memory)
        assert len(cache) == 3
        for view, photograph in zip(cache, photographs, strict=True):
            torch.testing.assert_close(view.image, make_training_view(photograph, 2).image, rtol=0, atol=0)
        assert [view.camera.width for view in cache[1:]] == [SIDE // 2] * 2
