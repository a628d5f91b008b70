# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs of every kind become upright sRGB pixels; truncated and hostile files are refused by name."""

import io
import struct
import zlib

import cv2
import numpy as np
import pillow_heif
import pytest
from irgspp.core.capture.decoding import decode_photograph
from irgspp.core.capture.exif import ORIENTATION, Orientation
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from PIL import Image, ImageCms, ImageOps
from refused import refused

pillow_heif.register_heif_opener()
P3 = ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))  # primaries of Display P3
D65 = (0.3127, 0.3290)


def xyz(x, y):
    return np.array([x / y, 1, (1 - x - y) / y])


def to_xyz(primaries):
    """Matrix (3, 3) from linear colours of some primaries to XYZ with white D65."""
    columns = np.stack([xyz(*p) for p in primaries], 1)
    return columns * np.linalg.solve(columns, xyz(*D65))


def profile_of(primaries):
    """ICC profile with the curve of sRGB and other primaries, adapted to D50 as the format asks for."""
    bradford = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    white, d50 = bradford @ xyz(*D65), bradford @ np.array([0.9642, 1, 0.8249])
    columns = (np.linalg.inv(bradford) @ np.diag(d50 / white) @ bradford @ to_xyz(primaries)).T

    def number(value):
        return struct.pack(">i", round(value * 65536))

    curve = b"para" + struct.pack(">IHH", 0, 3, 0) + b"".join(map(number, (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)))
    described = b"desc" + struct.pack(">II", 0, 2) + b"x\0" + bytes(78)
    tags = {b"desc": described + bytes(-len(described) % 4), b"wtpt": b"XYZ " + bytes(4) + b"".join(map(number, (0.9642, 1, 0.8249)))}
    tags |= {name: b"XYZ " + bytes(4) + b"".join(map(number, c)) for name, c in zip((b"rXYZ", b"gXYZ", b"bXYZ"), columns, strict=True)}
    tags |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve)
    table, body, at = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    for name, data in tags.items():
        table, body = table + name + struct.pack(">II", at + len(body), len(data)), body + data
    head = struct.pack(">I4sI4s4s4s12x4s28x", 0, bytes(4), 0x02400000, b"mntr", b"RGB ", b"XYZ ", b"acsp")
    head += b"".join(map(number, (0.9642, 1, 0.8249))) + bytes(48)
    made = head + table + body
    return struct.pack(">I", len(made)) + made[4:]


SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


@pytest.mark.parametrize(("suffix", "error"), [(".png", 0), (".tif", 0), (".webp", 8), (".jpg", 2), (".heic", 8)])
def test_pixels_of_each_kind(tmp_path, views, suffix, error):
    pixels = views(0, sigma=3)
    options = {} if suffix in (".png", ".tif") else {"quality": 98} | ({"subsampling": 0} if suffix == ".jpg" else {})
    Image.fromarray(pixels).save(tmp_path / f"a{suffix}", **options)
    found = decode_photograph(tmp_path / f"a{suffix}")
    assert found.colour.dtype == np.uint8 and found.alpha is None and not found.notes
    assert np.abs(found.colour.astype(int) - pixels).mean() <= error
    assert found.lossless == (suffix in (".png", ".tif")) and found.unchanged == (suffix == ".jpg")


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".webp", ".heic"])
@pytest.mark.parametrize("value", range(1, 9))
def test_orientation_is_applied_once(tmp_path, exif, suffix, value):
    corner = np.full((16, 32, 3), 40, np.uint8)
    corner[:8, :16] = 220
    image = Image.fromarray(corner)
    if suffix == ".tif":
        image.getexif()[ORIENTATION] = value
        image.save(tmp_path / "a.tif", exif=image.getexif())
    else:
        image.save(tmp_path / f"a{suffix}", exif=exif({ORIENTATION: value}), quality=100)
    image.getexif()[ORIENTATION] = value
    right = np.asarray(ImageOps.exif_transpose(image)).astype(int)
    found = decode_photograph(tmp_path / f"a{suffix}")
    assert found.colour.shape == right.shape and np.abs(found.colour - right).max() < 20
    assert not found.unchanged or value == 1


