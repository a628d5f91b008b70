# SPDX-License-Identifier: GPL-3.0-or-later
"""What every reader returns: photographs with cameras, in the world of the tool."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .camera import Camera


@dataclass(frozen=True, eq=False)
class View:
    """One photograph.

    Attributes:
        name: the frame's file name without folders, extension or a final `rgba` part; unique in its dataset split.
        camera: pinhole camera of this image (already undistorted and resized).
        path: the image's file.
        colour: (H, W, 3) float32, sRGB-encoded straight colour, 0..1 (above 1 only where the file is HDR).
        alpha: (H, W) float32 in 0..1, or None where nothing tells object from background.
        distorted: the file shows a lens distortion that colour and camera are free of.
        light: name of the light the image was taken under, where that is not the dataset's; else None.
    """

    name: str
    camera: Camera
    path: Path
    colour: np.ndarray
    alpha: np.ndarray | None
    distorted: bool = False
    light: str | None = None


@dataclass(frozen=True)
class Bound:
    """A sphere around the object, world units."""

    centre: tuple[float, float, float]
    radius: float


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points of the capture: position (P, 3) float32 in the world, colour (P, 3) float32 sRGB-encoded 0..1."""

    position: np.ndarray
    colour: np.ndarray


@dataclass(frozen=True, eq=False)
class Dataset:
    """Photographs ready for reconstruction.

    Attributes:
        path: the folder (or file) that was read.
        format: its short name: "transforms", "colmap", "tensoir", ...; see docs/datasets.md.
        train, test: views by split.
        bound: sphere around the object.
        to_world: (4, 4) float64 similarity from the dataset's own frame to ours (+Z up).
        points: sparse points, or None.
        warnings: lines worth telling the user.
        lenses: the real cameras as the dataset states them, one line each (the views' cameras are undistorted).
        novel: how many views there are besides under other lights, by light; `load.load_novel_views` reads them.
    """

    path: Path
    format: str
    train: list[View]
    test: list[View]
    bound: Bound
    to_world: np.ndarray
    points: PointCloud | None = None
    warnings: list[str] = field(default_factory=list)
    lenses: list[str] = field(default_factory=list)
    novel: dict[str, int] = field(default_factory=dict)

    @property
    def has_alpha(self) -> bool:
        """True where every training view tells object from background."""
        return bool(self.train) and all(v.alpha is not None for v in self.train)

    def pixels(self, distorted: bool = False) -> int:
        """Count the pixels of all photographs, or only of those that a lens distorted and that were resampled."""
        views = (view for view in (*self.train, *self.test) if view.distorted or not distorted)
        return sum(view.camera.width * view.camera.height for view in views)
