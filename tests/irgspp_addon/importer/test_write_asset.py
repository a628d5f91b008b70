# SPDX-License-Identifier: GPL-3.0-or-later
"""The object in formats of other programs, read again by Blender from a folder that was moved: shape, UVs, normals, textures and look."""

import json
import shutil

import bpy
import numpy as np
import pytest
from cycles_layers import render
from gltf_validator import gltf_problems
from irgspp.core.errors import InputError
from irgspp.core.io.srgb import straight_srgb
from irgspp.core.scene.camera import Camera, look_at
from irgspp.irgspp_addon.importer import write_asset as writing
from irgspp.irgspp_addon.importer.ply import read_ply
from irgspp.irgspp_addon.importer.scene_builder import import_run
from irgspp.irgspp_addon.importer.write_blend import Extras, write_blend
from irgspp.irgspp_addon.world.light_to_world import world_from_map
from mathutils import Matrix
from relighting import see_through
from usd_validator import usd_problems

OFFSET = np.array([0.0, 0.0, 1.0])  # the sphere's foot is at -1
READERS = {
    "obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
    "fbx": lambda path: bpy.ops.import_scene.fbx(filepath=path),
    "glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    "usdc": lambda path: bpy.ops.wm.usd_import(filepath=path),
    "usdz": lambda path: bpy.ops.wm.usd_import(filepath=path),
}
INPUTS = ("Base Color", "Roughness", "Metallic", "Normal")


@pytest.fixture(scope="module")
def hulls(tmp_path_factory):
    file = tmp_path_factory.mktemp("hulls") / "hulls.npz"
    corners = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    faces = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    )
    np.savez(file, vertices0=corners, faces0=faces, vertices1=corners - 1, faces1=faces)
    return file


@pytest.fixture(scope="module")
def written(run_folder, hulls, tmp_path_factory):
    """Every format once, with levels of detail and hulls; then the folder is moved."""
    folder = tmp_path_factory.mktemp("written") / "here"
    shutil.copytree(run_folder / "textures", folder / "ball_textures")
    save_orm(folder / "ball_textures")
    job = {
        "run": str(run_folder),
        "name": "ball",
        "textures": str(folder / "ball_textures"),
        "tiles": 1,
        "matrix": np.array(Matrix.Translation(OFFSET)).tolist(),
    }
    job |= {"lods": [0.5, 0.25], "hulls": str(hulls), "pack": False, "occlusion": True}
    (folder / "job.json").write_text(json.dumps(job))
    targets = [str(folder / f"ball.{suffix}") for suffix in ("obj", "fbx", "glb", "usdc")]
    assert writing.main([str(folder / "job.json"), *targets]) == 0
    writing.write_asset({**job, "pack": True, "lods": [], "hulls": None}, [folder / "ball.usdz"])
    return folder.rename(folder.with_name("there"))


def save_orm(folder) -> None:
    """Write orm.png, red occlusion, green roughness, blue metallic, from the separate textures."""
    maps = {name: bpy.data.images.load(str(folder / f"{name}.png")) for name in ("roughness", "metallic")}
    packed = bpy.data.images.new("orm", *maps["roughness"].size, is_data=True)
    pixels = np.ones(len(packed.pixels), np.float32)
    for channel, image in enumerate(maps.values(), start=1):
        image.colorspace_settings.name = "Non-Color"
        pixels[channel::4] = np.array(image.pixels[:])[::4]
    packed.pixels.foreach_set(pixels)
    packed.file_format, packed.filepath_raw = "PNG", str(folder / "orm.png")
    packed.save()


def reread(folder, suffix):
    bpy.ops.wm.read_homefile(use_empty=True)
    READERS[suffix](str(folder / f"ball.{suffix}"))
    bpy.context.view_layer.update()
    return {thing.name: thing for thing in bpy.context.scene.objects if thing.type == "MESH"}


