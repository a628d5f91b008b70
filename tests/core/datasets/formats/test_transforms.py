# SPDX-License-Identifier: GPL-3.0-or-later
"""Every variant of transforms.json against the dataset it was written from."""

import json

import numpy as np
import OpenEXR
import pytest
from irgspp.core.datasets.load import load_dataset, load_dataset_cameras
from irgspp.core.errors import InputError
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.settings.schema import DataSettings
from PIL import Image

ALL = DataSettings(holdout=0)


def pixels(ball_dataset, index):
    return ball_dataset.images[index].astype(np.float32) / 255


def test_instant_ngp_gives_cameras_and_pixels_as_written(ball_dataset):
    ball_dataset.transforms()
    data = load_dataset(ball_dataset.folder, ALL)
    assert data.format == "transforms" and not data.test and np.array_equal(data.to_world, np.eye(4))
    for i, view in enumerate(data.train):
        assert view.name == f"{i:03d}" and view.camera.fx == view.camera.fy == ball_dataset.focal
        np.testing.assert_allclose(view.camera.to_world, ball_dataset.poses[i], atol=1e-12)
        np.testing.assert_array_equal(view.colour, pixels(ball_dataset, i)[..., :3])
        np.testing.assert_array_equal(view.alpha, pixels(ball_dataset, i)[..., 3])


def test_nerf_synthetic_without_extensions_and_with_its_own_test_split(ball_dataset):
    listed = [f"./train/r_{i}" for i in range(10)]
    path = ball_dataset.transforms("transforms_train.json", listed, **ball_dataset.angle)
    (ball_dataset.folder / "test" / "r_0").mkdir(parents=True)
    Image.fromarray(ball_dataset.images[0]).save(ball_dataset.folder / "test/r_0/rgba.png")
    content = json.loads(path.read_text())
    content["frames"] = [{**content["frames"][0], "file_path": "./test/r_0/rgba"}]
    (ball_dataset.folder / "transforms_test.json").write_text(json.dumps(content))
    data = load_dataset(ball_dataset.folder)
    assert len(data.train) == 10 and [v.name for v in data.test] == ["r_0"]
    assert data.train[0].camera.fx == pytest.approx(ball_dataset.focal) and data.train[0].camera.cx == ball_dataset.size[0] / 2


