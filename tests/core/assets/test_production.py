# SPDX-License-Identifier: GPL-3.0-or-later
"""Production asset: textures, choices that a format can't have, .glb with tangents, files that are replaced together, collision hulls."""

import importlib.util
import json
import struct

import numpy as np
import pytest
import trimesh
from irgspp.core.assets import collision, production
from irgspp.core.assets.export import export
from irgspp.core.assets.occlusion import occlusion_texture
from irgspp.core.assets.options import AssetOptions
from irgspp.core.assets.texture_set import flipped_green, save_texture_set
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.io.image import decode_deep_png
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.mesh_ply import load_mesh_ply, save_mesh_ply
from irgspp.core.scene.textures import load_textures, save_textures
from sphere_run import sphere


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    mesh = sphere(size=32)
    save_mesh_ply(mesh, folder / "mesh.ply")
    save_textures(mesh.textures, folder / "textures")
    return folder


class Messages(Silent):
    def __init__(self):
        self.lines = []

    def message(self, text):
        self.lines.append(text)


def test_texture_set_has_packed_and_separate_maps(run, tmp_path):
    from PIL import Image

    save_texture_set(run, tmp_path / "set")
    own = load_textures(run / "textures")
    orm = np.asarray(Image.open(tmp_path / "set" / "orm.png"))
    assert (orm[..., 0] == 255).all()
    np.testing.assert_array_equal(orm[..., 1], own["roughness"])
    np.testing.assert_array_equal(orm[..., 2], own["metallic"])
    found = load_textures(tmp_path / "set")
    assert all((found[name] == own[name]).all() for name in own)


def test_heights_have_their_scale_beside_them(run, tmp_path):
    heights, record = np.arange(1024, dtype=np.uint16).reshape(32, 32), {"scale": 0.25, "midlevel": 0.5, "missed": 0.0}
    save_textures({"height": heights}, run / "textures")
    (run / "run.json").write_text(json.dumps({"settings": {}, "phases": {}, "height": record}))
    save_texture_set(run, tmp_path / "set")
    np.testing.assert_array_equal(load_textures(tmp_path / "set")["height"], heights)
    assert json.loads((tmp_path / "set" / "height.json").read_text()) == record


def with_tiles(run, tiles=2):
    (run / "run.json").write_text(json.dumps({"settings": {}, "phases": {}, "textures": {"tiles": tiles}}))


def test_sets_of_tiles_hold_parts_of_the_images(run, tmp_path):
    from PIL import Image

    save_texture_set(run, tmp_path / "set", tiles=2)
    own, names = load_textures(run / "textures"), ("albedo", "roughness", "metallic", "normal", "orm")
    assert {path.name for path in (tmp_path / "set").iterdir()} == {f"{n}.{t}.png" for n in names for t in (1001, 1002, 1011, 1012)}
    lower_right = np.asarray(Image.open(tmp_path / "set" / "albedo.1002.png"))
    np.testing.assert_array_equal(lower_right, own["albedo"][16:, 16:])


@pytest.mark.parametrize(("suffix", "textures", "tiles"), [
    (".blend", "auto", 2), (".blend", "beside", 2), (".blend", "tiles", 2), (".usdc", "auto", 1), (".usdc", "tiles", 2),
    (".obj", "beside", 1), (".obj", "tiles", 2), (".fbx", "packed", 1), (".fbx", "tiles", 2), (".glb", "auto", 1), (".usdz", "auto", 1),
])  # fmt: skip
def test_formats_have_tiles_where_they_are_asked_for(suffix, textures, tiles):
    options = AssetOptions(textures=textures)
    assert options.tiles(suffix, 2) == tiles and (options.packs(suffix) is False or textures != "tiles")


@pytest.mark.parametrize("suffix", [".glb", ".usdz"])
def test_formats_without_tiles_refuse_them(run, tmp_path, suffix):
    with_tiles(run)
    with pytest.raises(InputError, match=f"--textures: {suffix} always holds its textures"):
        export(run, tmp_path / f"a{suffix}", options=AssetOptions(textures="tiles"))
    assert AssetOptions(textures="tiles").fitting(suffix).textures == "auto"


