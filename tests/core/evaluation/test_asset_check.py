# SPDX-License-Identifier: GPL-3.0-or-later
"""Check of an asset: a clean mesh passes, and each kind of defect, made on purpose, is found and counted."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from irgspp.core.cli.main import main
from irgspp.core.evaluation.asset_check import asset_lines, asset_report
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.mesh_ply import save_mesh_ply
from irgspp.core.scene.textures import save_textures
from irgspp.core.surface.meshing import Triangles, vertex_normals
from irgspp.core.surface.unwrap import unwrap

TEXTURES = {name: np.zeros((256, 256), np.uint8) for name in ("albedo", "roughness", "metallic", "normal", "confidence")}

VALUES = ("normals", "albedo", "roughness", "metallic", "uvs")  # of the vertices


def unwrapped(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Return the mesh with UVs by xatlas."""
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces)
    source, split, uvs = unwrap(Triangles(vertices, faces), 256)
    normals = vertex_normals(Triangles(vertices, faces))[source].astype(np.float32)
    grey = np.full((len(source), 3), 0.5, np.float32)
    return Mesh(vertices[source].astype(np.float32), normals, uvs, split, grey, grey[:, 0], grey[:, 0])


def ball(subdivisions: int = 3) -> tuple[np.ndarray, np.ndarray]:
    body = trimesh.creation.icosphere(subdivisions)
    return np.array(body.vertices), np.array(body.faces)


def defects(mesh: Mesh, textures: dict[str, np.ndarray] = TEXTURES) -> dict[str, int]:
    """Return the number of defects by the name of the check, without those that passed."""
    return {check["name"]: check["defects"] for check in asset_report(mesh, textures)["checks"] if check["defects"]}


@pytest.fixture(scope="module")
def clean() -> Mesh:
    return unwrapped(*ball())


def test_clean_mesh_has_no_defects(clean):
    report = asset_report(clean, TEXTURES)
    assert report["defects"] == 0, asset_lines(report)
    assert report["geometry"]["vertices"] == 642 and report["geometry"]["faces"] == 1280
    assert np.allclose(report["geometry"]["component_areas"], [1]) and abs(report["geometry"]["area"] / (4 * np.pi) - 1) < 0.02
    assert "watertight" in asset_lines(report) and asset_lines(report).endswith("\n0 defects")


def test_density_is_in_texels_per_unit(clean):
    low, median, high = asset_report(clean, TEXTURES)["uvs"]["density"]
    covered = asset_report(clean, TEXTURES)["uvs"]["covered"] * 256**2
    assert abs(median / np.sqrt(covered / (4 * np.pi)) - 1) < 0.05 and 0.7 * median < low < high < 1.4 * median


def test_fin_on_an_edge_is_not_manifold(clean):
    a, b, _ = clean.faces[0]
    tip = len(clean.vertices)
    fin = with_vertices(clean, clean.vertices[[a]] * 1.2, [[a, b, tip]])
    assert defects(fin)["manifold edges"] == 1


def with_vertices(mesh: Mesh, points: np.ndarray, faces: list[list[int]]) -> Mesh:
    """Return the mesh with further vertices, whose other values are those of the first vertex, and faces."""
    values = {name: np.concatenate([getattr(mesh, name), np.repeat(getattr(mesh, name)[:1], len(points), 0)]) for name in VALUES}
    vertices = np.concatenate([mesh.vertices, np.asarray(points, np.float32)])
    return replace(mesh, vertices=vertices, faces=np.concatenate([mesh.faces, np.array(faces, np.int32).reshape(-1, 3)]), **values)


def test_parts_that_touch_at_a_point_are_not_manifold():
    vertices, faces = ball(2)
    other = vertices + np.array([2.0, 0, 0])
    touching = np.argmin(np.linalg.norm(vertices - [1, 0, 0], axis=-1)), np.argmin(np.linalg.norm(other - [1, 0, 0], axis=-1))
    other += vertices[touching[0]] - other[touching[1]]
    other[touching[1]] = vertices[touching[0]]
    mesh = unwrapped(np.concatenate([vertices, other]), np.concatenate([faces, faces + len(vertices)]))
    found = defects(mesh)
    assert found.pop("manifold vertices") == 1 and not found


def test_hole_is_told_from_an_open_end(clean):
    report = asset_report(replace(clean, faces=clean.faces[1:]), TEXTURES)
    assert (report["geometry"]["holes"], report["geometry"]["borders"], report["geometry"]["border_edges"]) == (1, 0, 3)
    upper = clean.vertices[clean.faces].mean(1)[:, 2] > 0
    report = asset_report(replace(clean, faces=clean.faces[upper]), TEXTURES)
    assert (report["geometry"]["holes"], report["geometry"]["borders"]) == (0, 1)
    assert "1 open ends" in asset_lines(report)


def test_floater_is_found_and_a_second_part_is_none():
    vertices, faces = ball(2)
    for size, floaters in ((0.05, 1), (0.5, 0)):
        two = np.concatenate([vertices, size * vertices + 3])
        mesh = unwrapped(two, np.concatenate([faces, faces + len(vertices)]))
        assert defects(mesh).get("components", 0) == floaters


def test_flipped_faces_are_counted(clean):
    faces = clean.faces.copy()
    faces[[3, 400, 401, 900]] = faces[[3, 400, 401, 900], ::-1]
    found = defects(replace(clean, faces=faces))
    assert found["winding"] == 4 and found["folded faces"] == 4 and found["UV faces"] == 4


def test_part_inside_out_is_found(clean):
    assert defects(replace(clean, faces=clean.faces[:, ::-1]))["winding"] == 1


