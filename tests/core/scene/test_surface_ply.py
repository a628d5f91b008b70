# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface as a PLY file: written and read back, missing, and damaged."""

import numpy as np
import pytest
import trimesh
from irgspp.core.errors import InputError
from irgspp.core.scene.surface import Surface
from irgspp.core.scene.surface_ply import load_surface_ply, save_surface_ply


@pytest.fixture
def ball() -> Surface:
    body = trimesh.creation.icosphere(2)
    return Surface(np.array(body.vertices), np.array(body.vertices), np.array(body.faces), 0.0123)


def test_what_is_written_is_read(ball, tmp_path):
    save_surface_ply(ball, tmp_path / "fine_surface.ply")
    read = load_surface_ply(tmp_path / "fine_surface.ply")
    assert read is not None and read.voxel == ball.voxel
    np.testing.assert_array_equal(read.faces, ball.faces)
    for name in ("vertices", "normals"):
        assert getattr(read, name) == pytest.approx(getattr(ball, name), abs=1e-7)


def test_other_programs_can_open_it(ball, tmp_path):
    save_surface_ply(ball, tmp_path / "fine_surface.ply")
    assert trimesh.load(tmp_path / "fine_surface.ply").area == pytest.approx(float(ball.areas().sum()), rel=1e-5)


def test_no_surface_is_no_file(ball, tmp_path):
    assert load_surface_ply(tmp_path / "fine_surface.ply") is None
    save_surface_ply(ball, tmp_path / "fine_surface.ply")
    save_surface_ply(None, tmp_path / "fine_surface.ply")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new"), [(b"obj_info voxel", b"obj_info pixel"), (b"float nx", b"float mx"), (b"element face", b"element fate")]
)
def test_a_file_that_lacks_something_is_named(ball, tmp_path, old, new):
    save_surface_ply(ball, tmp_path / "fine_surface.ply")
    data = (tmp_path / "fine_surface.ply").read_bytes()
    (tmp_path / "fine_surface.ply").write_bytes(data.replace(old, new))
    with pytest.raises(InputError, match=r"fine_surface\.ply: is not the surface of a run"):
        load_surface_ply(tmp_path / "fine_surface.ply")


def test_a_truncated_file_is_named(ball, tmp_path):
    save_surface_ply(ball, tmp_path / "fine_surface.ply")
    data = (tmp_path / "fine_surface.ply").read_bytes()
    (tmp_path / "fine_surface.ply").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=r"fine_surface\.ply"):
        load_surface_ply(tmp_path / "fine_surface.ply")
