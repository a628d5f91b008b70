# SPDX-License-Identifier: GPL-3.0-or-later
"""File of an object's surroundings."""

import numpy as np
import pytest
from irgspp.core.errors import InputError
from irgspp.core.scene.surroundings import Surroundings, load_surroundings, save_surroundings


def points(count=5, **changes):
    arrays = {name: np.random.default_rng(0).random((count, 3), np.float32) for name in ("position", "normal", "radiance")}
    return Surroundings(**{**arrays, "spacing": np.full(count, 0.1, np.float32), **changes})


def test_round_trip(tmp_path):
    save_surroundings(points(), tmp_path / "around.npz")
    found = load_surroundings(tmp_path / "around.npz")
    for name, value in vars(points()).items():
        np.testing.assert_array_equal(getattr(found, name), value)


@pytest.mark.parametrize(
    "changes",
    [
        {"normal": np.zeros((4, 3), np.float32)},
        {"radiance": np.full((5, 3), -1, np.float32)},
        {"position": np.full((5, 3), np.nan, np.float32)},
        {"spacing": np.zeros(5, np.float32)},
        {"spacing": np.ones((5, 1), np.float32)},
    ],
)
def test_damaged_files_are_refused(tmp_path, changes):
    save_surroundings(points(**changes), tmp_path / "around.npz")
    with pytest.raises(InputError, match=r"around\.npz"):
        load_surroundings(tmp_path / "around.npz")


def test_surroundings_move_with_a_similarity_of_the_world():
    """Turned by a quarter about Z, doubled and shifted."""
    similarity = np.array([[0, -2.0, 0, 1], [2, 0, 0, -3], [0, 0, 2, 0.5], [0, 0, 0, 1]])
    here, there = points(), points().moved(similarity)
    x, y, z = here.position.T
    np.testing.assert_allclose(there.position, np.stack([1 - 2 * y, 2 * x - 3, 2 * z + 0.5], -1), rtol=1e-6)
    np.testing.assert_allclose(there.normal, here.normal[:, (1, 0, 2)] * (-1, 1, 1), rtol=1e-6)
    np.testing.assert_allclose(there.spacing, 0.2, rtol=1e-6)
    np.testing.assert_array_equal(there.radiance, here.radiance)
    assert {array.dtype for array in vars(there).values()} == {np.dtype(np.float32)}


def test_truncated_file(tmp_path):
    save_surroundings(points(), tmp_path / "around.npz")
    (tmp_path / "around.npz").write_bytes((tmp_path / "around.npz").read_bytes()[:200])
    with pytest.raises(InputError, match="can't be read"):
        load_surroundings(tmp_path / "around.npz")
