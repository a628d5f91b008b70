# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished run baked again: a sphere of known albedo, on its own mesh, on a new one and on an edited one."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch
import trimesh
from irgspp.core.assets import rebake
from irgspp.core.assets.rebake import bake
from irgspp.core.cli.main import main
from irgspp.core.errors import Cancelled, InputError, IrgsppError
from irgspp.core.io.file_lock import FileLock
from irgspp.core.machine import cpu_memory, disk_space
from irgspp.core.progress.protocol import Silent
from irgspp.core.run_folder import RunFolder
from irgspp.core.scene.camera_files import save_views
from irgspp.core.scene.dataset import Bound, View
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.mesh_ply import load_mesh_ply, save_mesh_ply
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.textures import load_textures, save_textures
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.first.initialization import surfels
from irgspp.core.surface.mesh_texels import mesh_texels
from PIL import Image

SETTINGS = with_overrides(Settings(), ["surface.voxels=40", "surface.triangles=1500", "surface.texture=64"])


def albedo_at(points):
    """Return the albedo (P, 3) at points (P, 3): reddish above, bluish below."""
    share = 1 / (1 + np.exp(-6 * points[:, 2:] / np.linalg.norm(points, axis=-1, keepdims=True)))
    return 0.2 + 0.5 * np.concatenate([share, 0 * share + 0.4, 1 - share], -1)


def ball(count=12_000):
    z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * 2.39996322972865
    normal = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
    gaussians = surfels(normal, normal, np.full((count, 3), 0.5), np.full(count, np.sqrt(4 * np.pi / count)), 0.99)
    values = np.concatenate([albedo_at(normal), np.full((count, 1), 0.6), np.full((count, 1), 0.01)], -1)
    gaussians.material = torch.logit(torch.from_numpy(values.T.copy()).float())
    return Reconstruction(gaussians, torch.full((8, 16, 3), 0.5), Bound((0, 0, 0), 1.3), np.eye(4))


def unwrapped(scale=1.0):
    """Return the sphere as a mesh with a UV map of longitude and latitude, split along the seam."""
    v, u = np.meshgrid(np.linspace(0.02, 0.98, 17), np.linspace(0, 1, 33), indexing="ij")
    theta, phi = (1 - v) * np.pi, u * 2 * np.pi
    normal = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3).astype(np.float32)
    a = (np.arange(16)[:, None] * 33 + np.arange(32)).reshape(-1)
    faces = np.concatenate([np.stack([a, a + 1, a + 34], -1), np.stack([a, a + 34, a + 33], -1)]).astype(np.int32)
    n = len(normal)
    grey, half = np.full((n, 3), 0.5, np.float32), np.full(n, 0.5, np.float32)
    uvs = np.stack([u, v], -1).reshape(-1, 2).astype(np.float32)
    textures = {name: np.zeros((8, 8), np.uint8) for name in ("roughness", "metallic")}
    return Mesh(scale * normal, normal, uvs, faces, grey, half, half, textures)


@pytest.fixture(scope="module")
def finished(tmp_path_factory, camera_ring):
    folder = RunFolder.open(tmp_path_factory.mktemp("finished") / "run", SETTINGS, "nowhere")
    with folder.job():
        ball().save(folder.path)
        save_mesh_ply(unwrapped(), folder.path / "mesh.ply")
        save_textures(unwrapped().textures, folder.path / "textures")
        views = [View(str(i), camera, folder.path / "none.png", np.empty((0, 0, 3)), None) for i, camera in enumerate(camera_ring(14))]
        save_views(folder.path / "cameras.json", [("train", view) for view in views[:-1]] + [("test", views[-1])])
    folder.close()
    return folder.path


@pytest.fixture
def run(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "run")


def albedo_error(run):
    """Return the mean difference between the albedo texture and the true albedo at each texel, linear."""
    mesh, texture = load_mesh_ply(run / "mesh.ply"), load_textures(run / "textures")["albedo"] / 255.0
    texels = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, len(texture))
    linear = np.where(texture <= 0.04045, texture / 12.92, ((texture + 0.055) / 1.055) ** 2.4).reshape(-1, 3)[texels.index]
    return np.abs(linear - albedo_at(texels.interpolate(mesh.vertices, mesh.faces))).mean()


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


