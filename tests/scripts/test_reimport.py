# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of an object read back from a file with that of the .blend, and a real round trip on a small sphere."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.scene.camera import Camera
from plyfile import PlyData, PlyElement
from scripts_folder import scripts_on_path


@pytest.fixture(scope="module")
def scripts():
    with scripts_on_path() as script:
        yield script("reimport"), script("reimporting.comparison")


@pytest.fixture
def blend(scripts):
    """A tetrahedron with its material and two images."""
    _, comparison = scripts
    rng, vertices = np.random.default_rng(0), np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    normals = rng.normal(size=(4, 3, 3))
    image = np.ones((8, 8, 4)) * rng.uniform(0.2, 0.6, (8, 8, 1))
    image[..., 3] = np.arange(8)[:, None] < 4  # the object covers the upper half
    image[4:] = 0
    return comparison.Asset(
        vertices=vertices,
        faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
        normals=normals / np.linalg.norm(normals, axis=-1, keepdims=True),
        uvs=rng.uniform(size=(4, 3, 2)),
        textures={"Base Color": rng.integers(0, 256, (4, 4, 3), np.uint8), "Roughness": rng.integers(0, 256, (4, 4), np.uint8)},
        spaces={"Base Color": "sRGB", "Roughness": "Non-Color"},
        values={"distribution": "GGX", "IOR": 1.5, "emission": [0.0, 0.0, 0.0]},
        images=(image, image[:, ::-1].copy()),
    )


def shuffled(asset):
    """The same object with other orders of vertices, of faces, and of each face's corners."""
    order, turn, faces = np.array([2, 0, 3, 1]), [1, 2, 0], np.array([3, 1, 0, 2])
    return replace(
        asset,
        vertices=asset.vertices[order],
        faces=np.argsort(order)[asset.faces[faces]][:, turn],
        normals=asset.normals[faces][:, turn],
        uvs=asset.uvs[faces][:, turn],
    )


def test_order_of_vertices_and_faces_does_not_matter(scripts, blend):
    script, comparison = scripts
    found = comparison.compare(shuffled(blend), blend)
    assert (found.look, found.distance, found.faces, found.uv, found.texel, found.material) == (100, 0, 0, 0, 0, ())
    assert found.normal < 1e-5
    assert script.failures(found) == []


def test_split_vertices_are_no_difference(scripts, blend):
    """Formats split vertices where UVs or normals differ."""
    script, comparison = scripts
    split = replace(blend, vertices=blend.vertices[blend.faces.reshape(-1)], faces=np.arange(12).reshape(4, 3))
    assert script.failures(comparison.compare(split, blend)) == []


def test_each_difference_is_found(scripts, blend):
    script, comparison = scripts
    wrong = {
        "vertices": {"vertices": blend.vertices + np.array([0.001, 0, 0])},
        "faces": {"faces": blend.faces[:3], "normals": blend.normals[:3], "uvs": blend.uvs[:3]},
        "UVs": {"uvs": blend.uvs * [1, -1]},
        "normals": {"normals": -blend.normals},
        "texels": {"textures": {**blend.textures, "Roughness": blend.textures["Roughness"] ^ 2}},
        "look": {"images": tuple(image * [0.9, 0.9, 0.9, 1] for image in blend.images)},
    }
    for name, change in wrong.items():
        assert script.failures(comparison.compare(replace(blend, **change), blend)) == [name]


def test_missing_uvs_and_textures_fail(scripts, blend):
    script, comparison = scripts
    bare = replace(blend, uvs=np.full_like(blend.uvs, np.nan), textures={}, spaces={})
    found = comparison.compare(bare, blend)
    assert script.failures(found) == ["UVs", "texels"] and found.texel == 255
    assert found.material == ("no texture for Base Color", "no texture for Roughness")


def test_the_look_is_that_of_the_object_in_the_worst_view(scripts, blend):
    """Background, here half of the image, must not hide an error."""
    _, comparison = scripts
    encoded = comparison.on_black(blend.images[1])
    wrong = np.clip(encoded - 0.1, 0, None)
    linear = np.where(wrong <= 0.04045, wrong / 12.92, ((wrong + 0.055) / 1.055) ** 2.4)
    worse = np.concatenate([linear, blend.images[1][..., 3:]], -1)
    assert comparison.worst_psnr((blend.images[0], worse), blend.images) == pytest.approx(20, abs=1e-6)


