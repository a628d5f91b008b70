# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished run to bake again."""

import shutil

import pytest
from baked_sphere import write_finished_run


@pytest.fixture(scope="module")
def finished(tmp_path_factory, camera_ring):
    return write_finished_run(tmp_path_factory.mktemp("finished") / "run", camera_ring(14))


@pytest.fixture
def run(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "run")
