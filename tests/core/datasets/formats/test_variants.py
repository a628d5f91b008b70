# SPDX-License-Identifier: GPL-3.0-or-later
"""Peculiarities of single datasets: other layouts, further files, splits of their papers, missing images."""

import json
import pickle
import shutil

import numpy as np
import pytest
from irgspp.core.datasets.format_detection import parse_dataset
from irgspp.core.datasets.load import load_dataset, load_dataset_cameras, load_novel_views
from irgspp.core.datasets.summary import describe
from irgspp.core.evaluation.ground_truth import load_scene_truth, load_truth
from irgspp.core.io.exr import write_exr
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.settings.schema import DataSettings
from PIL import Image
from written_formats import RIGHT, SEVERAL, Written, realitycapture, similarity, stanford_orb, truths_of
from written_formats import every as every
from written_formats import source as source


def test_ldr_captures_of_stanford_orb(source, tmp_path):
    path, world = stanford_orb.write(source, tmp_path, hdr=False)
    dataset = Written(path, world, source)
    data, _, truths = truths_of(dataset)
    assert data.format == "stanford-orb" and data.train[0].path.suffix == ".png" and len(truths) == 3 * len(source.test)
    for view, truth in truths:
        (light,) = truth.lights.values()
        assert dataset.mirror_error(view.camera, truth.alpha, truth.image, light, data.to_world) < RIGHT


def test_rolled_cameras_of_realitycapture(source, tmp_path):
    """The scene's own cameras are level; only in a tilted world are all three angles different from 0."""
    world = similarity((20.0, -35.0, 65.0), 1.2, (25.0, -12.0, 3.0))
    dataset = Written(*realitycapture.write(source, tmp_path, world), source)
    rolls = np.loadtxt(dataset.path / "cameras.csv", delimiter=",", skiprows=1, usecols=6)
    parsed = parse_dataset(dataset.path, DataSettings())
    assert np.abs(rolls).max() > 20 and rolls.min() < 0 < rolls.max()
    assert max(dataset.shot_of(f.to_world, parsed.to_world)[1] for f in parsed.train) < 1e-5


def test_nero_split_file(every, tmp_path):
    dataset = every["glossy-synthetic"]
    scene = tmp_path / "scene"
    shutil.copytree(dataset.path, scene)
    count = len(dataset.shots)
    tests = [1, 4, 5, 9]
    content = [np.array([str(n) for n in tests]), [str(n) for n in range(count) if n not in tests]]
    (tmp_path / "synthetic_split_128.pkl").write_bytes(pickle.dumps(content))
    for choice, expected in (("auto", tests), ("published", tests), ("holdout", range(0, count, 8))):
        named, _ = load_dataset_cameras(scene, "test", DataSettings(split=choice))
        assert [n for n, _ in named] == [str(n) for n in expected]


def test_cached_cameras_of_glossy_real(every, tmp_path):
    """Without the COLMAP model, NeRO's own copy of the cameras is read."""
    scene = tmp_path / "scene"
    shutil.copytree(every["glossy-real"].path, scene)
    model = parse_dataset(scene, DataSettings())
    own = np.linalg.inv(model.to_world)
    poses, intrinsics, names = {}, {}, {}
    for number, frame in enumerate(model.train, 1):
        pose = own @ frame.to_world
        pose[:3, :3] /= np.cbrt(np.linalg.det(pose[:3, :3]))
        lens = frame.lens
        poses[number] = (np.diag([1, -1, -1, 1]) @ np.linalg.inv(pose))[:3].astype(np.float32)
        intrinsics[number] = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]], np.float32)
        names[number] = frame.listed
    shutil.rmtree(scene / "colmap")
    (scene / "cache.pkl").write_bytes(pickle.dumps([poses, intrinsics, names, list(names)]))
    cached = parse_dataset(scene, DataSettings())
    assert cached.format == "glossy-real" and np.allclose(cached.to_world, model.to_world, atol=1e-5)
    for a, b in zip(cached.train, model.train, strict=True):
        assert a.listed == b.listed and np.allclose(a.to_world, b.to_world, atol=2e-5)


def test_published_sphere_of_ref_real(every):
    dataset = every["ref-real"]
    data = load_dataset(dataset.path)
    assert data.bound.radius == 2.138
    assert np.allclose(np.linalg.inv(data.to_world) @ [*data.bound.centre, 1], [-0.032, 0.808, 0.751, 1])
    assert data.train[0].path.parent.name == "images"
    small = load_dataset(dataset.path, DataSettings(resolution=11))
    assert small.train[0].path.parent.name == "images_4" and small.train[0].camera.width == 11
    assert np.allclose(decode_srgb(small.train[0].colour).mean((0, 1)), decode_srgb(data.train[0].colour).mean((0, 1)), atol=0.01)


def test_nerfstudio_takes_smaller_copies(every):
    dataset = every["nerfstudio"]
    for resolution, folder in ((44, "images"), (22, "images_2"), (16, "images_2")):
        view = load_dataset(dataset.path, DataSettings(resolution=resolution)).train[0]
        assert view.path.parent.name == folder and view.camera.width == resolution and view.alpha is not None