def test_material_differences_are_named(scripts, blend):
    _, comparison = scripts
    changed = replace(
        blend,
        spaces={"Base Color": "sRGB", "Roughness": "sRGB"},
        values={"distribution": "MULTI_GGX", "IOR": 1.45, "emission": [0.0, 0.0, 0.0]},
    )
    words = comparison.material_differences(changed, blend)
    assert words == ["Roughness is sRGB", "distribution MULTI_GGX instead of GGX", "IOR 1.45 instead of 1.5"]


def test_views_frame_the_object_on_its_foot(scripts, run_folder):
    script, _ = scripts
    for view in script.views(run_folder, 64):  # a unit sphere whose foot is at the origin
        camera = Camera(**{**view, "to_world": np.array(view["to_world"])})
        pixels, _ = camera.project(np.array([[0.0, 0, 0], [0, 0, 2], [1, 0, 1], [0, -1, 1]]))
        assert (pixels > 0).all() and (pixels < 64).all()
        np.testing.assert_allclose(camera.project(np.array([[0.0, 0, 1]]))[0], [[32, 32]], atol=0.5)


def write_splats(file):
    """Write three splats with few columns, and return the values (3,) of each by its name."""
    columns = {name: np.arange(3, dtype=np.float32) + i for i, name in enumerate(("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "opacity"))}
    written = np.zeros(3, [(name, "f4") for name in columns])
    for name, values in columns.items():
        written[name] = values
    PlyData([PlyElement.describe(written, "vertex")]).write(str(file))
    return columns


def test_changed_and_missing_columns_of_splats_are_named(scripts, tmp_path):
    _, comparison = scripts
    columns = write_splats(tmp_path / "splats.ply")
    np.savez(tmp_path / "splats.npz", **{**columns, "nx": columns["nx"] + 1})
    assert comparison.wrong_columns(tmp_path / "splats.ply", tmp_path / "splats.npz") == ([], 5)
    del columns["opacity"]
    np.savez(tmp_path / "splats.npz", **{**columns, "y": columns["y"] + 1e-6})
    assert comparison.wrong_columns(tmp_path / "splats.ply", tmp_path / "splats.npz") == (["y", "opacity"], 5)


def test_round_trip_of_a_sphere(scripts, run_folder, tmp_path, monkeypatch, capsys):
    """The sphere has rough bright metal, which Blender's own microfacet distribution shows brighter than the .blend's."""
    pytest.importorskip("bpy")
    script, _ = scripts
    monkeypatch.setattr(script, "FORMATS", ("glb",))
    monkeypatch.setattr(script, "SIDES", script.SIDES[:1])
    asset = script.export  # the sphere's run has no Gaussians
    monkeypatch.setattr(script, "export", lambda run, file: write_splats(file) if file.suffix == ".ply" else asset(run, file))
    few = ["--size", "32", "--samples", "4", "-o", str(tmp_path)]
    assert script.main([str(run_folder), *few]) == 1
    line, splats = capsys.readouterr().out.splitlines()[-2:]
    assert splats == "ply    equal, 5 columns of splats"
    assert line.startswith("glb") and line.endswith("  FAILED: look; distribution MULTI_GGX instead of GGX")
    assert 35 < float(line.split()[1]) < 45 and float(line.split()[2]) > 60  # with the .blend's distribution


def test_unreadable_file_is_a_failed_line(scripts, run_folder, tmp_path, monkeypatch, capsys):
    pytest.importorskip("bpy")
    script, _ = scripts
    monkeypatch.setattr(script, "FORMATS", ("glb",))
    monkeypatch.setattr(script, "SIDES", script.SIDES[:1])
    monkeypatch.setattr(script, "export", lambda run, target: target.write_bytes(b"nothing") if target.suffix == ".glb" else None)
    blend = script.read_back
    monkeypatch.setattr(script, "read_back", lambda *words: blend(*words) if words[1]["file"].endswith("glb") else FakeBlend())
    assert script.main([str(run_folder), "--samples", "1", "-o", str(tmp_path)]) == 1
    line, splats = capsys.readouterr().out.splitlines()[-2:]
    assert line.startswith("glb    FAILED: asset.glb: not read, Blender ended with status 1") and "Error" in line
    assert splats.startswith("ply    FAILED: asset.ply: not read, Blender ended with status 1")


class FakeBlend:
    blender = "of a test"
