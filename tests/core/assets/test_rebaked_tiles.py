# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished run baked again in UDIM tiles."""

import dataclasses
import json

import numpy as np
import pytest
from baked_sphere import albedo_error, tiles_on_disk, unwrapped
from irgspp.core.assets.rebake import bake
from irgspp.core.cli.main import main
from irgspp.core.errors import InputError
from irgspp.core.machine import cpu_memory
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.mesh_ply import load_mesh_ply, save_mesh_ply
from irgspp.core.scene.textures import load_textures
from PIL import Image


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
