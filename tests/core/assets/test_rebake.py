# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished run baked again: a sphere of known albedo, on its own mesh, on a new one and on an edited one."""

import json

import numpy as np
import pytest
import trimesh
from baked_sphere import albedo_at, albedo_error, tiles_on_disk, unwrapped
from irgspp.core.assets import rebake
from irgspp.core.assets.rebake import bake
from irgspp.core.cli.main import main
from irgspp.core.errors import Cancelled, InputError, IrgsppError
from irgspp.core.io.file_lock import FileLock
from irgspp.core.machine import cpu_memory, disk_space
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.mesh_ply import load_mesh_ply, save_mesh_ply
from irgspp.core.scene.textures import load_textures
from irgspp.core.surface.mesh_texels import mesh_texels


def test_size_changes_the_images_and_nothing_else(run):
    before = (run / "mesh.ply").read_bytes()
    bake(run, Silent(), size=128)
    assert (run / "mesh.ply").read_bytes() == before
    sizes = {name: len(texture) for name, texture in load_textures(run / "textures").items()}
    assert sizes == dict.fromkeys(("albedo", "roughness", "metallic", "normal", "confidence"), 128)
    assert albedo_error(run) < 0.01
    assert int(trimesh.load(run / "asset.glb").geometry["object"].visual.material.baseColorTexture.height) == 128
    assert load_textures(run / "textures")["confidence"].mean() > 128  # fourteen cameras all around
    state = json.loads((run / "run.json").read_text())
    assert state["status"] == "done"
    assert state["baked"] == {"texture": 128, "bits": 8, "triangles": 1024, "mesh": None, "quads": None}
    assert state["textures"]["size"] == state["textures"]["baked"] == 128
    assert 0.02 < state["textures"]["texel"] < 0.05  # 12.6 units of area on the chart's 128 * 123 texels
    assert not (run / "bake.part").exists() and not (run / "scene.blend").exists()


def test_bits_stay_until_others_are_asked_for(run):
    bake(run, Silent(), size=64, bits=16)
    deep = load_textures(run / "textures")
    assert {name for name, texture in deep.items() if texture.dtype == np.uint16} == {"albedo", "roughness", "metallic", "normal"}
    assert len(np.unique(deep["normal"])) > 256
    shown = trimesh.load(run / "asset.glb").geometry["object"].visual.material.baseColorTexture
    assert shown.mode == "RGB" and np.abs(np.asarray(shown) - deep["albedo"] / 257).max() <= 0.51
    bake(run, Silent(), size=32)  # made from the bake
    assert load_textures(run / "textures")["normal"].dtype == np.uint16 and (run / "textures" / "baked").is_dir()
    bake(run, Silent())
    assert load_textures(run / "textures")["normal"].dtype == np.uint16
    bake(run, Silent(), size=32, bits=8)  # a smaller size, but not from a bake of other bits
    assert load_textures(run / "textures")["normal"].dtype == np.uint8 and not (run / "textures" / "baked").exists()
    assert json.loads((run / "run.json").read_text())["baked"]["bits"] == 8


