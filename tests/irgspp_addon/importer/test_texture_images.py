# SPDX-License-Identifier: GPL-3.0-or-later
"""A run with UDIM tiles in Blender: files, UVs and colours are those of the one image, and so is its look in Cycles."""

import json
import shutil

import bpy
import numpy as np
import pytest
import sphere_run
from blender_side import read_image, write_sphere_run
from cycles_layers import glowing_inputs, render
from irgspp.core.errors import InputError
from irgspp.core.scene.camera import Camera, look_at
from irgspp.irgspp_addon.importer.edited_mesh import save_edited
from irgspp.irgspp_addon.importer.ply import read_ply
from irgspp.irgspp_addon.importer.scene_builder import import_run
from irgspp.irgspp_addon.importer.write_asset import write_asset
from irgspp.irgspp_addon.importer.write_blend import Extras, write_blend
from irgspp.irgspp_addon.world.light_to_world import world_from_map
from irgspp.panels.asset_words import texture_text
from relighting import see_through

NUMBERS = [1001, 1002, 1011, 1012]
SIZE = 256  # of all tiles together
EYE = Camera(56, 56, 70.0, 70.0, 28.0, 28.0, look_at((2.6, -1.8, 1.9), (0.0, 0.0, 1.0)))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_sphere_run(tmp_path_factory.mktemp("tiled") / "run", SIZE, tiles=2)


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_homefile(use_empty=True)


def tiled_images():
    return {image.name.partition(".")[0]: image for image in bpy.data.images if image.source == "TILED"}


def corner_uvs(thing):
    return np.array([data.uv for data in thing.data.uv_layers[0].data])


def look(thing, run, folder):
    """Render an object alone by Cycles under the run's light, linear premultiplied (H, W, 4)."""
    scene = bpy.context.scene
    for other in scene.objects:
        other.hide_render = other != thing
    scene.world = world_from_map(run / "environment.exr")
    see_through(scene, EYE, "eye")
    scene.cycles.device = "CPU"
    return render(scene, folder / "look.exr", 64)


@pytest.mark.parametrize("pack", [True, False])
def test_material_reads_tiles_through_scaled_uvs(run, pack):
    thing = import_run(run, pack=pack).mesh
    images = tiled_images()
    assert set(images) == {"albedo", "roughness", "metallic", "normal"}
    for image in images.values():
        assert [tile.number for tile in image.tiles] == NUMBERS
        assert sorted(packed.tile_number for packed in image.packed_files) == (NUMBERS if pack else [])
        assert image.colorspace_settings.name == ("sRGB" if image.name.startswith("albedo") else "Non-Color")
    elements = read_ply(run / "mesh.ply")
    stored = np.stack([elements["vertex"][name] for name in ("s", "t")], -1)[elements["face"]["vertex_indices"].reshape(-1)]
    np.testing.assert_allclose(corner_uvs(thing), 2 * stored, atol=1e-6)
    assert texture_text(thing) == "textures 4 x 128"


def test_tiles_have_the_colours_of_the_one_image_at_the_same_uvs(run):
    uvs = corner_uvs(import_run(run).mesh)
    whole = read_image(run / "textures" / "albedo.png")
    tiles = {number: read_image(run / "textures" / "udim" / f"albedo.{number}.png") for number in NUMBERS}
    column, row = np.floor(uvs).astype(int).T
    assert set(1001 + column + 10 * row) == set(NUMBERS)
    side = SIZE // 2
    across, up = ((uvs - np.floor(uvs)) * side).astype(int).T
    found = np.array([tiles[1001 + c + 10 * r][side - 1 - y, x] for c, r, x, y in zip(column, row, across, up, strict=True)])
    x, y = (uvs / 2 * SIZE).astype(int).T
    np.testing.assert_array_equal(found, whole[SIZE - 1 - y, x])
    assert found.std() > 0.1