def test_sixteen_bits_are_kept(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 65536, (20, 30, 4)).astype(np.uint16)
    for suffix in (".png", ".tif"):
        for channels in (3, 4):
            cv2.imwrite(str(tmp_path / f"a{suffix}"), cv2.cvtColor(pixels, cv2.COLOR_RGBA2BGRA if channels == 4 else cv2.COLOR_RGBA2BGR))
            found = decode_photograph(tmp_path / f"a{suffix}")
            assert np.array_equal(found.colour, pixels[..., :3]) and found.lossless
            assert (found.alpha is None) if channels == 3 else np.array_equal(found.alpha, pixels[..., 3])
        cv2.imwrite(str(tmp_path / f"grey{suffix}"), pixels[..., 0])
        assert np.array_equal(decode_photograph(tmp_path / f"grey{suffix}").colour, np.repeat(pixels[..., :1], 3, -1))


@pytest.mark.parametrize("mode", ["L", "LA", "P", "1", "CMYK", "RGBA", "I;16"])
def test_other_modes(tmp_path, mode):
    image = Image.new("L", (8, 6), 200).convert(mode) if mode != "I;16" else Image.fromarray(np.full((6, 8), 200 * 257, np.uint16))
    image.save(tmp_path / "a.tif")
    found = decode_photograph(tmp_path / "a.tif")
    level = found.colour[3, 4] // (257 if found.colour.dtype == np.uint16 else 1)
    assert found.alpha is None and np.all(np.abs(level.astype(int) - (255 if mode == "1" else 200)) <= 2)


def test_alpha_is_separate_and_turned(tmp_path, exif):
    pixels = np.full((8, 12, 4), 255, np.uint8)
    pixels[:, :6, 3] = 0
    Image.fromarray(pixels).save(tmp_path / "a.png", exif=exif({ORIENTATION: 6}))
    found = decode_photograph(tmp_path / "a.png")
    assert found.alpha.shape == (12, 8) and not found.alpha[:6].any() and found.alpha[6:].all()
    pixels[..., 3] = 255
    Image.fromarray(pixels).save(tmp_path / "a.png")
    assert decode_photograph(tmp_path / "a.png").alpha is None


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".heic"])
def test_display_p3_is_converted(tmp_path, suffix):
    colour = np.array([200, 120, 60], np.uint8)
    Image.fromarray(np.full((16, 16, 3), colour)).save(tmp_path / f"a{suffix}", icc_profile=profile_of(P3), quality=98)
    rec709 = to_xyz(((0.64, 0.33), (0.30, 0.60), (0.15, 0.06)))
    right = 255 * encode_srgb(np.linalg.solve(rec709, to_xyz(P3) @ decode_srgb(colour / 255)))
    found = decode_photograph(tmp_path / f"a{suffix}")
    assert np.abs(found.colour[8, 8] - right).max() < (2 if suffix == ".png" else 6) and np.abs(right - colour).max() > 9
    assert not found.unchanged and not found.notes


def test_heic_with_numbered_colours(tmp_path):
    colour = np.full((16, 16, 3), (200, 120, 60), np.uint8)
    options = {"color_primaries": 12, "transfer_characteristics": 13, "matrix_coefficients": 6, "full_range_flag": 1, "quality": 98}
    Image.fromarray(colour).save(tmp_path / "a.heic", save_nclx_profile=True, **options)
    rec709 = to_xyz(((0.64, 0.33), (0.30, 0.60), (0.15, 0.06)))
    right = 255 * encode_srgb(np.linalg.solve(rec709, to_xyz(P3) @ decode_srgb(colour[0, 0] / 255)))
    assert np.abs(decode_photograph(tmp_path / "a.heic").colour[8, 8] - right).max() < 5


def test_sixteen_bits_of_another_profile_become_eight_and_say_so(tmp_path):
    pixels = np.full((8, 8, 3), (60, 120, 200), np.uint16) * 257
    data = cv2.imencode(".png", pixels)[1].tobytes()
    body = b"x\0\0" + zlib.compress(profile_of(P3))
    chunk = struct.pack(">I", len(body)) + b"iCCP" + body + struct.pack(">I", zlib.crc32(b"iCCP" + body))
    (tmp_path / "a.png").write_bytes(data[:33] + chunk + data[33:])
    found = decode_photograph(tmp_path / "a.png")
    assert found.colour.dtype == np.uint8 and "reduced to 8 bits" in found.notes[0] and found.colour[0, 0, 0] > 208