def files(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*.png")}


def test_smaller_sizes_are_made_from_the_bake_and_back(run, monkeypatch):
    bake(run, Silent(), size=256)
    full, glb = load_textures(run / "textures"), (run / "asset.glb").read_bytes()
    monkeypatch.setattr(rebake, "_bake", None)  # nothing is baked from here on
    for size in (64, 128, 32):
        bake(run, Silent(), size=size)
        assert {len(texture) for texture in load_textures(run / "textures").values()} == {size}
        assert {len(texture) for texture in load_textures(run / "textures" / "baked").values()} == {256}
        assert int(trimesh.load(run / "asset.glb").geometry["object"].visual.material.baseColorTexture.height) == size
        assert albedo_error(run) < 0.015
        state = json.loads((run / "run.json").read_text())["textures"]
        assert (state["size"], state["baked"]) == (size, 256) and "which textures/baked keeps" in state["why"]
    bake(run, Silent(), size=256)
    again = load_textures(run / "textures")
    assert all(np.array_equal(again[name], full[name]) for name in full) and (run / "asset.glb").read_bytes() == glb
    assert not (run / "textures" / "baked").exists()
    state = json.loads((run / "run.json").read_text())["textures"]
    assert (state["size"], state["baked"], state["why"]) == (256, 256, "as baked")


def test_another_bake_replaces_the_kept_one(run):
    bake(run, Silent(), size=128)
    bake(run, Silent(), size=32)
    bake(run, Silent(), size=160)
    assert not (run / "textures" / "baked").exists() and len(load_textures(run / "textures")["albedo"]) == 160
    bake(run, Silent(), size=32)
    bake(run, Silent(), triangles=600)  # as large as the last bake
    assert not (run / "textures" / "baked").exists() and len(load_textures(run / "textures")["albedo"]) == 160


def test_a_stopped_change_of_size_leaves_the_textures(run):
    bake(run, Silent(), size=128)
    before = files(run)
    with pytest.raises(Cancelled):
        bake(run, Stopped(), size=32)
    assert files(run) == before


def test_textures_that_do_not_fit_are_refused_before_the_work(run, monkeypatch, capsys):
    before = files(run)
    monkeypatch.setattr(rebake, "_bake", None)
    monkeypatch.setattr(cpu_memory, "free_memory", lambda: cpu_memory.FreeMemory(3 << 30, "a test"))
    assert main(["bake", str(run), "--size", "16k"]) == 2
    message = capsys.readouterr().err
    assert "textures of 16384 texels need about" in message and "GiB are available (a test)" in message and message.count("\n") == 1
    monkeypatch.setattr(cpu_memory, "free_memory", lambda: cpu_memory.FreeMemory(1 << 50, "a test"))
    monkeypatch.setattr(disk_space, "free_disk_space", lambda run: 10_000_000)
    assert main(["bake", str(run), "--size", "16k"]) == 2
    message = capsys.readouterr().err
    assert "textures of 16384 texels need about 6.4 GB of disk space, of which 10 MB are free" in message and message.count("\n") == 1
    assert files(run) == before


def test_triangles_make_a_new_mesh(run):
    bake(run, Silent(), triangles=600)
    mesh = load_mesh_ply(run / "mesh.ply")
    assert 300 < len(mesh.faces) <= 600
    assert np.abs(np.linalg.norm(mesh.vertices, axis=-1) - 1).max() < 0.04  # surfels that were not fitted to images stick out a little
    assert np.abs(mesh.albedo - albedo_at(mesh.vertices)).mean() < 0.02 and albedo_error(run) < 0.02
    assert len(load_textures(run / "textures")["albedo"]) == 64  # as in the run's settings


def test_heights_lead_from_a_reduced_mesh_to_the_fused_surface(run):
    bake(run, Silent(), triangles=200, size=128, height=True)
    state, heights = json.loads((run / "run.json").read_text())["height"], load_textures(run / "textures")["height"]
    mesh = load_mesh_ply(run / "mesh.ply")
    texels = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, 128)
    place, normal = (texels.interpolate(values, mesh.faces) for values in (mesh.vertices, mesh.normals))
    height = state["scale"] * (heights.ravel()[texels.index] / 65535 - state["midlevel"])
    raised = place + height[:, None] * normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    spread, raised_spread = (np.linalg.norm(points, axis=-1).std() for points in (place, raised))  # flat faces of a ball have one
    assert raised_spread < 0.5 * spread
    bake(run, Silent(), size=32)  # made from the bake
    assert load_textures(run / "textures")["height"].shape == (32, 32)
    assert json.loads((run / "run.json").read_text())["height"] == state
    bake(run, Silent(), size=160)  # without heights
    assert "height" not in load_textures(run / "textures") and json.loads((run / "run.json").read_text())["height"] is None


def test_mesh_that_is_not_reduced_has_no_heights(run, capsys):
    fused = "30000"  # triangles, more than the fusion gives
    assert main(["bake", str(run), "--triangles", fused, "--height"]) == 0
    assert "no height texture: the mesh has all the shape" in capsys.readouterr().err
    assert not (run / "textures" / "height.png").exists()


def test_edited_mesh_keeps_its_uvs(run, tmp_path):
    edited = unwrapped(1.01)
    save_mesh_ply(edited, tmp_path / "edited.ply")
    bake(run, Silent(), edited=tmp_path / "edited.ply", size=96)
    mesh = load_mesh_ply(run / "mesh.ply")
    order = np.lexsort(np.concatenate([edited.vertices, edited.uvs], -1).T)
    found = np.lexsort(np.concatenate([mesh.vertices, mesh.uvs], -1).T)
    assert np.array_equal(mesh.vertices[found], edited.vertices[order]) and np.array_equal(mesh.uvs[found], edited.uvs[order])
    assert albedo_error(run) < 0.01
    assert np.abs(mesh.albedo - albedo_at(mesh.vertices)).mean() < 0.01 and np.abs(mesh.roughness - 0.6).mean() < 0.01


