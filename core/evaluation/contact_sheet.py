# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact sheet: one PNG with photographs, the reconstruction's layers, and the object under its own and other lights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..errors import Cancelled
from ..io.atomic import atomic_file
from ..io.quantisation import eight_bits
from ..progress.protocol import Progress
from ..relight.prepared_light import PreparedLight, prepare_light
from ..relight.relighter import Relighter
from ..scene.dataset import Dataset, View
from ..shading.environment_lookup import turned
from ..shading.procedural_lights import studio_light, sunset_light
from . import visualisation
from .cases import spread_views

COLUMNS = ("photograph", "radiance", "recovered light", "albedo", "roughness", "metallic", "normal", "studio light", "sunset light")
LIGHT_SIZE = (64, 128)
TILE, GAP, HEADER = 224, 6, 40
PAPER, INK = (24, 25, 28), (226, 226, 222)
# Dark like the black background that masked photographs are fitted on: the outermost pixels may be too bright and too transparent at
# once, which cancels on black and would be a bright fringe on a light background.
CHECKER = (0.14, 0.18)


def contact_sheet(dataset: Dataset, relighter: Relighter, path: Path, progress: Progress, rows: int = 4) -> None:
    """Write the contact sheet as a PNG: one row per view, with the columns of COLUMNS.

    Args:
        dataset: whose test views are shown, training views where it has none.
        relighter: of the reconstruction.
        path: of the PNG.
        progress: asked between two rows whether to stop.
        rows: number of views at most, evenly spread.

    Raises:
        Cancelled: when the user stops the work.
    """
    lights = relighter.reconstruction.environment_map(), studio_light(*LIGHT_SIZE), sunset_light(*LIGHT_SIZE)
    prepared, tiles = [prepare_light(light) for light in lights], []
    views = spread_views(dataset.test or dataset.train, rows)
    progress.phase("contact sheet", len(views))
    for view in views:
        if progress.cancelled:
            raise Cancelled("stopped in the contact sheet")
        tiles.append(view_row(view, relighter, prepared))
        progress.step(len(tiles))
    sheet = compose(tiles, COLUMNS)
    with atomic_file(path) as partial:
        sheet.save(partial, "PNG")


def view_row(view: View, relighter: Relighter, lights: Sequence[PreparedLight]) -> list[np.ndarray]:
    """Render the images (H, W, 4) of one row, sRGB-encoded with straight alpha, in the order of COLUMNS.

    Args:
        view: whose photograph and camera are taken.
        relighter: of the reconstruction.
        lights: the recovered light, then the others.
    """
    camera, (width, height) = view.camera, tile_size(view.camera.width, view.camera.height, TILE)
    if width < camera.width:  # a tile shows no more pixels, and views are never enlarged beyond what was trained on
        camera = camera.resized(width, height)
    surface = relighter.surface(camera)
    buffers = relighter.gbuffer(camera, surface, view.light_rotation)
    if view.light_rotation is not None:
        lights = [prepare_light(turned(relighter.reconstruction.environment_map(), view.light_rotation)), *lights[1:]]
    own, *others = (visualisation.shaded(relighter.relit(surface, light).numpy()) for light in lights)
    photograph = visualisation.with_alpha(view.colour, np.ones(view.colour.shape[:2]) if view.alpha is None else view.alpha)
    return [
        photograph,
        visualisation.shaded(buffers.image),
        own,
        visualisation.colour(buffers.albedo, buffers.alpha),
        visualisation.grey(buffers.roughness, buffers.alpha),
        visualisation.grey(buffers.metallic, buffers.alpha),
        visualisation.normal(buffers.normal, buffers.alpha),
        *others,
    ]


def compose(rows: Sequence[Sequence[np.ndarray]], columns: Sequence[str]) -> Image.Image:
    """Lay out rows of images (H, W, 4) as one image, each in a tile on a faint checkerboard.

    Args:
        rows: of as many images as there are columns.
        columns: names written above them.
    """
    heights = [max(tile_size(p.shape[1], p.shape[0], TILE)[1] for p in row) for row in rows]
    width = GAP + len(columns) * (TILE + GAP)
    sheet = Image.new("RGB", (width, HEADER + sum(height + GAP for height in heights)), PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=17)
    for i, name in enumerate(columns):
        draw.text((GAP + i * (TILE + GAP) + TILE / 2, HEADER / 2), name, INK, font, anchor="mm")
    top = HEADER
    for row, height in zip(rows, heights, strict=True):
        for i, image in enumerate(row):
            sheet.paste(_tile(image, height), (GAP + i * (TILE + GAP), top))
        top += height + GAP
    return sheet


def tile_size(width: int, height: int, side: int) -> tuple[int, int]:
    """Return the width and height of the largest tile of the same aspect ratio.

    Args:
        width: of the image, in pixels.
        height: of the image, in pixels.
        side: largest width; the height is at most 1.5 times that.
    """
    scale = min(side / width, 1.5 * side / height)
    return max(1, round(width * scale)), max(1, round(height * scale))


def _tile(image: np.ndarray, height: int) -> Image.Image:
    """Draw an image (H, W, 4) in the middle of a tile of TILE x height pixels."""
    size = tile_size(image.shape[1], image.shape[0], TILE)
    premultiplied = np.concatenate([image[..., :3] * image[..., 3:], image[..., 3:]], -1)
    channels = [Image.fromarray(np.ascontiguousarray(premultiplied[..., i], np.float32)) for i in range(4)]
    # Unlike bicubic, this filter has no negative lobes, which would draw a bright rim around the object.
    scaled = np.clip(np.stack([np.asarray(c.resize(size, Image.Resampling.HAMMING)) for c in channels], -1), 0, 1)
    canvas = np.zeros((height, TILE, 4))
    top, left = (height - size[1]) // 2, (TILE - size[0]) // 2
    canvas[top : top + size[1], left : left + size[0]] = scaled
    rows, columns = np.indices((height, TILE)) // 14
    backdrop = np.where((rows + columns) % 2, *CHECKER)[..., None]
    return Image.fromarray(eight_bits(canvas[..., :3] + backdrop * (1 - canvas[..., 3:])))