def test_srgb_profile_changes_nothing_and_a_damaged_one_is_told(tmp_path, views):
    image = Image.fromarray(views(0))
    image.save(tmp_path / "a.jpg", icc_profile=SRGB)
    assert decode_photograph(tmp_path / "a.jpg").unchanged
    image.save(tmp_path / "b.jpg", icc_profile=b"no profile")
    found = decode_photograph(tmp_path / "b.jpg")
    assert found.unchanged and "colour profile can't be used" in found.notes[0]
    image.convert("L").save(tmp_path / "c.jpg", icc_profile=SRGB)
    assert "for RGB pixels, not L" in decode_photograph(tmp_path / "c.jpg").notes[0]


def test_first_of_several_pictures_is_read(tmp_path):
    first, second = Image.new("RGB", (16, 12), (200, 10, 10)), Image.new("RGB", (8, 6))
    first.save(tmp_path / "gain.jpg", "MPO", save_all=True, append_images=[second])
    found = decode_photograph(tmp_path / "gain.jpg")
    assert found.size == (16, 12) and found.unchanged


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".webp", ".heic", ".dng"])
@pytest.mark.parametrize("part", [0.0, 0.3, 0.8])
def test_truncated_files_are_refused_by_name(tmp_path, views, writers, suffix, part):
    path = tmp_path / f"broken{suffix}"
    if suffix == ".dng":
        writers.write_dng(path, views(0) / 255)
    else:
        Image.fromarray(views(0)).save(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    with refused(f"broken{suffix}", "photograph"):
        decode_photograph(path)


def test_claims_of_many_pixels_are_refused(tmp_path):
    data = io.BytesIO()
    Image.new("RGB", (16, 16)).save(data, "PNG")
    head = bytearray(data.getvalue())
    head[16:24] = struct.pack(">II", 30_000, 30_000)
    head[29:33] = struct.pack(">I", zlib.crc32(head[12:29]))
    (tmp_path / "a.png").write_bytes(head)
    with refused("900000000 pixels"):
        decode_photograph(tmp_path / "a.png")
    Image.new("RGB", (3000, 3000)).save(tmp_path / "a.webp", lossless=True)
    with refused("far more pixels"):
        decode_photograph(tmp_path / "a.webp")
    with refused("gone.jpg", "can't be read"):
        decode_photograph(tmp_path / "gone.jpg")


def test_floating_point_tiff_is_refused(tmp_path):
    Image.fromarray(np.zeros((4, 4), np.float32)).save(tmp_path / "a.tif")
    with refused("floating-point pixels"):
        decode_photograph(tmp_path / "a.tif")


@pytest.mark.parametrize("value", [1, 3, 6, 8])
def test_raw_is_linear_light_encoded_as_srgb(tmp_path, writers, value):
    linear = np.full((64, 64, 3), (0.2, 0.4, 0.1))
    linear[:32, :32] = 0.5, 0.1, 0.3
    writers.write_dng(tmp_path / "a.dng", linear[:, :60], value)
    found = decode_photograph(tmp_path / "a.dng")
    right = Orientation({1: 0, 3: 2, 6: 3, 8: 1}[value]).upright(encode_srgb(linear[:, :60]))
    assert found.colour.dtype == np.uint16 and found.lossless and not found.unchanged and found.colour.shape == right.shape
    assert np.percentile(np.abs(found.colour / 65535 - right), 80) < 1e-3  # all but the pixels at the edges between colours


def test_raw_keeps_exposure(tmp_path, writers):
    writers.write_dng(tmp_path / "dark.dng", np.full((32, 32, 3), 0.05))
    writers.write_dng(tmp_path / "bright.dng", np.full((32, 32, 3), 0.9))
    dark, bright = (decode_photograph(tmp_path / f"{n}.dng") for n in ("dark", "bright"))
    levels = [decode_srgb(p.colour[16, 16] / 65535) for p in (dark, bright)]
    assert np.allclose(levels[1] / levels[0], 18, rtol=0.01)
    assert dark.shot.exposure == pytest.approx(200 / 60 / 1.8**2, rel=1e-3) and dark.shot.focal == pytest.approx(
        28 * 32 / 36 * np.sqrt(18 / 13)
    )
    assert dark.shot.lens == "Lab|Camera||4.5 mm"
