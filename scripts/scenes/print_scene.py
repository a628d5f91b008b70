# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene of the kind "print": a jar with a finely printed label and an engraved band, whose texture has detail down to single pixels."""

from __future__ import annotations

from math import tau

import bpy
import numpy as np
from irgspp.core.io.srgb import decode_srgb
from PIL import Image, ImageDraw, ImageFilter, ImageFont

from .mesh_objects import empty_file, finished
from .shader_nodes import ShaderNodes

PRINT = 4096, 2816  # texels of the printed texture around the jar and from its lower to its upper pole
RADIUS, HEIGHT, ROUNDNESS = 0.72, 0.95, 0.32  # radius, half height, and exponent of the superellipse: the smaller, the more like a can
ENGRAVED = (0.10, 0.24)  # band of the engraved letters, fractions of the print's height from its upper edge
DEPTH = 0.012  # of the engraving
GROUND, PAPER, INKS = (46, 92, 104), (226, 214, 188), ((24, 22, 26), (150, 32, 28), (28, 58, 128), (196, 132, 24), (32, 104, 52))
WORDS = ["photographs", "in,", "a", "relightable", "object", "out;", "albedo,", "roughness,", "metallic", "and", "normal", "of", "every"]
WORDS += ["texel;", "light", "and", "shadow", "apart."]
SEED = 3


def build_print_scene(columns: int = 1024, rows: int = 640) -> list[bpy.types.Object]:
    """Fill an empty file with the jar, inside radius 1.3 around the origin, and return it.

    Args:
        columns: vertices around the jar.
        rows: vertices from pole to pole.
    """
    empty_file()
    jar = _jar(columns, rows)
    nodes = ShaderNodes("print")
    image = nodes.material.node_tree.nodes.new("ShaderNodeTexImage")
    image.image, image.interpolation = _blender_image(printed_colours()), "Cubic"
    nodes.connect(image.outputs["Color"], "Base Color")
    nodes.connect(nodes.mapped(nodes.noise(1.3, 8.0), 0.4, 0.55), "Roughness")
    return [finished(jar, nodes.material)]