def test_tiles_of_a_run_without_them_are_refused(run, tmp_path):
    with pytest.raises(InputError, match="--textures: the run has no UDIM tiles; bake them first"):
        export(run, tmp_path / "a.obj", options=AssetOptions(textures="tiles"))


def test_broken_number_of_tiles_is_bad_input(run, tmp_path):
    with_tiles(run, "many")
    with pytest.raises(InputError, match=r"run\.json: is broken \(textures\.tiles is 'many'\)"):
        export(run, tmp_path / "a.obj", options=AssetOptions())


def test_directx_normals_have_the_other_green(run, tmp_path):
    normal = load_textures(run / "textures")["normal"].copy()
    normal[3, 4] = 200, 90, 210
    save_textures({"normal": normal}, run / "textures")
    save_texture_set(run, tmp_path / "set", "directx")
    found = load_textures(tmp_path / "set")["normal"]
    assert found[3, 4].tolist() == [200, 165, 210]
    np.testing.assert_array_equal(flipped_green(found), normal)


@pytest.mark.parametrize(("eight", "kind"), [(False, np.uint16), (True, np.uint8)])
def test_sets_of_sixteen_bits(run, tmp_path, eight, kind):
    deep = {name: 257 * texture.astype(np.uint16) + 9 for name, texture in load_textures(run / "textures").items()}
    deep = {name: np.where(texture > 65535 - 9, 65535, texture).astype(np.uint16) for name, texture in deep.items()}
    save_textures({**deep, "height": deep["roughness"]}, run / "textures")
    (run / "run.json").write_text(json.dumps({"settings": {}, "phases": {}, "height": {"scale": 1.0, "midlevel": 0.5}}))
    save_texture_set(run, tmp_path / "set", "directx", eight)
    found = load_textures(tmp_path / "set")
    orm = decode_deep_png((tmp_path / "set" / "orm.png").read_bytes())  # as it is stored, of 8 or 16 bits
    assert found["normal"].dtype == found["albedo"].dtype == orm.dtype == kind and found["height"].dtype == np.uint16
    highest = np.iinfo(kind).max
    assert (orm[..., 0] == highest).all()
    np.testing.assert_allclose(found["normal"][..., 1] / highest, 1 - deep["normal"][..., 1] / 65535, atol=0.6 / highest)
    np.testing.assert_allclose(orm[..., 1] / highest, deep["roughness"] / 65535, atol=0.6 / highest)


def test_missing_texture_is_named(run, tmp_path):
    (run / "textures" / "metallic.png").unlink()
    with pytest.raises(InputError, match=r"lacks metallic\.png"):
        save_texture_set(run, tmp_path / "set")


@pytest.mark.parametrize(
    ("suffix", "options", "words"),
    [
        (".obj", AssetOptions(textures="packed"), "holds no textures"),
        (".usdc", AssetOptions(textures="packed"), "holds no textures"),
        (".glb", AssetOptions(textures="beside"), "always holds its textures"),
        (".usdz", AssetOptions(textures="beside"), "always holds its textures"),
        (".glb", AssetOptions(normal_map="directx"), "OpenGL's by definition"),
        (".blend", AssetOptions(normal_map="directx"), "OpenGL's by definition"),
        (".ply", AssetOptions(lods=True), "no levels of detail"),
        (".exr", AssetOptions(collision=True), "no levels of detail"),
    ],
)
def test_choices_that_a_format_can_not_have_are_refused(run, tmp_path, suffix, options, words):
    with pytest.raises(InputError, match=words):
        export(run, tmp_path / f"a{suffix}", options=options)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_formats_pack_where_they_can():
    assert [AssetOptions().packs(suffix) for suffix in (".glb", ".usdz", ".fbx", ".blend", ".usdc", ".obj")] == [True] * 4 + [False] * 2
    assert not AssetOptions(textures="beside").packs(".fbx")