def corners(thing):
    """Return places, normals and UVs of the object's corners in the world, (F, 3, 3), (F, 3, 3) and (F, 3, 2), ordered by place."""
    mesh, matrix = thing.data, np.array(thing.matrix_world)
    assert all(len(polygon.vertices) == 3 for polygon in mesh.polygons)
    place = np.array([mesh.vertices[loop.vertex_index].co for loop in mesh.loops]) @ matrix[:3, :3].T + matrix[:3, 3]
    normal = np.array([normal.vector for normal in mesh.corner_normals]) @ np.linalg.inv(matrix[:3, :3])
    uv = np.array([data.uv for data in mesh.uv_layers[0].data])
    return ordered(place, normal / np.linalg.norm(normal, axis=-1, keepdims=True), uv)


def ordered(place, normal, uv):
    place, normal, uv = (np.asarray(values, float).reshape(-1, 3, values.shape[-1]) for values in (place, normal, uv))
    keys = place.mean(1).round(4)
    order = np.lexsort([*keys.T, *uv.mean(1).round(4).T])
    first = np.lexsort([place[..., k].round(4) for k in (2, 1, 0)], axis=-1)  # corners may begin anywhere
    place, normal, uv = (np.take_along_axis(values, first[..., None], 1) for values in (place, normal, uv))
    return place[order], normal[order], uv[order]


def of_run(run_folder):
    elements = read_ply(run_folder / "mesh.ply")
    vertex, faces = elements["vertex"], elements["face"]["vertex_indices"].reshape(-1)
    columns = [np.stack([vertex[name] for name in names], -1)[faces] for names in (("x", "y", "z"), ("nx", "ny", "nz"), ("s", "t"))]
    return ordered(columns[0] + OFFSET, *columns[1:])


def test_glb_of_blender_reads_occlusion_from_red(written):
    data = (written / "ball.glb").read_bytes()
    tree = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    material = next(one for one in tree["materials"] if one["name"] == "ball")
    assert material["occlusionTexture"]["index"] == material["pbrMetallicRoughness"]["metallicRoughnessTexture"]["index"]


def test_khronos_validator_finds_nothing(written):
    assert gltf_problems(written / "ball.glb") == []


@pytest.mark.parametrize("suffix", ["usdc", "usdz"])
def test_usd_validators_find_nothing(written, suffix):
    assert usd_problems(written / f"ball.{suffix}") == []


@pytest.mark.parametrize("suffix", READERS)
def test_shape_uvs_and_normals_come_back(written, run_folder, suffix):
    found = reread(written, suffix)
    full = found["ball" if suffix == "usdz" else "ball_LOD0"]
    place, normal, uv = corners(full)
    true_place, true_normal, true_uv = of_run(run_folder)
    np.testing.assert_allclose(place, true_place, atol=2e-5)
    np.testing.assert_allclose(uv, true_uv, atol=2e-5)
    assert np.degrees(np.arccos(np.clip((normal * true_normal).sum(-1), -1, 1))).max() < 0.5
    low = min((thing.matrix_world @ vertex.co).z for thing in [full] for vertex in thing.data.vertices)
    assert abs(low) < 1e-4  # it stands on its foot