def test_quads_of_a_polygon_mesh_are_kept(run, tmp_path):
    """A cube of quads without UVs: those that the unwrapping leaves whole stay quads."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
    polygons = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    lines = ["ply", "format ascii 1.0", "element vertex 8", *(f"property float {name}" for name in "xyz")]
    lines += ["element face 6", "property list uchar int vertex_indices", "end_header", *(" ".join(map(str, row)) for row in corners)]
    (tmp_path / "cube.ply").write_text("\n".join([*lines, *("4 " + " ".join(map(str, polygon)) for polygon in polygons)]) + "\n")
    bake(run, Silent(), edited=tmp_path / "cube.ply")
    mesh = load_mesh_ply(run / "mesh.ply")
    assert len(mesh.faces) == 12 and mesh.quads is not None and mesh.quads.sum() == 6


def test_run_is_remeshed_to_quads(run):
    with pytest.raises(IrgsppError, match=r"quads of .* where 300 are asked for; try another number, or bake --triangles first"):
        bake(run, Silent(), quads=300)  # the longitude 0 is an open border of this mesh
    bake(run, Silent(), triangles=1500)
    bake(run, Silent(), quads=300, size=96)
    mesh, state = load_mesh_ply(run / "mesh.ply"), json.loads((run / "run.json").read_text())["baked"]
    assert mesh.quads is not None and 150 < mesh.quads.sum() < 500 and 2 * mesh.quads.sum() == len(mesh.faces)
    assert state == {"texture": 96, "bits": 8, "triangles": len(mesh.faces), "mesh": None, "quads": 300}
    bake(run, Silent(), size=128)
    assert np.abs(np.linalg.norm(mesh.vertices, axis=-1) - 1).max() < 0.05
    assert albedo_error(run) < 0.02
    bake(run, Silent(), size=64, udim=2)
    tiled = load_mesh_ply(run / "mesh.ply")
    assert tiled.quads is not None and tiled.quads.sum() == mesh.quads.sum() and len(tiles_on_disk(run)) == 4
    bake(run, Silent(), quads=300)  # as many tiles as before
    again = load_mesh_ply(run / "mesh.ply")
    assert len(tiles_on_disk(run)) == 4 and again.quads is not None and 2 * again.quads.sum() == len(again.faces)
    assert albedo_error(run) < 0.02


def test_edited_mesh_without_uvs_is_unwrapped(run, tmp_path):
    trimesh.creation.icosphere(3).export(tmp_path / "ball.ply")
    bake(run, Silent(), edited=tmp_path / "ball.ply")
    mesh = load_mesh_ply(run / "mesh.ply")
    assert len(mesh.faces) == 1280 and np.ptp(mesh.uvs) > 0.5
    assert albedo_error(run) < 0.02


class Stopped(Silent):
    cancelled = True


@pytest.mark.parametrize("how", [{"triangles": 600}, {"size": 32}])
def test_stopped_work_leaves_the_run_as_it_was(run, how):
    before = {path.name: path.read_bytes() for path in run.rglob("*") if path.is_file() and path.name != ".lock"}
    with pytest.raises(Cancelled):
        bake(run, Stopped(), **how)
    after = {path.name: path.read_bytes() for path in run.rglob("*") if path.is_file() and path.name != ".lock"}
    assert after == before
    FileLock(run / ".lock").release()  # free again


def test_bad_options_are_refused_before_anything_is_done(run, tmp_path, capsys):
    save_mesh_ply(unwrapped(10.0), tmp_path / "far.ply")
    for options, words in [
        (["--size", "3"], "surface.texture"),
        (["--triangles", "5"], "surface.triangles"),
        (["--mesh", str(tmp_path / "none.ply")], "no such file"),
        (["--mesh", str(tmp_path / "far.ply")], "doesn't lie where the run's object is"),
        (["--mesh", "a.ply", "--triangles", "500"], "can't be combined with"),
        (["--quads", "500", "--triangles", "500"], "can't be combined with"),
        (["--quads", "5"], "--quads: 5 is too few; use 100 or more"),
    ]:
        assert main(["bake", str(run), *options]) == 2
        message = capsys.readouterr().err
        assert words in message and message.count("\n") == 1, message
    assert main(["bake", str(tmp_path)]) == 2


def test_run_in_use_or_unfinished_is_left_alone(run):
    lock = FileLock(run / ".lock")
    with pytest.raises(InputError, match="in use by another process"):
        bake(run, Silent())
    lock.release()
    state = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**state, "status": "running"}))
    with pytest.raises(InputError, match="not a finished run"):
        bake(run, Silent())