def test_glb_stands_on_its_foot_and_has_tangents(run, tmp_path):
    moved = load_mesh_ply(run / "mesh.ply")
    save_mesh_ply(Mesh(**{**vars(moved), "vertices": moved.vertices + np.float32([3, 4, 5])}), run / "mesh.ply")
    export(run, tmp_path / "ball.glb")
    tree, attributes = read_glb(tmp_path / "ball.glb")
    assert "ball" in {node.get("name") for node in tree["nodes"]}
    used = np.unique(load_mesh_ply(run / "mesh.ply").faces)
    place, normal, tangent = (attributes[name][used] for name in ("POSITION", "NORMAL", "TANGENT"))
    np.testing.assert_allclose(place[:, 1].min(), 0, atol=1e-5)  # glTF's up is +Y
    np.testing.assert_allclose((place.min(0) + place.max(0))[[0, 2]], 0, atol=1e-2)
    np.testing.assert_allclose(np.linalg.norm(tangent[:, :3], axis=-1), 1, atol=1e-5)
    assert np.abs((tangent[:, :3] * normal).sum(-1)).max() < 1e-5 and set(np.unique(tangent[:, 3])) == {1.0}
    east = np.stack(
        [-normal[:, 2], 0 * normal[:, 0], normal[:, 0]], -1
    )  # u grows with the longitude, from x towards the world's y, -z here
    inner = np.abs(normal[:, 1]) < 0.9
    assert ((tangent[:, :3] * -east).sum(-1)[inner] > 0.4).all()


def test_glb_turned_and_scaled_in_one(run, tmp_path):
    turn = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # the run's y is up
    export(run, tmp_path / "ball.glb", options=AssetOptions(transform=tuple(3.0 * turn.reshape(-1))))
    mesh = load_mesh_ply(run / "mesh.ply")
    _, attributes = read_glb(tmp_path / "ball.glb")
    expected = 3 * mesh.vertices[:, [0, 1, 2]] + [0, 3, 0]  # glTF's y is up, too
    np.testing.assert_allclose(attributes["POSITION"], expected, atol=0.01)
    np.testing.assert_allclose(attributes["NORMAL"], mesh.normals, atol=1e-5)
    with pytest.raises(InputError, match="mirrors"):
        export(run, tmp_path / "a.glb", options=AssetOptions(transform=(1, 0, 0, 0, 1, 0, 0, 0, -1)))
    with pytest.raises(InputError, match="not turned or scaled"):
        export(run, tmp_path / "a.exr", options=AssetOptions(transform=(2, 0, 0, 0, 2, 0, 0, 0, 2)))


def test_occlusion_is_dark_where_another_part_is_near(run, tmp_path):
    export(run, tmp_path / "plain.glb")
    export(run, tmp_path / "ball.glb", options=AssetOptions(occlusion=True))
    assert "occlusionTexture" not in read_glb(tmp_path / "plain.glb")[0]["materials"][0]
    material = read_glb(tmp_path / "ball.glb")[0]["materials"][0]
    assert material["occlusionTexture"]["index"] == material["pbrMetallicRoughness"]["metallicRoughnessTexture"]["index"]
    assert occlusion_texture(sphere(size=32), 32).min() > 0.97  # a convex body occludes nothing
    ball = sphere(size=32)
    above = ball.vertices * np.float32([3, 3, 0.05]) + np.float32([0, 0, 1.1])  # a disc just over it, in the same UVs: faces alone
    faces = np.concatenate([ball.faces, ball.faces + len(above)])
    uvs = np.concatenate([ball.uvs, 0 * ball.uvs])
    both = Mesh(
        **{
            **vars(ball),
            "vertices": np.concatenate([ball.vertices, above]),
            "faces": faces,
            "uvs": uvs,
            "normals": np.concatenate([ball.normals, ball.normals]),
        }
    )
    seen = occlusion_texture(both, 32)
    assert seen[1].mean() < 0.3 and seen[-2].mean() > 0.95  # the sphere's top and bottom
    for suffix in (".blend", ".usdz", ".fbx"):
        with pytest.raises(InputError, match="no place for it"):
            export(run, tmp_path / f"a{suffix}", options=AssetOptions(occlusion=True))


