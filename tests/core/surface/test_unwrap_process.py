# SPDX-License-Identifier: GPL-3.0-or-later
"""UV unwrapping in a child process."""

import numpy as np
import pytest
import trimesh
from irgspp.core.errors import Cancelled, IrgsppError
from irgspp.core.surface.meshing import Triangles
from irgspp.core.surface.unwrap import unwrap
from irgspp.core.surface.unwrap_process import MESH, UnwrapProcess


@pytest.fixture
def mesh():
    ball = trimesh.creation.icosphere(2)
    return Triangles(np.asarray(ball.vertices), np.asarray(ball.faces))


@pytest.fixture
def started(mesh, tmp_path):
    process = UnwrapProcess(mesh, 128, tmp_path / "run" / "unwrap")
    yield process
    process.close()


def test_result_is_that_of_this_process(mesh, started):
    for found, expected in zip(started.result(lambda: False), unwrap(mesh, 128), strict=True):
        np.testing.assert_array_equal(found, expected, strict=True)


def test_cancel_ends_the_wait_and_close_removes_the_files(started, tmp_path):
    with pytest.raises(Cancelled):
        started.result(lambda: True)
    folder = tmp_path / "run" / "unwrap"
    assert (folder / MESH).is_file()
    started.close()
    assert not folder.exists() and started._child.poll() is not None


def test_failure_of_the_child_is_an_error_with_its_last_line(tmp_path):
    process = UnwrapProcess(Triangles(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), 128, tmp_path)
    with pytest.raises(IrgsppError, match="UV unwrapping ended with status 1: ValueError"):
        process.result(lambda: False)
    process.close()
