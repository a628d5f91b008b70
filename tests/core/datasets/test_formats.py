# SPDX-License-Identifier: GPL-3.0-or-later
"""Every dataset of the field, written from a scene of known geometry, is read back as what it is."""

import json
import pickle
import shutil

import numpy as np
import pytest
from formats_scene import AXES, render_scene
from irgspp.core.colour import decode_srgb
from irgspp.core.config import DataSettings, preset
from irgspp.core.datasets.detect import read_capture
from irgspp.core.datasets.inspect import describe
from irgspp.core.datasets.load import load_cameras, load_dataset, load_novel_views
from irgspp.core.errors import InputError
from irgspp.core.evaluation.report import evaluate
from irgspp.core.evaluation.truth import load_scene_truth, load_truth, turned
from irgspp.core.overrides import with_overrides
from irgspp.core.pipeline import Job, reconstruct
from irgspp.core.run_folder import read_run
from irgspp.core.scene.exr import write_exr
from PIL import Image
from written_formats import NAMES, Written, load_source, mirror_errors, realitycapture, similarity, source_light, stanford_orb

DISTORTED = {"nerfstudio", "instant-ngp", "metashape", "realitycapture"}
UNMASKED = {"glossy-real", "ref-real"}
# The names under which the lights of the scene are known.
LIGHTS = {
    "tensoir": {"sunset": "axes", "bridge": "second", "city": "third"},
    "synthetic4relight": {"envmap3": "axes", "envmap6": "second", "envmap12": "third"},
    "glossy-synthetic": {"corridor": "second", "golf": "third"},
    "stanford-orb": {"scene_scene001": "axes", "scene_scene002": "second", "scene_scene003": "third"},
}
SEVERAL = DataSettings(holdout=4)
RIGHT, WRONG = 0.06, 0.25  # the ball is not a perfect mirror; measured: at most 0.04 in a view, and 0.31 upwards over all of them
TINY = (
    "materials=low-gloss", "reflective.iterations=60", "reflective.gaussians=2000", "reflective.light_height=8", "surface.voxels=44",
    "transport.points=400", "transport.rows=4", "transport.iterations=2", "transport.pixels=32", "transport.samples=8",
    "transport.pool=1000", "transport.radiance_iterations=4", "transport.light_height=8", "surface.triangles=400", "surface.texture=16",
    "data.holdout=4",
)  # fmt: skip


@pytest.fixture(scope="session")
def source(tmp_path_factory):
    base = tmp_path_factory.getbasetemp()
    return load_source(render_scene((base.parent if base.name.startswith("popen") else base) / "formats_scene"))


@pytest.fixture(scope="module")
def every(source, tmp_path_factory):
    """By format, what was written."""
    return {name: Written.of(name, source, tmp_path_factory.mktemp(name)) for name in NAMES}


@pytest.fixture(params=NAMES)
def written(request, every):
    return request.param, every[request.param]


def all_frames(capture):
    return [*capture.train, *(capture.test or [])]


def test_formats_are_told_by_their_content_and_shown(written):
    name, dataset = written
    capture, data = read_capture(dataset.path, DataSettings()), load_dataset(dataset.path, SEVERAL)
    assert capture.format == data.format == name and ["format", name] == describe(data).splitlines()[1].split()
    assert len(all_frames(capture)) == len(dataset.shots)
    assert len(data.train) >= 14 and len(data.test) >= 2


def test_cameras_are_the_true_ones(written):
    name, dataset = written
    capture = read_capture(dataset.path, DataSettings())
    found = [dataset.shot_of(f.to_world, capture.to_world) for f in all_frames(capture)]
    assert max(error for _, error in found) < 1e-5
    assert len({id(shot) for shot, _ in found}) == len(dataset.shots)  # none twice
    lens, (width, height), focal = capture.train[0].lens, dataset.source.size, dataset.source.focal
    assert lens.size == (width, height)
    if name in DISTORTED:
        expected = (0.97 * focal, 0.97 * focal, 0.52 * width, 0.47 * height, 0.06, -0.02, 0.004, -0.003, 0.0)
        assert np.allclose((lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion), expected, rtol=1e-6, atol=1e-9)
    else:
        assert np.allclose((lens.fx, lens.fy, lens.cx, lens.cy), (focal, focal, width / 2, height / 2), rtol=1e-6) and not lens.distorted


def test_pictures_and_masks_are_those_of_their_cameras(written):
    name, dataset = written
    data = load_dataset(dataset.path, SEVERAL)
    assert data.has_alpha == (name not in UNMASKED)
    for view in (*data.train, *data.test):
        shot, _ = dataset.shot_of(view.camera.to_world, data.to_world)
        if name not in DISTORTED:
            inside = shot.rgba[..., 3] == 255
            assert np.abs(view.colour - shot.rgba[..., :3] / 255)[inside].max() < 1.1 / 255
        if view.alpha is None:
            continue
        centre, radius = dataset.ball(data.to_world)
        pixel, depth = view.camera.project(centre[None])
        reach = 0.85 * radius * view.camera.fx / depth[0]
        x, y = np.meshgrid(np.arange(view.camera.width) + 0.5, np.arange(view.camera.height) + 0.5)
        assert view.alpha[(x - pixel[0, 0]) ** 2 + (y - pixel[0, 1]) ** 2 < reach**2].min() > 0.9
        nearer = view.camera.fx / dataset.source.focal
        assert abs(view.alpha.mean() / nearer**2 - shot.alpha.mean()) < 0.01 and view.alpha[:, 0].max() == 0


