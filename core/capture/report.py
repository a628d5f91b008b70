# SPDX-License-Identifier: GPL-3.0-or-later
"""Report of a capture: a contact sheet of masks over photographs, and a page that says what was found and what was left out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import jinja2
import numpy as np
from PIL import Image, ImageDraw

from ..io.atomic import atomic_file, write_atomic
from ..io.quantisation import eight_bits
from .undistortion import UndistortedImage

TEMPLATE = "report.html.jinja"  # next to this module
COLUMNS, TILE, CAPTION, GAP = 6, 220, 18, 6  # columns, and pixels
PAPER, INK, OUTLINE = (24, 25, 28), (226, 226, 222), (255, 150, 40)
DIMMED = 0.35  # brightness outside the mask


def write_contact_sheet(images: Sequence[UndistortedImage], masks: Sequence[np.ndarray | None], doubtful: set[str], path: Path) -> None:
    """Write a PNG of all photographs, dimmed outside their masks, with the masks' outlines; doubtful ones are marked with "?".

    Args:
        images: V undistorted images.
        masks: V masks (H, W) in 0..1 of the views' size, or None.
        doubtful: names of photographs whose mask is uncertain.
        path: file of the PNG.
    """
    rows = -(-len(images) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * (TILE + GAP) + GAP, rows * (TILE + CAPTION + GAP) + GAP), PAPER)
    draw = ImageDraw.Draw(sheet)
    for k, (one, mask) in enumerate(zip(images, masks, strict=True)):
        left, top = GAP + k % COLUMNS * (TILE + GAP), GAP + k // COLUMNS * (TILE + CAPTION + GAP)
        tile = Image.fromarray(_tile(one.view.colour, mask))
        sheet.paste(tile, (left + (TILE - tile.width) // 2, top + (TILE - tile.height) // 2))
        draw.text((left, top + TILE + 2), one.view.name[:32] + (" ?" if one.view.name in doubtful else ""), fill=INK)
    with atomic_file(path) as partial:
        sheet.save(partial, "PNG", optimize=True)


def _tile(colour: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Return the tile (h, w, 3) uint8 of an image (H, W, 3)."""
    scale = TILE / max(colour.shape[:2])
    size = max(1, round(colour.shape[1] * scale)), max(1, round(colour.shape[0] * scale))
    pixels = cv2.resize(colour, size, interpolation=cv2.INTER_AREA)
    tile = eight_bits(pixels)
    if mask is None:
        return tile
    inside = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    tile = np.round(tile * (DIMMED + (1 - DIMMED) * inside[..., None])).astype(np.uint8)
    outlines, _ = cv2.findContours((inside > 0.5).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(np.ascontiguousarray(tile), outlines, -1, OUTLINE, 1)


def write_page(state: dict[str, Any], path: Path) -> None:
    """Write the page as HTML.

    Args:
        state: content of capture.json.
        path: file of the page; contact_sheet.png is next to it.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=jinja2.StrictUndefined
    )
    write_atomic(path, environment.get_template(TEMPLATE).render(state=state).encode())
