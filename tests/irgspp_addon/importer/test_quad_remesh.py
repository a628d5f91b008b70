# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's mesh remeshed to quads by QuadriFlow, with UVs."""

import numpy as np
import pytest
from irgspp.irgspp_addon.importer.ply import read_ply
from irgspp.irgspp_addon.importer.quad_remesh import main


def test_sphere_becomes_quads_with_uvs_and_its_own_normals(run_folder, tmp_path):
    assert main([str(run_folder / "mesh.ply"), str(tmp_path / "quads.ply"), "400"]) == 0
    elements = read_ply(tmp_path / "quads.ply")
    vertex, face = elements["vertex"], elements["face"]
    quads = face["quad"].astype(bool)
    assert (quads == (np.arange(len(face)) % 2 == 0)).all() and 250 < quads.sum() < 600
    place, normal, uv = (np.stack([vertex[name] for name in names], -1) for names in ("xyz", ("nx", "ny", "nz"), "st"))
    assert np.abs(np.linalg.norm(place, axis=-1) - 1).max() < 0.03
    assert ((place * normal).sum(-1) > 0.97).all()
    corners = face["vertex_indices"]
    assert np.array_equal(uv[corners[::2, 0]], uv[corners[1::2, 0]]) and np.array_equal(uv[corners[::2, 2]], uv[corners[1::2, 1]])
    assert uv.min() >= 0 and uv.max() <= 1
    flat = uv[corners]
    sides = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = (sides[0][:, 0] * sides[1][:, 1] - sides[0][:, 1] * sides[1][:, 0]) / 2
    assert (area > 0).all() and 0.25 < area.sum() < 1  # none is mirrored


@pytest.mark.parametrize("damage", [b"", b"no ply"])
def test_file_that_is_no_mesh_is_refused_in_one_line(tmp_path, capsys, damage):
    (tmp_path / "mesh.ply").write_bytes(damage)
    assert main([str(tmp_path / "mesh.ply"), str(tmp_path / "quads.ply"), "400"]) == 2
    assert "mesh.ply" in capsys.readouterr().err and not (tmp_path / "quads.ply").exists()