def test_cycles_reads_the_right_albedo_from_the_tiles(run, tmp_path):
    thing = import_run(run).mesh
    thing.matrix_world = np.eye(4).tolist()
    scene = bpy.context.scene
    see_through(scene, EYE, "eye")
    layer = glowing_inputs(scene, thing.active_material, tmp_path)["Base Color"]
    ray = EYE.rays().astype(float)
    centre = np.array(EYE.centre) - [0, 0, 1]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ray @ centre
    root = along**2 - centre @ centre + 1
    point = centre + (-along - np.sqrt(np.maximum(root, 0)))[..., None] * ray
    inside = (root > 0) & (layer[..., 3] > 0.99)
    assert inside.sum() > 400
    assert np.abs(layer[..., :3] - sphere_run.materials(point)[0])[inside].max() < 0.02


def test_the_look_is_that_of_one_image(run, tmp_path):
    single = shutil.copytree(run, tmp_path / "single")
    (single / "run.json").unlink()
    looks = []
    for folder in (single, run):
        bpy.ops.wm.read_homefile(use_empty=True)
        thing = import_run(folder).mesh
        thing.matrix_world = np.eye(4).tolist()
        looks.append(look(thing, run, tmp_path))
    assert looks[0][..., :3].std() > 0.1 and np.abs(looks[0] - looks[1]).max() < 2e-3


def test_missing_tile_is_named(run, tmp_path):
    broken = shutil.copytree(run, tmp_path / "broken")
    (broken / "textures" / "udim" / "normal.1011.png").unlink()
    with pytest.raises(InputError, match=r"normal\.1011\.png: is missing"):
        import_run(broken)
    assert not bpy.data.objects


def test_blend_with_tiles_beside_it(run, tmp_path):
    stage, final = tmp_path / "stage", tmp_path / "ball.blend"
    shutil.copytree(run / "textures" / "udim", stage / "ball_textures")
    write_blend(run, stage / "ball.blend", extras=Extras(textures=stage / "ball_textures", final=final))
    for made in list(stage.iterdir()):
        made.rename(tmp_path / made.name)
    bpy.ops.wm.open_mainfile(filepath=str(final))
    images = tiled_images()
    assert {image.filepath for image in images.values()} == {f"//ball_textures/{name}.<UDIM>.png" for name in images}
    assert all(len(image.tiles) == 4 and tuple(image.size) == (SIZE // 2, SIZE // 2) for image in images.values())


def test_usd_names_tiles_by_relative_paths(run, tmp_path, monkeypatch):
    folder = tmp_path / "here"
    shutil.copytree(run / "textures" / "udim", folder / "ball_textures")
    job = {"run": str(run), "name": "ball", "textures": str(folder / "ball_textures"), "tiles": 2, "matrix": np.eye(4).tolist()}
    write_asset(job | {"pack": False, "lods": [], "hulls": None, "occlusion": False}, [folder / "ball.usda", folder / "ball.usdc"])
    text = (folder / "ball.usda").read_text()
    assert all(f"@ball_textures/{name}.<UDIM>.png@" in text for name in ("albedo", "roughness", "metallic", "normal"))
    assert not list(folder.rglob("*<UDIM>*"))  # no placeholder is left
    moved = folder.rename(tmp_path / "there")
    bpy.ops.wm.read_homefile(use_empty=True)
    monkeypatch.chdir(moved)  # where alone Blender's own importer looks for paths of tiles without ./; OpenUSD looks beside the file
    bpy.ops.wm.usd_import(filepath=str(moved / "ball.usdc"))
    images = tiled_images()
    assert set(images) == {"albedo", "roughness", "metallic", "normal"} and all(len(image.tiles) == 4 for image in images.values())


def test_edited_mesh_keeps_its_tiles(run):
    from irgspp.core.scene.edited_mesh import load_edited_mesh

    thing = import_run(run).mesh
    edited = load_edited_mesh(save_edited(bpy.context, thing, run))
    assert edited.tiles == 2 and edited.uvs.max() <= 1
    np.testing.assert_allclose(np.sort(edited.uvs[edited.faces].reshape(-1, 2), 0), np.sort(corner_uvs(thing) / 2, 0), atol=1e-6)
    assert json.loads((run / "run.json").read_text())["textures"]["tiles"] == edited.tiles