def tiles_on_disk(run):
    return sorted(path.name for path in (run / "textures" / "udim").glob("albedo.*.png"))


def test_tiles_are_baked_resized_and_dropped_again(run):
    before = load_mesh_ply(run / "mesh.ply")
    bake(run, Silent(), size=128, udim=2)
    mesh, whole = load_mesh_ply(run / "mesh.ply"), load_textures(run / "textures")
    assert {len(texture) for texture in whole.values()} == {256} and albedo_error(run) < 0.01  # one image of all tiles
    assert mesh.uvs.min() > 0 and mesh.uvs.max() < 1 and len(mesh.faces) == len(before.faces)
    assert {tuple(v) for v in mesh.vertices.tolist()} == {tuple(v) for v in before.vertices.tolist()}  # the shape stays
    assert tiles_on_disk(run) == [f"albedo.{number}.png" for number in (1001, 1002, 1011, 1012)]
    tile = load_textures(run / "textures" / "udim")  # no file without a number
    assert not tile
    state = json.loads((run / "run.json").read_text())["textures"]
    assert (state["tiles"], state["size"], state["baked"]) == (2, 128, 128)
    bake(run, Silent(), size=32)  # made from the bake: tiles of 32 texels
    assert load_mesh_ply(run / "mesh.ply").uvs.tolist() == mesh.uvs.tolist()
    assert {len(texture) for texture in load_textures(run / "textures").values()} == {64} and albedo_error(run) < 0.02
    assert not (run / "textures" / "baked" / "udim").exists() and len(tiles_on_disk(run)) == 4
    bake(run, Silent(), size=128)
    again = load_textures(run / "textures")
    assert all(np.array_equal(again[name], whole[name]) for name in whole)
    bake(run, Silent(), udim=1)
    assert not (run / "textures" / "udim").exists() and len(load_textures(run / "textures")["albedo"]) == 128
    assert json.loads((run / "run.json").read_text())["textures"]["tiles"] == 1


def test_tile_files_are_parts_of_the_one_image(run):
    bake(run, Silent(), size=64, udim=3)
    whole, folder = load_textures(run / "textures")["albedo"], run / "textures" / "udim"
    for row in range(3):
        for column in range(3):
            tile = np.asarray(Image.open(folder / f"albedo.{1001 + column + 10 * row}.png"))
            np.testing.assert_array_equal(tile, whole[64 * (2 - row) : 64 * (3 - row), 64 * column : 64 * (column + 1)])


def test_uvs_of_an_edited_mesh_decide_on_its_tiles(run, tmp_path):
    mesh = unwrapped()
    save_mesh_ply(dataclasses.replace(mesh, uvs=2 * mesh.uvs), tmp_path / "edited.ply")
    with pytest.raises(InputError, match=r"--udim: 3 asks for other tiles than the UVs of .* have, which lie in 2 x 2; leave it out"):
        bake(run, Silent(), edited=tmp_path / "edited.ply", udim=3)
    bake(run, Silent(), size=64, edited=tmp_path / "edited.ply")
    assert len(load_textures(run / "textures")["albedo"]) == 128 and len(tiles_on_disk(run)) == 4
    assert albedo_error(run) < 0.015
    np.testing.assert_allclose(np.sort(load_mesh_ply(run / "mesh.ply").uvs, 0), np.sort(mesh.uvs, 0), atol=1e-6)


def test_tiles_that_are_too_large_together_are_refused(run, monkeypatch, capsys):
    assert main(["bake", str(run), "--size", "8k", "--udim", "4"]) == 2
    assert "4 x 4 tiles of 8192 texels are more than 16384 texels along a side; choose fewer tiles" in capsys.readouterr().err
    monkeypatch.setattr(cpu_memory, "free_memory", lambda: cpu_memory.FreeMemory(1 << 30, "free on this machine"))
    assert main(["bake", str(run), "--size", "4k", "--udim", "2"]) == 2
    assert "textures of 8192 texels need about" in capsys.readouterr().err
    assert not (run / "textures" / "udim").exists()