def test_the_declared_split_is_kept(written):
    _, dataset = written
    capture = read_capture(dataset.path, DataSettings())
    tests = {id(s) for s in dataset.source.test}
    learn, check = capture.split(DataSettings(holdout=8))
    assert {id(dataset.shot_of(f.to_world, capture.to_world)[0]) for f in check} <= tests and len(check) >= 2
    if capture.test is not None:
        assert len(learn) == len(dataset.source.train) and len(check) == len(dataset.source.test)
        assert len(capture.split(DataSettings(holdout=8, split="holdout"))[1]) == 3
    with pytest.raises(InputError, match=r"data\.split"):
        capture.split(DataSettings(split="published"))


def truths_of(dataset, settings=DataSettings()):  # noqa: B008 (immutable)
    data = load_dataset(dataset.path, settings)
    scene = load_scene_truth(dataset.path, data.to_world)
    views = [*data.test, *load_novel_views(data, settings)]
    return data, scene, [(view, load_truth(view, scene, data.to_world)) for view in views]


@pytest.mark.parametrize("name", ["tensoir", "nerf-synthetic", "synthetic4relight", "glossy-synthetic", "stanford-orb"])
def test_what_is_stated_of_views_is_true(name, every):
    data, scene, truths = truths_of(every[name])
    assert scene.format == name
    world, kinds = data.to_world @ every[name].world, set()
    size = np.cbrt(np.linalg.det(world[:3, :3]))
    for view, truth in truths:
        shot, _ = every[name].shot_of(view.camera.to_world, data.to_world)
        inside = (shot.rgba[..., 3] == 255) & (shot.layers["depth"] > 0)
        expected = {
            "albedo": (shot.layers["albedo"], 1.1 / 255 if name != "synthetic4relight" else 0.01),
            "normal": (shot.layers["normal"] @ (world[:3, :3] / size).T, 0.012),
            "depth": (shot.layers["depth"] * size, 3e-4),
            "roughness": (shot.layers["material"][..., 0], 1.1 / 255),
        }
        for kind, (layer, tolerance) in expected.items():
            stated = getattr(truth, kind)
            if stated is not None:
                assert np.abs(stated - layer)[inside].max() < tolerance, kind
                kinds.add(kind)
        for light, picture in truth.relit.items():
            own = shot.relit[LIGHTS[name][light]]
            assert np.abs(picture - own[..., :3] / 255)[own[..., 3] == 255].max() < 1.1 / 255
    expected = {
        "tensoir": "albedo normal",
        "nerf-synthetic": "normal",
        "synthetic4relight": "albedo roughness",
        "glossy-synthetic": "depth",
    }
    assert kinds == set(expected.get(name, "albedo normal depth").split())


def explained(dataset, seen, to_world):
    """Assert that the ball mirrors the light of each (camera, alpha, picture, light), and no light that is turned or mirrored."""
    errors = [dataset.mirror_error(*one, to_world) for one in seen]
    assert max(errors) < RIGHT
    mistakes: dict[str, list[float]] = {}
    for camera, alpha, picture, light in seen:
        for mistake, wrong in mirror_errors(light):
            mistakes.setdefault(mistake, []).append(dataset.mirror_error(camera, alpha, picture, wrong, to_world))
    assert len(mistakes) == 7
    for mistake, wrong in mistakes.items():
        assert np.mean(wrong) > WRONG, mistake


@pytest.mark.parametrize("name", sorted(LIGHTS))
def test_lights_are_turned_as_the_pictures_show(name, every):
    data, scene, truths = truths_of(every[name])
    by_light: dict[str, list] = {}
    for view, truth in truths:
        shown = {**truth.relit, **({scene.train_light: truth.picture} if scene.train_light else {})}
        if view.light is None and name == "stanford-orb":
            shown["scene_scene001"] = truth.picture
        for light, picture in shown.items():
            known = truth.lights.get(light, scene.lights.get(light))
            by_light.setdefault(light, []).append((view.camera, truth.alpha, picture, known))
    assert set(by_light) == set(LIGHTS[name]) and set(LIGHTS[name].values()) <= set(AXES)
    for seen in by_light.values():
        assert len(seen) >= 2
        explained(every[name], seen, data.to_world)


def test_the_world_is_turned_as_the_pictures_show(written):
    """The scene's own light, taken where the file's axes say, is what the ball mirrors in every picture."""
    _, dataset = written
    data = load_dataset(dataset.path, SEVERAL)
    light = turned(source_light("axes"), data.to_world @ dataset.world)
    explained(dataset, [(v.camera, v.alpha, np.clip(v.colour, 0, 1), light) for v in data.train[::3]], data.to_world)