def test_rotations_of_the_light_are_read_and_checked(ball_dataset):
    path, turn = ball_dataset.transforms(), [[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]
    ball_dataset.edit(path, lambda c: c["frames"][1].update(light_rotation=turn))
    train = load_dataset(ball_dataset.folder, ALL).train
    assert train[0].light_rotation is None and np.allclose(train[1].light_rotation, turn)
    assert load_dataset(ball_dataset.folder, ALL).turns
    for wrong in ([[1, 0], [0, 1]], [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "turned"):
        ball_dataset.edit(path, lambda c, wrong=wrong: c["frames"][1].update(light_rotation=wrong))
        with pytest.raises(InputError, match=r"frame 1 .*light_rotation"):
            load_dataset(ball_dataset.folder, ALL)


def test_a_light_may_move_with_the_camera(ball_dataset):
    path = ball_dataset.transforms()
    lit = load_dataset(ball_dataset.folder, DataSettings(light="camera"))
    assert len(lit.test) == 2 and lit.lit_from_camera and not lit.turns and not load_dataset(ball_dataset.folder).turns
    shone = [view.light_rotation @ view.camera.to_world[:3, :3] for view in (*lit.train, *lit.test)]  # the same in each camera's frame
    assert np.allclose(shone, shone[0]) and np.allclose(lit.train[0].light_rotation, np.eye(3))
    ball_dataset.edit(path, lambda c: c["frames"][1].update(light_rotation=np.eye(3).tolist()))
    with pytest.raises(InputError, match=r"data\.light=camera: .* states how the light turns"):
        load_dataset(ball_dataset.folder, DataSettings(light="camera"))


def test_every_eighth_view_is_held_out(ball_dataset):
    ball_dataset.transforms()
    data = load_dataset(ball_dataset.folder)
    assert [v.name for v in data.test] == ["000", "008"] and len(data.train) == 8


def test_nerfstudio_split_lists(ball_dataset):
    path = ball_dataset.transforms()
    ball_dataset.edit(
        path, lambda c: c.update(train_filenames=[f"images/{i:03d}.png" for i in range(6)], test_filenames=["images/009.png"])
    )
    data = load_dataset(ball_dataset.folder)
    assert len(data.train) == 6 and [v.name for v in data.test] == ["009"]


def test_a_frame_may_have_its_own_intrinsics(ball_dataset):
    path = ball_dataset.transforms()
    ball_dataset.edit(path, lambda c: c["frames"][3].update(fl_x=75.0, cx=28.5))
    camera = load_dataset(path, ALL).train[3].camera
    assert (camera.fx, camera.fy, camera.cx) == (75.0, ball_dataset.focal, 28.5)


@pytest.mark.parametrize("suffix", [".PNG", ".jpg", ".JPEG"])
def test_extensions_are_found(ball_dataset, suffix):
    ball_dataset.transforms(names=[f"images/{i}" for i in range(10)])
    for i, image in enumerate(ball_dataset.images):
        (ball_dataset.folder / f"images/{i}.png").unlink()
        kind = "PNG" if suffix == ".PNG" else "JPEG"
        Image.fromarray(image[..., :3]).save(ball_dataset.folder / f"images/{i}{suffix}", kind, quality=95)
    data = load_dataset(ball_dataset.folder, ALL)
    assert data.train[0].path.suffix == suffix and data.train[0].alpha is None
    inside = ball_dataset.images[0][8:40, 10:50, :3] / 255
    assert np.abs(data.train[0].colour[8:40, 10:50] - inside).mean() < 0.03


@pytest.mark.parametrize("place", ["mask_path", "masks/{}.png", "masks/{}.jpg.png", "images/{}_mask.png"])
def test_masks_from_files(ball_dataset, place):
    names = [f"images/{i:03d}.jpg" for i in range(10)]
    path = ball_dataset.transforms(names=names, alpha=False)
    for i, image in enumerate(ball_dataset.images):
        file = ball_dataset.folder / ("elsewhere/{}.png" if place == "mask_path" else place).format(f"{i:03d}")
        file.parent.mkdir(exist_ok=True)
        Image.fromarray(image[..., 3]).save(file)
        if place == "mask_path":
            ball_dataset.edit(path, lambda c, i=i: c["frames"][i].update(mask_path=f"elsewhere/{i:03d}.png"))
    data = load_dataset(ball_dataset.folder, ALL)
    assert data.has_alpha
    np.testing.assert_array_equal(data.train[4].alpha, pixels(ball_dataset, 4)[..., 3])
    assert not load_dataset(ball_dataset.folder, DataSettings(masks=False)).has_alpha


def test_sixteen_bit_images_keep_their_depth(ball_dataset):
    import cv2

    ball_dataset.transforms()
    wide = np.random.default_rng(0).integers(0, 65536, (10, *ball_dataset.images[0].shape), dtype=np.uint16)
    wide[:, :20, :, 3] = 65535
    for i in range(10):
        cv2.imwrite(str(ball_dataset.folder / f"images/{i:03d}.png"), cv2.cvtColor(wide[i], cv2.COLOR_RGBA2BGRA))
    view = load_dataset(ball_dataset.folder, ALL).train[2]
    np.testing.assert_allclose(view.colour, wide[2, ..., :3] / 65535, atol=1e-7)
    np.testing.assert_allclose(view.alpha, wide[2, ..., 3] / 65535, atol=1e-7)


def test_exr_is_linear_and_premultiplied(ball_dataset):
    ball_dataset.transforms(names=[f"images/{i}" for i in range(10)])
    for i, image in enumerate(ball_dataset.images):
        (ball_dataset.folder / f"images/{i}.png").unlink()
        alpha = image[..., 3] / np.float32(255) * 0.5
        linear = 3 * decode_srgb(image[..., :3] / np.float32(255)) * alpha[..., None]
        channels = {n: np.ascontiguousarray(c, np.float32) for n, c in zip("RGBA", [*np.moveaxis(linear, -1, 0), alpha], strict=True)}
        OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(
            str(ball_dataset.folder / f"images/{i}.exr")
        )
    view = load_dataset(ball_dataset.folder, ALL).train[1]
    solid = view.alpha > 0
    np.testing.assert_allclose(
        decode_srgb(view.colour)[solid], 3 * decode_srgb(pixels(ball_dataset, 1)[..., :3])[solid], rtol=2e-4, atol=1e-5
    )
    assert view.colour.max() > 1 and set(np.unique(view.alpha)) == {0, 0.5}


def test_missing_images_are_left_out_with_a_warning(ball_dataset):
    ball_dataset.transforms()
    (ball_dataset.folder / "images/002.png").unlink()
    data = load_dataset(ball_dataset.folder, ALL)
    assert len(data.train) == 9 and "002" in data.warnings[0] and "1 of 10" in data.warnings[0]
    assert [n for n, _ in load_dataset_cameras(ball_dataset.folder, "all", ALL)[0]] == [v.name for v in data.train]


def test_opaque_alpha_is_no_mask(ball_dataset):
    for image in ball_dataset.images:
        image[..., 3] = 255
    ball_dataset.transforms()
    assert not load_dataset(ball_dataset.folder).has_alpha


def test_masks_of_test_views_are_kept_where_photographs_have_none(ball_dataset):
    """As of a capture whose photographs show a table, and whose truth shows the object alone."""
    path = ball_dataset.transforms(alpha=False)
    content = json.loads(path.read_text())
    Image.fromarray(ball_dataset.images[0]).save(ball_dataset.folder / "images/000.png")
    ball_dataset.edit(
        path, lambda c: c.update(train_filenames=[f["file_path"] for f in content["frames"][1:]], test_filenames=["images/000.png"])
    )
    data = load_dataset(ball_dataset.folder)
    assert not data.has_alpha and [view.name for view in data.test] == ["000"]
    assert data.test[0].alpha.min() == 0 and data.test[0].alpha.max() == 1


def test_reduction_averages_linear_light_under_alpha(ball_dataset):
    for image in ball_dataset.images:
        image[:] = 0
        image[10:40, 10:50] = (255, 255, 255, 255)
        image[10:40, 11:50:2] = (0, 0, 0, 255)  # stripes of one pixel: half the light
    ball_dataset.transforms()
    view = load_dataset(ball_dataset.folder, DataSettings(resolution=30, holdout=0)).train[0]
    assert view.colour.shape == (24, 30, 3) and (view.camera.width, view.camera.fx) == (30, ball_dataset.focal / 2)
    np.testing.assert_allclose(decode_srgb(view.colour[6:19, 6:24]), 0.5, atol=1e-5)
    assert view.alpha[2, 2] == 0 and view.alpha[10, 10] == 1


def test_names_stay_unique(ball_dataset):
    names = [f"{'left' if i % 2 else 'right'}/{i // 2}.png" for i in range(10)]
    ball_dataset.transforms(names=names)
    found = [v.name for v in load_dataset(ball_dataset.folder, ALL).train]
    assert len(set(found)) == 10 and found[0] == "right_0"


def test_cameras_of_missing_test_images(ball_dataset):
    path = ball_dataset.transforms("transforms_train.json", [f"train/{i}" for i in range(10)], **ball_dataset.angle)
    content = json.loads(path.read_text())
    content["frames"] = [{**f, "file_path": f"test/{i}/rgba"} for i, f in enumerate(content["frames"][:4])]
    (ball_dataset.folder / "transforms_test.json").write_text(json.dumps(content))
    named, to_world = load_dataset_cameras(ball_dataset.folder)
    assert [n for n, _ in named] == ["0", "1", "2", "3"] and np.array_equal(to_world, np.eye(4))
    assert (named[0][1].width, named[0][1].height) == ball_dataset.size and named[0][1].fx == pytest.approx(ball_dataset.focal)
    assert not load_dataset(ball_dataset.folder).test


@pytest.mark.parametrize("split", ["train", "test", "all", None])
def test_cameras_are_those_of_the_dataset(ball_dataset, split):
    ball_dataset.transforms(**ball_dataset.lens, k1=0.1, p2=0.01)
    settings = DataSettings(resolution=40)
    data = load_dataset(ball_dataset.folder, settings)
    views = {"train": data.train, "test": data.test}.get(split) or [*data.train, *data.test]
    named, _ = load_dataset_cameras(ball_dataset.folder, split, settings)
    expected = {v.name: v.camera for v in views}
    assert {n for n, _ in named} == set(expected)
    for name, camera in named:
        for field in ("width", "height", "fx", "fy", "cx", "cy"):
            assert getattr(camera, field) == getattr(expected[name], field)
        np.testing.assert_array_equal(camera.to_world, expected[name].to_world)


def test_no_such_split(ball_dataset):
    ball_dataset.transforms()
    with pytest.raises(InputError, match="split"):
        load_dataset_cameras(ball_dataset.folder, "validation")
    with pytest.raises(InputError, match="no test views"):
        load_dataset_cameras(ball_dataset.folder, "test", ALL)


def test_nerfstudio_points(ball_dataset):
    from plyfile import PlyData, PlyElement

    path = ball_dataset.transforms()
    rows = np.array([(1, 2, 3, 255, 0, 51)], dtype=[(c, "f4") for c in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")])
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(ball_dataset.folder / "points.ply"))
    ball_dataset.edit(path, lambda c: c.update(ply_file_path="points.ply"))
    points = load_dataset(ball_dataset.folder).points
    np.testing.assert_allclose(points.position, [[1, 2, 3]])
    np.testing.assert_allclose(points.colour, [[1, 0, 0.2]])


def test_exif_orientation_is_ignored(ball_dataset):
    names = [f"images/{i:03d}.jpg" for i in range(10)]
    ball_dataset.transforms(names=names, alpha=False)
    exif = Image.Exif()
    exif[0x0112] = 6  # rotate by a quarter turn
    for name, image in zip(names, ball_dataset.images, strict=True):
        Image.fromarray(image[..., :3]).save(ball_dataset.folder / name, quality=95, exif=exif)
    assert load_dataset(ball_dataset.folder).train[0].colour.shape == (*ball_dataset.size[::-1], 3)


@pytest.mark.parametrize("mode", ["L", "P", "LA", "1"])
def test_grey_and_palette_images(ball_dataset, mode):
    ball_dataset.transforms()
    for i, pixels in enumerate(ball_dataset.images):
        image = Image.fromarray(pixels).convert(mode) if mode in ("L", "LA") else Image.fromarray(pixels[..., :3]).convert(mode)
        image.save(ball_dataset.folder / f"images/{i:03d}.png")
    view = load_dataset(ball_dataset.folder, ALL).train[0]
    assert view.colour.shape == (*ball_dataset.size[::-1], 3) and (view.alpha is not None) == (mode == "LA")