def test_views_under_other_lights_are_counted_and_named(every):
    for name, lights in (("stanford-orb", ["scene_scene002", "scene_scene003"]), ("glossy-synthetic", ["corridor", "golf"])):
        data = load_dataset(every[name].path)
        views = load_novel_views(data, DataSettings())
        assert data.novel == dict.fromkeys(lights, 3) and [v.light for v in views] == [n for n in lights for _ in range(3)]
        assert len({v.name for v in views}) == 6 and f"6 views under other lights: {', '.join(lights)}" in describe(data)
    assert not load_novel_views(load_dataset(every["tensoir"].path), DataSettings())


def test_scenes_converted_for_other_methods(every, source, tmp_path):
    """GlossySynthetic and TensoIR as transforms files, as the Gaussian methods convert them."""
    glossy = every["glossy-synthetic"]
    parsed = parse_dataset(glossy.path, DataSettings())
    own = np.linalg.inv(parsed.to_world)
    width, height = source.size
    content = {"w": width, "h": height, "fl_x": source.focal, "fl_y": source.focal, "cx": width / 2, "cy": height / 2}
    content["camera_angle_x"] = source.angle
    for split, frames in zip(("train", "test"), parsed.split(DataSettings()), strict=True):
        rows = [{"file_path": f"rgb/{f.listed[:-4]}", "transform_matrix": (own @ f.to_world).tolist()} for f in frames]
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps({**content, "frames": rows}))
    (tmp_path / "rgb").mkdir()
    for frame in parsed.train:
        shot, _ = glossy.shot_of(frame.to_world, parsed.to_world)
        Image.fromarray(shot.rgba).save(tmp_path / "rgb" / frame.listed)
    data = load_dataset(tmp_path)
    assert data.format == "glossy-synthetic" and data.has_alpha and len(data.test) == 3
    assert max(glossy.shot_of(v.camera.to_world, data.to_world)[1] for v in data.train) < 1e-5
    assert np.array_equal(data.to_world, parsed.to_world)
    scene = tmp_path / "tensoir"
    shutil.copytree(every["tensoir"].path, scene)
    for split, shots in (("train", source.train), ("test", source.test)):
        rows = [{"file_path": f"./{split}_{i:03d}/rgba", "transform_matrix": s.pose.tolist()} for i, s in enumerate(shots)]
        (scene / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": source.angle, "frames": rows}))
    for file in scene.glob("*/metadata.json"):
        file.unlink()
    data = load_dataset(scene)
    truth = load_truth(data.test[0], load_scene_truth(scene, data.to_world), data.to_world)
    assert data.format == "tensoir" and truth.albedo is not None and set(truth.relit) == {"bridge", "city"}


def test_a_published_sphere_must_fit_the_cameras(every, tmp_path):
    scene = tmp_path / "toycar"  # the cameras are those of the sedan
    shutil.copytree(every["ref-real"].path, scene)
    data = load_dataset(scene)
    assert data.format == "ref-real" and any("does not fit" in w for w in data.warnings)
    (scene / "images_2").mkdir()
    assert load_dataset(scene).format == "colmap"


def test_captures_of_stanford_orb_as_colmap_models(every, tmp_path):
    scene = tmp_path / "scene"
    shutil.copytree(every["ref-real"].path, scene)
    names = sorted(f.name for f in (scene / "images").iterdir())
    (scene / "train_id.txt").write_text("\n".join(names[2:]))
    (scene / "test_id.txt").write_text("\n".join(names[:2]) + "\n")
    data = load_dataset(scene)
    assert data.format == "stanford-orb" and [v.path.name for v in data.test] == names[:2] and len(data.train) == len(names) - 2


@pytest.mark.parametrize("name", ["tensoir", "glossy-synthetic", "metashape", "realitycapture"])
def test_missing_images_are_left_out_with_a_warning(name, every, tmp_path):
    scene = tmp_path / "scene"
    shutil.copytree(every[name].path, scene)
    frame = parse_dataset(scene, DataSettings()).train[3]
    frame.image.unlink()
    data = load_dataset(scene, SEVERAL)
    assert len(data.train) + len(data.test) == len(every[name].shots) - 1 and any("missing" in w for w in data.warnings)


def test_larger_light_maps_come_first(every, tmp_path):
    shutil.copytree(every["tensoir"].path.parent, tmp_path / "all")
    maps = tmp_path / "all" / "Environment_Maps"
    (maps / "high_res_envmaps_2k").mkdir()
    write_exr(maps / "high_res_envmaps_2k" / "city.exr", {c: np.full((8, 16), 0.5, np.float32) for c in "RGB"})
    lights = load_scene_truth(tmp_path / "all" / "scene", np.eye(4)).lights
    assert lights["city"].shape == (8, 16, 3) and lights["bridge"].shape == (64, 128, 3)
    shutil.rmtree(maps)
    assert not load_scene_truth(tmp_path / "all" / "scene", np.eye(4)).lights


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({"fl_x": 70.0, "aabb_scale": 16}, "instant-ngp"),
        ({"fl_x": 70.0, "aabb_scale": 4, "camera_model": "OPENCV"}, "instant-ngp"),
        ({"fl_x": 70.0, "camera_model": "OPENCV"}, "nerfstudio"),
        ({"fl_x": 70.0, "applied_transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}, "nerfstudio"),
        ({"fl_x": 70.0}, "transforms"),
        ({"camera_angle_x": 0.8}, "transforms"),
    ],
)
def test_formats_of_transforms(ball_dataset, content, expected):
    ball_dataset.transforms(**content)
    assert load_dataset(ball_dataset.folder).format == expected
