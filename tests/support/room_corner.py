# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs of the corner of a textured room (floor z = 0, walls x = 0 and y = 0) by known cameras with a known lens."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from irgspp.core.capture.photograph import Photograph
from irgspp.core.capture.quarter_turns import camera_turn, turn_lens
from irgspp.core.datasets.parsed_dataset import Lens
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from irgspp.core.scene.camera import GL_TO_CV, look_at
from PIL import Image

LENS = Lens("OPENCV", 320, 240, 290.0, 290.0, 160.0, 120.0, (-0.06, 0.01, 0.0, 0.0, 0.0))
TEXELS = 256  # per unit of length
EXTENT = 4  # units
LINEAR = decode_srgb(np.arange(256, dtype=np.float32) / 255)  # of a texel


@dataclass(frozen=True, eq=False)
class Shot:
    """Photograph with the truth: intrinsics and pose of the upright copy."""

    photograph: Photograph
    lens: Lens
    to_world: np.ndarray


def texture(seed: int) -> np.ndarray:
    """Noise of several scales, (H, W, 3) uint8."""
    generator, side = np.random.default_rng(seed), TEXELS * EXTENT
    total = np.zeros((side, side, 3))
    for cell in (16, 32, 64, 128):
        noise = generator.normal(size=(side // cell, side // cell, 3)).astype(np.float32)
        total += cv2.resize(noise, (side, side), interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + 40 * total, 0, 255).astype(np.uint8)


def textures() -> list[np.ndarray]:
    return [texture(seed) for seed in range(3)]


def render(lens: Lens, to_world: np.ndarray, walls: list[np.ndarray]) -> np.ndarray:
    """(H, W, 3) uint8; `walls` holds the textures of the planes x = 0, y = 0, z = 0; mean of four samples a pixel in linear light."""
    fine = lens.resized(2 * lens.width, 2 * lens.height)
    matrix = np.array([[fine.fx, 0, fine.cx], [0, fine.fy, fine.cy], [0, 0, 1]])
    grid = np.stack(np.meshgrid(np.arange(fine.width) + 0.5, np.arange(fine.height) + 0.5), -1).reshape(-1, 1, 2)
    flat = cv2.undistortPoints(grid, matrix, np.array(fine.distortion or (0.0,) * 5)).reshape(-1, 2)
    rays = np.concatenate([flat, np.ones((len(flat), 1))], 1) @ (to_world @ GL_TO_CV)[:3, :3].T
    with np.errstate(divide="ignore"):
        along = -to_world[:3, 3] / rays
    along[along <= 0] = np.inf
    first, points = along.argmin(1), to_world[:3, 3] + along.min(1)[:, None] * rays
    image, shape = np.zeros((fine.height, fine.width, 3), np.float32), (fine.height, fine.width)
    for axis, colours in enumerate(walls):
        u, v = (np.delete(points, axis, axis=1).T * TEXELS - 0.5).astype(np.float32).reshape(2, *shape)
        shown = cv2.remap(LINEAR[colours], u, v, cv2.INTER_LINEAR, None, cv2.BORDER_REFLECT)
        image[first.reshape(shape) == axis] = shown[first.reshape(shape) == axis]
    return np.round(255 * encode_srgb(cv2.resize(image, lens.size, interpolation=cv2.INTER_AREA))).astype(np.uint8)


def cameras(count: int) -> list[np.ndarray]:
    """Handheld cameras on an arc, all looking at the corner."""
    angle = np.radians(np.linspace(22, 68, count))
    height = 1.3 + 0.5 * np.sin(np.arange(count) * 2.3)
    eyes = np.stack([2.9 * np.cos(angle), 2.9 * np.sin(angle), height], -1)
    targets = 0.5 + 0.15 * np.random.default_rng(5).normal(size=(count, 3))
    return [look_at(eye, target) for eye, target in zip(eyes, targets, strict=True)]


def take(folder: Path, poses: list[np.ndarray], walls: list[np.ndarray], turned: dict[int, int] | None = None) -> list[Shot]:
    """Write the upright copies; `turned`: quarter turns of the photographs that were held upright."""
    folder.mkdir(parents=True, exist_ok=True)
    shots = []
    for i, pose in enumerate(poses):
        turns = (turned or {}).get(i, 0)
        image = folder / f"photo {i}.png"
        Image.fromarray(np.rot90(render(LENS, pose, walls), turns)).save(image, compress_level=1)
        lens, upright = turn_lens(LENS, turns), pose.copy()
        upright[:3, :3] = pose[:3, :3] @ (GL_TO_CV[:3, :3] @ camera_turn(turns).T @ GL_TO_CV[:3, :3])
        key = f"lens {lens.width}x{lens.height}"
        photograph = Photograph(f"photo {i}", folder / f"original {i}.jpg", image, *lens.size, key, focal=305.0, turned=turns)
        shots.append(Shot(photograph, lens, upright))
    return shots
