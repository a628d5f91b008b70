# SPDX-License-Identifier: GPL-3.0-or-later
"""The object's bounding sphere."""

import numpy as np
import pytest
from irgspp.core.scene.dataset import Bound


def test_a_bound_moves_with_a_similarity_of_the_world():
    """Turned by a quarter about Z, doubled and shifted."""
    similarity = np.array([[0, -2.0, 0, 1], [2, 0, 0, -3], [0, 0, 2, 0.5], [0, 0, 0, 1]])
    moved = Bound((1.0, 2.0, 3.0), 0.5).moved(similarity)
    assert moved.centre == pytest.approx((-3, -1, 6.5)) and moved.radius == pytest.approx(1.0)
    assert all(type(value) is float for value in (*moved.centre, moved.radius))  # plain, for JSON files