@pytest.mark.parametrize("suffix", READERS)
def test_textures_are_found_after_the_move(written, suffix):
    found = reread(written, suffix)
    material = found["ball" if suffix == "usdz" else "ball_LOD0"].active_material
    (principled,) = [node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"]
    images = {name: image_before(principled.inputs[name]) for name in INPUTS}
    assert None not in images.values(), images
    assert all(tuple(image.size) == (128, 128) for image in images.values())
    assert images["Base Color"].colorspace_settings.name == "sRGB"
    if suffix != "obj":  # an .mtl names no colour space, and Blender takes grey images for sRGB
        assert {images[name].colorspace_settings.name for name in INPUTS[1:]} <= {"Non-Color", "Raw"}
    if suffix in ("obj", "fbx", "usdc"):
        paths = {bpy.path.abspath(image.filepath) for image in images.values()}
        assert all(path.startswith(str(written)) for path in paths) and len(paths) == 4


def image_before(socket):
    """Return the image that an input's links lead back to, or None."""
    for link in socket.links:
        node = link.from_node
        if node.bl_idname == "ShaderNodeTexImage":
            return node.image
        for before in node.inputs:
            if (image := image_before(before)) is not None:
                return image
    return None


def look(thing, run_folder, folder) -> np.ndarray:
    """Render an object alone by Cycles under the run's light, as sRGB (H, W, 3) over black."""
    scene = bpy.context.scene
    for other in scene.objects:
        other.hide_render = other != thing
    scene.world = world_from_map(run_folder / "environment.exr")
    see_through(scene, Camera(56, 56, 70.0, 70.0, 28.0, 28.0, look_at((2.6, -1.8, 1.9), OFFSET)), "eye")
    scene.cycles.device = "CPU"
    pixels = straight_srgb(render(scene, folder / "look.exr", 64))
    return pixels[..., :3] * pixels[..., 3:]


@pytest.fixture(scope="module")
def look_of_the_blend(run_folder, tmp_path_factory):
    bpy.ops.wm.read_homefile(use_empty=True)
    thing = import_run(run_folder).mesh
    thing.matrix_world = Matrix()
    return look(thing, run_folder, tmp_path_factory.mktemp("blend"))


@pytest.mark.parametrize("suffix", READERS)
def test_the_look_comes_back(written, look_of_the_blend, run_folder, tmp_path, suffix):
    """No format names the .blend's microfacet distribution, GGX of single scattering; Blender reads all as its own choice."""
    thing = reread(written, suffix)["ball" if suffix == "usdz" else "ball_LOD0"]
    (principled,) = [node for node in thing.active_material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"]
    if suffix == "obj":  # as the documentation says
        for name in INPUTS[1:]:
            image_before(principled.inputs[name]).colorspace_settings.name = "Non-Color"
    as_read = psnr(look(thing, run_folder, tmp_path), look_of_the_blend)
    principled.distribution = "GGX"
    same = psnr(look(thing, run_folder, tmp_path), look_of_the_blend)
    print(f"Blender {bpy.app.version_string}, .{suffix} read again: {as_read:.1f} dB, with the .blend's distribution {same:.1f} dB")
    assert look_of_the_blend.std() > 0.1 and as_read > 42 and same > 60


def psnr(image, reference) -> float:
    return float(-10 * np.log10(max(((image - reference).astype(float) ** 2).mean(), 1e-12)))


@pytest.mark.parametrize("suffix", [suffix for suffix in READERS if suffix != "usdz"])
def test_levels_share_the_material_and_hulls_are_named_for_engines(written, suffix):
    found = reread(written, suffix)
    assert sorted(found) == ["UCX_ball_LOD0_00", "UCX_ball_LOD0_01", "ball_LOD0", "ball_LOD1", "ball_LOD2"]
    count = [len(found[f"ball_LOD{i}"].data.polygons) for i in range(3)]
    assert abs(count[1] / count[0] - 0.5) < 0.02 and abs(count[2] / count[0] - 0.25) < 0.02
    assert len({found[f"ball_LOD{i}"].active_material.name for i in range(3)}) == 1
    assert not found["UCX_ball_LOD0_00"].data.materials or suffix == "obj"
    box = np.array([found["UCX_ball_LOD0_01"].matrix_world @ vertex.co for vertex in found["UCX_ball_LOD0_01"].data.vertices])
    np.testing.assert_allclose([box.min(0), box.max(0)], [[-1, -1, 0], [0, 0, 1]], atol=1e-5)


def test_levels_show_the_textures_where_the_full_mesh_does(written):
    """A level's UVs lead to the same place of the sphere: its longitude and latitude."""
    found = reread(written, "glb")
    place, normal, uv = corners(found["ball_LOD1"])
    theta, phi = (1 - uv[..., 1]) * np.pi, uv[..., 0] * 2 * np.pi
    true = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    error = np.linalg.norm(place - OFFSET - true, axis=-1)
    assert np.median(error) < 0.02 and np.quantile(error, 0.95) < 0.08
    assert np.degrees(np.arccos(np.clip((normal * (place - OFFSET)).sum(-1), -1, 1))).mean() < 4


def test_blend_has_levels_hidden_hulls_and_textures_beside_it(run_folder, hulls, tmp_path):
    stage, final = tmp_path / "stage", tmp_path / "ball.blend"
    shutil.copytree(run_folder / "textures", stage / "ball_textures")
    parts = {"name": "sphere", "lods": [0.5, 0.25], "hulls": str(hulls)}
    write_blend(run_folder, stage / "ball.blend", extras=Extras(parts, stage / "ball_textures", final))
    for made in list(stage.iterdir()):
        made.rename(tmp_path / made.name)
    bpy.ops.wm.open_mainfile(filepath=str(final))
    things = {thing.name: thing for thing in bpy.context.scene.objects if thing.type == "MESH"}
    assert sorted(things) == ["UCX_sphere_LOD0_00", "UCX_sphere_LOD0_01", "sphere_LOD0", "sphere_LOD1", "sphere_LOD2"]
    assert [name for name, thing in things.items() if thing.visible_get()] == ["sphere_LOD0"]
    assert all(thing.parent == things["sphere_LOD0"].parent for thing in things.values())
    nodes = things["sphere_LOD0"].active_material.node_tree.nodes
    images = [node.image for node in nodes if node.bl_idname == "ShaderNodeTexImage"]
    assert sorted(image.filepath for image in images) == [f"//ball_textures/{n}.png" for n in ("albedo", "metallic", "normal", "roughness")]
    assert all(image.packed_file is None and image.size[0] == 128 for image in images)
    light = bpy.data.images["environment.exr"]
    assert light.packed_file is not None
    photographs = [image for image in bpy.data.images if image.name.startswith("view")]
    assert photographs and all(image.size[0] > 0 for image in photographs)  # their links start at the final place


def test_turned_and_stretched(run_folder, tmp_path):
    """Normals stay upright on a surface that a transform stretches."""
    shutil.copytree(run_folder / "textures", tmp_path / "ball_textures")
    matrix = Matrix.Diagonal((2, 1, 1, 1)) @ Matrix.Rotation(np.pi / 2, 4, "X")
    job = {"run": str(run_folder), "name": "ball", "textures": str(tmp_path / "ball_textures"), "matrix": np.array(matrix).tolist()}
    writing.write_asset({**job, "tiles": 1, "lods": [], "hulls": None, "pack": False, "occlusion": False}, [tmp_path / "ball.obj"])
    place, normal, _ = corners(reread(tmp_path, "obj")["ball"])
    np.testing.assert_allclose([place.reshape(-1, 3).min(0), place.reshape(-1, 3).max(0)], [[-2, -1, -1], [2, 1, 1]], atol=0.01)
    true = place / [4, 1, 1]  # gradient of the ellipsoid
    true /= np.linalg.norm(true, axis=-1, keepdims=True)
    assert np.degrees(np.arccos(np.clip((normal * true).sum(-1), -1, 1))).max() < 1


def test_missing_texture_and_unknown_format_are_errors(run_folder, tmp_path):
    job = {
        "run": str(run_folder),
        "name": "a",
        "textures": str(tmp_path),
        "matrix": np.eye(4).tolist(),
        "lods": [],
        "hulls": None,
        "tiles": 1,
        "pack": False,
        "occlusion": False,
    }
    with pytest.raises(InputError, match=r"albedo\.png: is missing"):
        writing.write_asset(job, [tmp_path / "a.obj"])
    with pytest.raises(InputError, match="has no known suffix"):
        writing.write_asset(job, [tmp_path / "a.stl"])