def test_up_is_up(written):
    name, dataset = written
    to_world = read_capture(dataset.path, DataSettings()).to_world
    up = (to_world @ dataset.world)[:3, 2]
    assert up[2] / np.linalg.norm(up) > (0.999 if name in ("metashape", "ref-real") else 1 - 1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_a_job_and_its_evaluation(name, every, tmp_path, monkeypatch):
    for written_for_people in ("scene", "sheet"):  # is the same whatever was read
        monkeypatch.setattr(Job, written_for_people, lambda job: None)
    settings = with_overrides(preset("draft"), TINY)
    run = reconstruct(every[name].path, tmp_path / "run", settings)
    assert read_run(run)["status"] == "done"
    figures = evaluate(run, every[name].path, settings=settings.data, samples=8)["figures"]
    assert all(np.isfinite(v) for v in figures.values()) and figures["radiance_psnr"] > 15
    assert (figures.get("relight_psnr", 0) > 12) == (name in LIGHTS)  # 15 to 20 dB after so few steps
    assert ("environment_psnr" in figures) == (name in ("tensoir", "synthetic4relight"))


def test_ldr_captures_of_stanford_orb(source, tmp_path):
    path, world = stanford_orb.write(source, tmp_path, hdr=False)
    dataset = Written(path, world, source)
    data, _, truths = truths_of(dataset)
    assert data.format == "stanford-orb" and data.train[0].path.suffix == ".png" and len(truths) == 3 * len(source.test)
    for view, truth in truths:
        (light,) = truth.lights.values()
        assert dataset.mirror_error(view.camera, truth.alpha, truth.picture, light, data.to_world) < RIGHT


def test_rolled_cameras_of_realitycapture(source, tmp_path):
    """The scene's own cameras are level: only a tilted world has all three angles."""
    world = similarity((20.0, -35.0, 65.0), 1.2, (25.0, -12.0, 3.0))
    dataset = Written(*realitycapture.write(source, tmp_path, world), source)
    rolls = np.loadtxt(dataset.path / "cameras.csv", delimiter=",", skiprows=1, usecols=6)
    capture = read_capture(dataset.path, DataSettings())
    assert np.abs(rolls).max() > 20 and rolls.min() < 0 < rolls.max()
    assert max(dataset.shot_of(f.to_world, capture.to_world)[1] for f in capture.train) < 1e-5


def test_nero_split_file(every, tmp_path):
    dataset = every["glossy-synthetic"]
    scene = tmp_path / "scene"
    shutil.copytree(dataset.path, scene)
    count = len(dataset.shots)
    tests = [1, 4, 5, 9]
    content = [np.array([str(n) for n in tests]), [str(n) for n in range(count) if n not in tests]]
    (tmp_path / "synthetic_split_128.pkl").write_bytes(pickle.dumps(content))
    for choice, expected in (("auto", tests), ("published", tests), ("holdout", range(0, count, 8))):
        named, _ = load_cameras(scene, "test", DataSettings(split=choice))
        assert [n for n, _ in named] == [str(n) for n in expected]


def test_cached_cameras_of_glossy_real(every, tmp_path):
    """Where the COLMAP model is gone, what NeRO keeps of it will do."""
    scene = tmp_path / "scene"
    shutil.copytree(every["glossy-real"].path, scene)
    model = read_capture(scene, DataSettings())
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
    cached = read_capture(scene, DataSettings())
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
    capture = read_capture(glossy.path, DataSettings())
    own = np.linalg.inv(capture.to_world)
    width, height = source.size
    content = {"w": width, "h": height, "fl_x": source.focal, "fl_y": source.focal, "cx": width / 2, "cy": height / 2}
    content["camera_angle_x"] = source.angle
    for split, frames in zip(("train", "test"), capture.split(DataSettings()), strict=True):
        rows = [{"file_path": f"rgb/{f.listed[:-4]}", "transform_matrix": (own @ f.to_world).tolist()} for f in frames]
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps({**content, "frames": rows}))
    (tmp_path / "rgb").mkdir()
    for frame in capture.train:
        shot, _ = glossy.shot_of(frame.to_world, capture.to_world)
        Image.fromarray(shot.rgba).save(tmp_path / "rgb" / frame.listed)
    data = load_dataset(tmp_path)
    assert data.format == "glossy-synthetic" and data.has_alpha and len(data.test) == 3
    assert max(glossy.shot_of(v.camera.to_world, data.to_world)[1] for v in data.train) < 1e-5
    assert np.array_equal(data.to_world, capture.to_world)
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


def test_a_name_alone_makes_no_published_sphere(every, tmp_path):
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
def test_missing_pictures_are_left_out_and_told(name, every, tmp_path):
    scene = tmp_path / "scene"
    shutil.copytree(every[name].path, scene)
    frame = read_capture(scene, DataSettings()).train[3]
    frame.picture.unlink()
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
def test_kinds_of_transforms(capture, content, expected):
    capture.transforms(**content)
    assert load_dataset(capture.folder).format == expected
