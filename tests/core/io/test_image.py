# SPDX-License-Identifier: GPL-3.0-or-later
"""Images whose headers claim too many pixels are refused before they are decoded."""

import struct
import zlib

import numpy as np
import OpenEXR
from irgspp.core.io.exr import read_exr, read_exr_rgb
from irgspp.core.io.image import image_size, read_depth_mask, read_image, read_mask
from irgspp.core.scene.environment_files import read_environment
from refused import refused


def png_bomb(side=60_000):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 16, 6, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(b"\0" * 10_000)) + chunk(b"IEND", b"")


def exr_bomb(path, side=60_000):
    """A small EXR whose header claims to be large."""
    pixels = {c: np.zeros((8, 8), np.float32) for c in "RGB"}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, pixels).write(str(path))
    data = path.read_bytes()
    box = struct.pack("<4i", 0, 0, 7, 7)
    assert data.count(box) == 2
    path.write_bytes(data.replace(box, struct.pack("<4i", 0, 0, side - 1, side - 1)))


def test_enormous_images_are_refused_before_they_are_decoded(tmp_path):
    (tmp_path / "a.png").write_bytes(png_bomb())
    exr_bomb(tmp_path / "a.exr")
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n" + b"\2\2\0\0" * 100)
    for read in (image_size, read_image, read_mask, lambda p: read_depth_mask(p, 0.5), read_environment):
        for name in ("a.png", "a.exr"):
            with refused(name, "60000x60000", "million"):
                read(tmp_path / name)
    for read in (read_exr, read_exr_rgb):
        with refused(r"a\.exr", "60000x60000"):
            read(tmp_path / "a.exr")
    with refused(r"a\.hdr", "60000x60000"):
        read_environment(tmp_path / "a.hdr")


def test_a_text_file_is_refused_in_one_line_that_names_it_once(tmp_path):
    file = tmp_path / "notes.png"
    file.write_text("This is no photograph.")
    with refused("cannot identify image file") as caught:
        image_size(file)
    assert str(caught.value).count("notes.png") == 1 and "\n" not in str(caught.value)