def printed_colours() -> np.ndarray:
    """Return the print, (H, W, 3) uint8, sRGB: ground, paper label with text of many sizes, gratings, dots, and coloured patches."""
    width, height = PRINT
    page, random = Image.new("RGB", PRINT, GROUND), np.random.default_rng(SEED)
    draw = ImageDraw.Draw(page)
    top, bottom = int(0.30 * height), int(0.86 * height)
    draw.rectangle((0, top, width, bottom), fill=PAPER)
    for edge in (top + 12, bottom - 24):
        draw.rectangle((0, edge, width, edge + 12), fill=INKS[1])
    for column in range(8):
        left = column * width // 8 + 24
        if column % 2:
            _draw_patterns(draw, left, top + 60, width // 8 - 48, bottom - top - 120, random)
        else:
            _draw_text(draw, left, top + 60, width // 8 - 48, bottom - top - 120, random)
    return np.asarray(page.filter(ImageFilter.GaussianBlur(0.7)))


def _draw_text(draw: ImageDraw.ImageDraw, left: int, top: int, width: int, height: int, random: np.random.Generator) -> None:
    """Fill a column with lines of text in sizes from 18 to 96 texels."""
    y = top
    while y < top + height - 100:
        size = int(random.choice([18, 22, 26, 32, 44, 64, 96]))
        font, ink, line = ImageFont.load_default(size), INKS[random.integers(len(INKS))], ""
        while draw.textlength(line + "mmmm", font=font) < width:
            line += WORDS[random.integers(len(WORDS))] + " "
        draw.text((left, y), line, fill=ink, font=font)
        y += int(1.25 * size)


def _draw_patterns(draw: ImageDraw.ImageDraw, left: int, top: int, width: int, height: int, random: np.random.Generator) -> None:
    """Fill a column with gratings in several directions, dots and patches of colour."""
    cell = width // 3
    for y in range(top, top + height - cell, cell):
        for x in range(left, left + 3 * cell - 1, cell):
            ink, pitch, kind = INKS[random.integers(len(INKS))], int(random.integers(6, 24)), random.integers(4)
            inside = (x + 6, y + 6, x + cell - 6, y + cell - 6)
            if kind == 0:
                draw.rectangle(inside, fill=ink)
            for k in range(inside[0], inside[2] - pitch, pitch):
                if kind == 1:
                    draw.rectangle((k, inside[1], k + pitch // 2, inside[3]), fill=ink)
                elif kind == 2:
                    draw.rectangle((inside[0], k - x + y, inside[2], k - x + y + pitch // 2), fill=ink)
                elif kind == 3:
                    for row in range(inside[1], inside[3] - pitch, pitch):
                        draw.ellipse((k, row, k + 0.7 * pitch, row + 0.7 * pitch), fill=ink)


def engraving() -> np.ndarray:
    """Return the depth of the engraved letters over the print, (H, W) float in 0..1, with walls a few texels wide."""
    width, height = PRINT
    mask = Image.new("L", PRINT, 0)
    draw = ImageDraw.Draw(mask)
    top, bottom = (int(fraction * height) for fraction in ENGRAVED)
    font = ImageFont.load_default(0.8 * (bottom - top))
    draw.text((40, top), "ENGRAVED * 2026 * IRGS * DETAIL *", fill=255, font=font)
    for row in (top - 16, bottom + 8):
        draw.rectangle((0, row, width, row + 10), fill=255)
    return np.asarray(mask.filter(ImageFilter.GaussianBlur(4)), np.float32) / 255


def _jar(columns: int, rows: int) -> bpy.types.Object:
    """Return the jar with UVs over the print: u around the axis, v along the profile."""
    profile = _profile(rows)
    u, v = np.arange(columns + 1) / columns, np.arange(rows) / (rows - 1)
    depth = engraving()[np.clip(((1 - v) * PRINT[1]).astype(int), 0, PRINT[1] - 1)][:, (u * PRINT[0]).astype(int) % PRINT[0]]
    tangent = np.gradient(profile, axis=0)
    outward = np.stack([tangent[:, 1], -tangent[:, 0]], -1) / np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-12)
    shape = profile[:, None] - DEPTH * depth[..., None] * outward[:, None]
    angle = tau * u[None]
    points = np.stack([shape[..., 0] * np.cos(angle), shape[..., 0] * np.sin(angle), shape[..., 1]], -1)
    corner = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)
    quads = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]], -1).reshape(-1, 4)
    # The last column lies on the first one: it has the same vertices, but UVs of its own.
    same = np.where(np.arange(columns + 1) == columns, 0, np.arange(columns + 1))
    shared = (np.arange(rows)[:, None] * columns + same).ravel()
    mesh = bpy.data.meshes.new("jar")
    lids = np.arange(columns)[::-1], (rows - 1) * columns + np.arange(columns)  # over the tiny holes at the poles
    mesh.from_pydata(points[:, :-1].reshape(-1, 3).tolist(), [], [*shared[quads].tolist(), *(lid.tolist() for lid in lids)])
    uvs = np.stack(np.broadcast_arrays(u[None], v[:, None]), -1).reshape(-1, 2)
    loops = np.concatenate([uvs[quads].reshape(-1, 2), np.repeat([[0.5, 0.0], [0.5, 1.0]], columns, 0)])
    mesh.uv_layers.new().data.foreach_set("uv", loops.astype(np.float32).ravel())
    jar = bpy.data.objects.new("jar", mesh)
    bpy.context.scene.collection.objects.link(jar)
    return jar


def _profile(rows: int) -> np.ndarray:
    """Return radius and height from the lower to the upper pole at even arc lengths, (rows, 2)."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 20_000)
    radius = RADIUS * np.clip(np.cos(angle), 0, 1) ** ROUNDNESS
    height = HEIGHT * np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** ROUNDNESS
    length = np.concatenate([[0], np.cumsum(np.hypot(np.diff(radius), np.diff(height)))])
    even = np.linspace(0, length[-1], rows)
    points = np.stack([np.interp(even, length, radius), np.interp(even, length, height)], -1)
    points[[0, -1], 0] = 1e-5  # poles of faces that are not degenerate
    return points


def _blender_image(colours: np.ndarray) -> bpy.types.Image:
    """Return an image of Blender with linear float pixels."""
    height, width = colours.shape[:2]
    image = bpy.data.images.new("print", width, height, float_buffer=True)
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = decode_srgb(colours[::-1].astype(np.float32) / 255)
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image
