# SPDX-License-Identifier: GPL-3.0-or-later
"""Protocols on images whose errors are known, against metrics computed by hand."""

from dataclasses import fields, replace

import numpy as np
import pytest
from irgspp.core.errors import InputError
from irgspp.core.evaluation.ground_truth import Truth
from irgspp.core.evaluation.image_metrics import prepare_image
from irgspp.core.evaluation.prediction import Prediction
from irgspp.core.evaluation.protocols import PLAIN, PROTOCOLS, describe_protocol, protocol_named
from irgspp.core.evaluation.view_metrics import Fits, averages, fitted_metrics, relit_metrics, view_metrics
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.gbuffer import GBuffer

HEIGHT, WIDTH = 24, 32
EVERYWHERE = np.ones((HEIGHT, WIDTH), np.float32)
HALF = EVERYWHERE * (np.arange(WIDTH) < WIDTH // 2)  # the object is in the left half
Z, X = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
DISPLAY = ("plain", "tensoir", "irgs", "glossy")


def layer(value) -> np.ndarray:
    """(H, W, C) of one value everywhere."""
    return np.broadcast_to(np.asarray(value, np.float32), (HEIGHT, WIDTH, np.size(value))).copy()


def image(encoded, alpha: np.ndarray = EVERYWHERE) -> np.ndarray:
    """(H, W, 4) linear premultiplied, of encoded straight colour."""
    return np.concatenate([decode_srgb(layer(encoded)) * alpha[..., None], alpha[..., None]], -1)


def predicted(rgba: np.ndarray | None = None, alpha: np.ndarray = EVERYWHERE, relit: dict | None = None, **layers) -> Prediction:
    """A prediction with the given layers; what is not given is plain."""
    camera = Camera(WIDTH, HEIGHT, 40.0, 40.0, WIDTH / 2, HEIGHT / 2, np.eye(4))
    plain = {"normal": layer(Z), "depth": EVERYWHERE, "albedo": layer([0.5] * 3), "roughness": EVERYWHERE, "metallic": EVERYWHERE}
    buffers = GBuffer(camera, alpha=alpha, radiance=layer([0.5] * 3), **(plain | layers))
    return Prediction(buffers, image([0.5] * 3) if rgba is None else rgba, relit or {})


def true_view(encoded=(0.5, 0.5, 0.5), alpha: np.ndarray = EVERYWHERE, **known) -> Truth:
    return Truth(layer(encoded) * alpha[..., None], alpha, **known)


def db(mean_square: float) -> float:
    return -10 * np.log10(mean_square)


# --- images


@pytest.mark.parametrize(("name", "error"), [("plain", 0.1), ("tensoir", 0.1), ("irgs", 0.1), ("glossy", 153 / 255 - 128 / 255)])
def test_a_constant_offset_d_is_minus_20_log_d(name, error):
    """With eight bits neither 0.5 nor an offset of 0.1 is exact."""
    measured = view_metrics(predicted(image([0.6] * 3)), true_view(), PROTOCOLS[name])
    assert measured["nvs_psnr"] == measured["nvs_psnr_object"] == pytest.approx(-20 * np.log10(error), abs=1e-4)


@pytest.mark.parametrize(("name", "error"), [("plain", 0.6**2 / 2), ("tensoir", 0.4**2 / 2), ("irgs", 0.0), ("glossy", 0.4**2 / 2)])
def test_an_object_too_large_costs_what_the_background_says(name, error):
    """Right on the object, and 0.6 where black or white should be; only IRGS multiplies by the true mask."""
    truth = true_view([0.6] * 3, HALF)
    measured = view_metrics(predicted(relit={"a": image([0.6] * 3)}), replace(truth, relit={"a": truth.image}), PROTOCOLS[name])
    assert measured["relight_a_psnr"] == (100 if error == 0 else pytest.approx(db(error), abs=1e-4))
    assert measured["relight_a_psnr_object"] == 100


@pytest.mark.parametrize(
    ("name", "alpha", "value"),
    [
        ("plain", 0.4, 0.4 * 0.6),
        ("irgs", 0.4, 0.4 * 0.6 * 0.8),
        ("glossy", 0.4, round(255 * (0.4 * 0.6 + 0.6)) / 255),
        ("tensoir", 0.4, 1.0),
        ("tensoir", 0.6, 0.6),
    ],
)
def test_what_is_half_transparent_is_shown_as_the_code_of_each_shows_it(name, alpha, value):
    rgba = image([0.6] * 3, alpha * EVERYWHERE)
    assert np.allclose(prepare_image("relight", rgba, true_view(alpha=0.8 * EVERYWHERE), PROTOCOLS[name]), value, atol=1e-5)


def test_images_of_radiance_keep_their_own_silhouette():
    """TensoIR cuts shaded and relit images by the silhouette, IRGS relit ones only."""
    rgba, truth = image([0.6] * 3, 0.6 * EVERYWHERE), true_view(alpha=0.8 * EVERYWHERE)
    soft = {"tensoir": 0.6 * 0.6 + 0.4, "irgs": 0.6 * 0.6}
    cut = {"tensoir": 0.6, "irgs": 0.6 * 0.6 * 0.8}
    for name, kinds in {"tensoir": ("nvs", "relight"), "irgs": ("relight",)}.items():
        for kind in ("nvs", "radiance", "relight"):
            expected = cut[name] if kind in kinds else soft[name]
            assert np.allclose(prepare_image(kind, rgba, truth, PROTOCOLS[name]), expected, atol=1e-5), (name, kind)


def test_glossy_scales_each_image_with_its_white_background():
    ours, true = 102 / 255, 153 / 255
    how = PROTOCOLS["glossy"]
    prediction = predicted(relit={"golf": image([ours] * 3, HALF)})
    measured = relit_metrics(prediction, replace(true_view(), relit={"golf": layer([true] * 3) * HALF[..., None]}, alpha=HALF), how)
    scale = (ours * true + 1) / (ours**2 + 1)  # half of the pixels are white in both
    assert measured["relight_golf_psnr"] == pytest.approx(db((ours - true) ** 2 / 2), abs=1e-4)
    assert measured["relight_golf_psnr_scaled"] == pytest.approx(db(((scale * ours - true) ** 2 + (scale - 1) ** 2) / 2), abs=1e-4)
    assert "relight_golf_ssim_scaled" in measured


def test_lpips_is_asked_about_the_images_that_are_compared():
    mean = {"": lambda a, b: float(np.abs(a - b).mean()), "_alex": lambda a, b: float(a.max())}
    measured = view_metrics(predicted(image([0.6] * 3)), true_view([0.6] * 3, HALF), PROTOCOLS["tensoir"], mean)
    assert measured["nvs_lpips"] == pytest.approx(0.2, abs=1e-6) and measured["nvs_lpips_alex"] == pytest.approx(0.6, abs=1e-6)


# --- albedo


def test_scaled_albedo_gives_the_exact_scale_in_every_protocol():
    albedo = np.random.default_rng(0).uniform(0.1, 0.6, (HEIGHT, WIDTH, 3)).astype(np.float32)
    factor = np.array([0.5, 1.25, 2.0], np.float32)
    truth, prediction = true_view(albedo=albedo), predicted(albedo=albedo / factor)
    for how in PROTOCOLS.values():
        fits = Fits(how)
        fits.gather(prediction, truth)
        row = fitted_metrics(prediction, truth, fits, how)
        assert row["albedo_psnr"] > 90 and row["albedo_ssim"] == pytest.approx(1, abs=1e-6), how.name
        assert fits.albedo is None if how.scale_each_view else np.allclose(fits.albedo, factor, rtol=1e-5)


def test_least_squares_and_median_differ_as_they_should():
    """A quarter of the pixels is 0.2 instead of 0.4, which the median ignores."""
    few = np.arange(WIDTH) < WIDTH // 4
    albedo = np.where(few[None, :, None], layer([0.2] * 3), layer([0.4] * 3))
    prediction, truth = predicted(albedo=albedo), true_view(albedo=layer([0.4] * 3))
    for how, expected in ((PLAIN, 1.0), (replace(PLAIN, scale="least squares"), (0.25 * 0.08 + 0.75 * 0.16) / (0.25 * 0.04 + 0.75 * 0.16))):
        fits = Fits(how)
        fits.gather(prediction, truth)
        assert np.allclose(fits.albedo, expected, rtol=1e-5)


def test_irgs_leaves_black_pixels_out_of_the_scale():
    black = np.where((np.arange(WIDTH) < 20)[None, :, None], 0, layer([0.3] * 3))
    prediction, truth = predicted(albedo=layer([0.2] * 3)), true_view(albedo=black)
    scales = {}
    for name in ("irgs", "plain"):
        fits = Fits(PROTOCOLS[name])
        fits.gather(prediction, truth)
        scales[name] = fits.albedo
    assert np.allclose(scales["irgs"], 1.5) and np.allclose(scales["plain"], 0)


def test_tensoir_takes_albedo_at_a_power_on_white_and_pools_the_views():
    how, rows = PROTOCOLS["tensoir"], []
    fits, pairs = Fits(how), []
    for true, ours in ((0.2, 0.2), (0.4, 0.4), (0.2, 0.3)):
        pairs.append((predicted(albedo=layer([ours] * 3), alpha=HALF), true_view(alpha=HALF, albedo=layer([true] * 3))))
        fits.gather(*pairs[-1])
    assert np.allclose(fits.albedo, 1)
    rows = [fitted_metrics(prediction, truth, fits, how) for prediction, truth in pairs]
    error = (0.3 ** (1 / 2.2) - 0.2 ** (1 / 2.2)) ** 2 / 2  # the white half is right
    assert [row["albedo_psnr"] for row in rows] == [100, 100, pytest.approx(db(error), abs=1e-4)]
    assert averages(rows, [], how)["albedo_psnr"] == pytest.approx(db(error / 3), abs=1e-4)


def test_tensoir_looks_at_20_views_for_the_scale():
    how, fits = PROTOCOLS["tensoir"], Fits(PROTOCOLS["tensoir"])
    for i in range(60):  # every third one says 2, the others 3
        fits.gather(predicted(albedo=layer([0.1] * 3)), true_view(albedo=layer([0.2 if i % 3 == 0 else 0.3] * 3)))
    assert how.scale_views == 20 and np.allclose(fits.albedo, 2)


# --- normals, depth, shape


def turned(degrees: float) -> np.ndarray:
    return layer(np.cos(np.radians(degrees)) * Z + np.sin(np.radians(degrees)) * X)


@pytest.mark.parametrize("name", PROTOCOLS)
def test_normals_turned_by_a_known_angle(name):
    """Half of the image is background, right in all of them: the full image's mean is half of the object's."""
    truth = true_view(alpha=HALF, normal=turned(0) * HALF[..., None], depth=HALF)
    measured = view_metrics(predicted(image([0.5] * 3, HALF), HALF, normal=turned(30)), truth, PROTOCOLS[name])
    assert measured["normal_mae"] == pytest.approx(30, abs=1e-3) and measured["normal_mae_full"] == pytest.approx(15, abs=1e-3)
    assert measured.get("normal_cosine", 1 - np.cos(np.radians(30))) == pytest.approx(1 - np.cos(np.radians(30)), abs=1e-5)


def test_normals_outside_the_object_count_where_the_paper_counts_them():
    """Normals to +X on the whole image, of an object in its left half: the right half is +Z in IRGS and TensoIR."""
    truth = true_view(alpha=HALF, normal=layer(X) * HALF[..., None], depth=HALF)
    found = {
        name: view_metrics(predicted(normal=layer(X)), truth, PROTOCOLS[name])["normal_mae_full"] for name in ("plain", "irgs", "tensoir")
    }
    assert found == {"plain": 0, "irgs": pytest.approx(45), "tensoir": pytest.approx(45)}
    faint = view_metrics(
        predicted(alpha=0.5 * EVERYWHERE, normal=layer(X)), replace(truth, alpha=EVERYWHERE, normal=layer(X)), PROTOCOLS["irgs"]
    )
    assert faint["normal_mae"] == pytest.approx(0, abs=1e-4) and faint["normal_mae_full"] == pytest.approx(45)


def test_depth_up_to_a_factor():
    how = PROTOCOLS["stanford-orb"]
    depth = np.where(HALF > 0, 2.0, 4.0).astype(np.float32)
    truth = true_view(depth=depth)
    for ours, unit, expected in ((3 * depth, 1.0, 0.0), (np.full_like(depth, 5), 1.0, 1.0), (np.full_like(depth, 5), 2.0, 0.25)):
        fits = Fits(how)
        fits.gather(predicted(depth=ours), truth)
        row = fitted_metrics(predicted(depth=ours), truth, fits, how, unit)
        assert row["depth_si_mse"] == pytest.approx(expected, abs=1e-6)  # 5 becomes 3, which is 1 off everywhere


# --- Stanford-ORB's images


def halves(left: float, right: float) -> np.ndarray:
    """(H, W, 4) linear, two values on an opaque image."""
    return np.concatenate([np.where(HALF[..., None] > 0, layer([left] * 3), layer([right] * 3)), EVERYWHERE[..., None]], -1)


def orb(ours: np.ndarray, true: np.ndarray, alpha: np.ndarray = EVERYWHERE) -> dict[str, float]:
    truth = Truth(encode_srgb(true[..., :3]) * alpha[..., None], alpha)
    return view_metrics(predicted(ours), truth, PROTOCOLS["stanford-orb"])


def test_radiance_is_compared_after_a_scale():
    measured = orb(halves(0.1, 0.7) * [4, 0.25, 9, 1], halves(0.1, 0.7))
    assert measured["nvs_psnr_hdr"] == measured["nvs_psnr_ldr"] == 100 and measured["nvs_ssim"] == pytest.approx(1)


def test_radiance_with_its_halves_swapped():
    a, b = 0.6, 0.8
    scale, brightness = 2 * a * b / (a * a + b * b), (encode_srgb(np.array(a)) + encode_srgb(np.array(b))) / (a + b)
    errors = [scale * a - b, scale * b - a]
    encoded = [encode_srgb(np.array(scale * x)) - encode_srgb(np.array(y)) for x, y in ((a, b), (b, a))]
    measured = orb(halves(a, b), halves(b, a))
    assert measured["nvs_psnr_hdr"] == pytest.approx(db(brightness**2 * np.mean(np.square(errors))), abs=1e-3)
    assert measured["nvs_psnr_ldr"] == pytest.approx(db(np.mean(np.square(encoded))), abs=1e-3)


def test_what_is_brighter_than_a_display_counts_in_psnr_hdr_alone():
    measured = orb(halves(0.5, 2.0), halves(0.5, 2.2))
    brightness = (encode_srgb(np.array(0.5)) + 1) / 1.5
    scale = (0.25 + 4.4) / (0.25 + 4.0)
    hdr = (brightness * 0.5 * (scale - 1)) ** 2 + (brightness * (2 * scale - 2.2)) ** 2
    assert measured["nvs_psnr_hdr"] == pytest.approx(db(hdr / 2), abs=1e-3)
    ldr = (encode_srgb(np.array(0.5 * scale)) - encode_srgb(np.array(0.5))) ** 2
    assert measured["nvs_psnr_ldr"] == pytest.approx(db(ldr / 2), abs=1e-3)


def test_the_mask_loses_two_pixels_and_the_error_is_of_the_whole_image():
    box = np.zeros_like(EVERYWHERE)
    box[5:16, 8:20] = 1  # 11 x 12, of which 7 x 8 stay
    ours = halves(0.4, 0.4)
    ours[10, 12, :3] = 0.1  # inside
    ours[5, 8, :3] = 9.0  # at the edge of the mask, which doesn't count
    measured = orb(ours, halves(0.4, 0.4), box)
    scale = (55 * 0.16 + 0.04) / (55 * 0.16 + 0.01)
    errors = 55 * (encode_srgb(np.array(scale * 0.4)) - encode_srgb(np.array(0.4))) ** 2
    errors += (encode_srgb(np.array(scale * 0.1)) - encode_srgb(np.array(0.4))) ** 2
    assert measured["nvs_psnr_ldr"] == pytest.approx(db(errors / (HEIGHT * WIDTH)), abs=1e-3)


def test_nothing_is_worse_than_a_middle_grey():
    measured = orb(halves(0, 0), halves(0.4, 0.4))
    grey = (0.5 - encode_srgb(np.array(0.4))) ** 2
    assert measured["nvs_psnr_ldr"] == pytest.approx(db(grey), abs=1e-3)


# --- the table says which choices were made


def test_every_choice_is_said():
    other = {"name": "x", "follows": "x", "silhouette": "true", "scale": "least squares", "scale_pixels": "lit"}
    other |= {"relit_views": 3, "scale_views": 3, "light_grid": (8, 16), "background": 1.0, "cut": ("nvs",)}
    for field in fields(PLAIN):
        if field.name in ("samples", "lpips"):
            continue  # of what the report was made, which it says itself
        how = replace(PLAIN, silhouette="true") if field.name == "cut" else PLAIN
        value = other.get(field.name, not getattr(PLAIN, field.name))
        assert describe_protocol(replace(how, **{field.name: value})) != describe_protocol(how), field.name


def test_protocols_go_by_their_names():
    assert [protocol_named(name).name for name in PROTOCOLS] == list(PROTOCOLS) == [*DISPLAY[:4], "stanford-orb"]
    assert len({tuple(describe_protocol(how)) for how in PROTOCOLS.values()}) == len(PROTOCOLS)
    with pytest.raises(InputError, match="there is no nerf; use plain, tensoir"):
        protocol_named("nerf")