def test_texture_set_with_occlusion(run, tmp_path):
    save_texture_set(run, tmp_path / "set", occluded=load_mesh_ply(run / "mesh.ply"))
    from PIL import Image

    orm, separate = (np.asarray(Image.open(tmp_path / "set" / f"{name}.png")) for name in ("orm", "occlusion"))
    np.testing.assert_array_equal(orm[..., 0], separate)


def read_glb(path):
    """Return the JSON of a .glb and the float attributes of its first primitive."""
    data = path.read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    tree, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    attributes = {}
    for name, number in tree["meshes"][0]["primitives"][0]["attributes"].items():
        accessor = tree["accessors"][number]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        begin = tree["bufferViews"][accessor["bufferView"]].get("byteOffset", 0) + accessor.get("byteOffset", 0)
        values = np.frombuffer(binary, np.float32, accessor["count"] * width, begin)
        attributes[name] = values.reshape(-1, width)
    return tree, attributes


def test_staged_files_replace_the_old_ones_together_or_not_at_all(tmp_path):
    target = tmp_path / "a.obj"
    (tmp_path / "a_textures").mkdir()
    (tmp_path / "a_textures" / "old.png").write_text("old")
    target.write_text("old")
    with pytest.raises(IrgsppError), production.staged(target) as staging:
        (staging / "a.obj").write_text("new")
        raise IrgsppError("stopped")
    assert target.read_text() == "old" and sorted(p.name for p in tmp_path.iterdir()) == ["a.obj", "a_textures"]
    with production.staged(target) as staging:
        (staging / "a_textures").mkdir()
        (staging / "a_textures" / "new.png").write_text("new")
        (staging / "a.obj").write_text("new")
    assert target.read_text() == "new" and [p.name for p in (tmp_path / "a_textures").iterdir()] == ["new.png"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.obj", "a_textures"]


def two_boxes() -> Mesh:
    boxes = trimesh.util.concatenate([trimesh.creation.box((1, 1, 1)), trimesh.creation.box((2, 1, 1)).apply_translation((4, 0, 0))])
    v = np.array(boxes.vertices, np.float32)
    grey = np.full((len(v), 3), 0.5, np.float32)
    return Mesh(v, v, v[:, :2], np.array(boxes.faces, np.int32), grey, grey[:, 0], grey[:, 0])


def volumes(hulls) -> list[float]:
    bodies = [trimesh.Trimesh(*hull) for hull in hulls]
    assert all(body.is_convex and body.is_watertight for body in bodies)
    return sorted(float(body.volume) for body in bodies)


def test_without_coacd_each_component_gets_its_hull(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    progress = Messages()
    hulls = collision.collision_hulls(two_boxes(), progress)
    np.testing.assert_allclose(volumes(hulls), [1, 2], rtol=1e-6)
    assert any("coacd is not installed" in line for line in progress.lines)


def test_hull_of_many_corners_is_kept_small(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    (hull,) = collision.collision_hulls(sphere(), Silent())
    assert len(hull[0]) <= collision.CORNERS and volumes([hull])[0] > 0.8 * 4 / 3 * np.pi


def test_coacd_takes_a_concave_solid_apart():
    pytest.importorskip("coacd")
    ring = trimesh.creation.annulus(0.6, 1.0, 0.5, sections=24)
    v = np.array(ring.vertices, np.float32)
    grey = np.full((len(v), 3), 0.5, np.float32)
    mesh = Mesh(v, v, v[:, :2], np.array(ring.faces, np.int32), grey, grey[:, 0], grey[:, 0])
    hulls = collision.collision_hulls(mesh, Silent())
    assert len(hulls) >= 3 and abs(sum(volumes(hulls)) / ring.volume - 1) < 0.25
    assert not any(trimesh.Trimesh(*hull).contains([[0, 0, 0]])[0] for hull in hulls)