def test_face_folded_over_is_found():
    vertices, faces = ball()
    mesh = unwrapped(vertices, faces)
    corner = mesh.faces[100]
    middle = mesh.vertices[corner].mean(0)
    moved = mesh.vertices.copy()  # one corner is pushed across the opposite edge; normals stay as they were
    same = (mesh.vertices == mesh.vertices[corner[0]]).all(-1)
    moved[same] += 2.2 * (middle - mesh.vertices[corner[0]])
    assert defects(replace(mesh, vertices=moved))["folded faces"] >= 1


def test_faces_without_area_are_found(clean):
    vertices = clean.vertices.copy()
    a, b, c = clean.faces[50]
    for k in np.nonzero((clean.vertices == clean.vertices[c]).all(-1))[0]:
        vertices[k] = (clean.vertices[a] + clean.vertices[b]) / 2
    assert defects(replace(clean, vertices=vertices))["zero-area faces"] >= 1


def test_repeated_faces_and_vertices_are_found(clean):
    assert defects(replace(clean, faces=np.concatenate([clean.faces, clean.faces[:7]])))["repeated faces"] == 7
    assert defects(with_vertices(clean, clean.vertices[:1] + 1, []))["repeated vertices"] == 1
    near = np.float32(clean.vertices[clean.faces[0, 0]] * (1 + 3e-7))
    found = defects(with_vertices(clean, near[None], [[len(clean.vertices), *clean.faces[0, 1:]]]))
    assert found["repeated vertices"] == 2  # both of the pair


def rectangle(left: float, right: float) -> Mesh:
    """Return two triangles that fill the texture's width from `left` to `right`."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    uvs = np.array([[left, 0], [right, 0], [right, 1], [left, 1]], np.float32)
    grey, up = np.full((4, 3), 0.5, np.float32), np.repeat(np.float32([[0, 0, 1]]), 4, 0)
    return Mesh(square + 3 * np.float32(left), up, uvs, np.array([[0, 1, 2], [0, 2, 3]], np.int32), grey, grey[:, 0], grey[:, 0])


def test_overlap_of_charts_is_found_and_shared_borders_are_none():
    whole = rectangle(0, 1)
    assert asset_report(whole, TEXTURES)["uvs"]["overlap"] == 0 and asset_report(whole, TEXTURES)["uvs"]["covered"] > 0.999
    one, other = rectangle(0, 0.5), rectangle(0.4, 0.9)
    values = {name: np.concatenate([getattr(one, name), getattr(other, name)]) for name in (*VALUES, "vertices")}
    two = Mesh(faces=np.concatenate([one.faces, one.faces + 4]), **values)
    assert abs(asset_report(two, TEXTURES)["uvs"]["overlap"] - 0.1 / 0.9) < 0.01 and defects(two)["UV overlap"] > 0


def test_uvs_outside_or_without_area_or_mirrored_are_found(clean):
    uvs = clean.uvs.copy()
    uvs[7] = -0.1, 0.5
    assert defects(replace(clean, uvs=uvs))["UV range"] == 1
    uvs = clean.uvs.copy()
    uvs[clean.faces[9]] = uvs[clean.faces[9, 0]]
    assert defects(replace(clean, uvs=uvs))["UV faces"] >= 1
    mirrored = np.stack([1 - clean.uvs[:, 0], clean.uvs[:, 1]], -1)
    assert defects(replace(clean, uvs=mirrored))["UV faces"] == len(clean.faces)


def test_uneven_density_is_found(clean):
    shrunk = clean.uvs.copy()
    upper = np.unique(clean.faces[clean.vertices[clean.faces].mean(1)[:, 2] > 0.5])
    shrunk[upper] = 0.5 + 0.1 * (shrunk[upper] - 0.5)
    assert defects(replace(clean, uvs=shrunk))["texel density"] == 1


def test_missing_and_unequal_textures_are_found(clean):
    few = {name: texture for name, texture in TEXTURES.items() if name not in ("normal", "metallic")}
    assert defects(clean, few) == {"textures": 2}
    assert defects(clean, {**TEXTURES, "roughness": np.zeros((128, 128), np.uint8)}) == {"texture sizes": 1}


def test_command_prints_a_line_each_and_its_status_tells(clean, tmp_path, capsys):
    save_mesh_ply(clean, tmp_path / "mesh.ply")
    save_textures(TEXTURES, tmp_path / "textures")
    assert main(["evaluate", str(tmp_path), "--asset"]) == 0
    lines = capsys.readouterr().out.strip().splitlines()
    assert lines[-1] == "0 defects" and all(line.startswith("ok") for line in lines[:-1]) and len(lines) == 16
    report = json.loads((tmp_path / "evaluation" / "asset.json").read_text())
    assert report["defects"] == 0 and report["textures"]["albedo"] == 256
    (tmp_path / "textures" / "normal.png").unlink()
    assert main(["evaluate", str(tmp_path), "--asset", "-o", str(tmp_path / "report")]) == 1
    out = capsys.readouterr().out
    assert "DEFECT  textures" in out and "missing: normal" in out and out.strip().endswith("1 defect")
    assert json.loads((tmp_path / "report" / "asset.json").read_text())["defects"] == 1


def test_command_refuses_what_it_can_not_check(tmp_path, capsys):
    assert main(["evaluate", str(tmp_path), "--asset"]) == 2
    assert "mesh.ply: no such file" in capsys.readouterr().err
    assert main(["evaluate", str(tmp_path)]) == 2
    assert "--asset" in capsys.readouterr().err
