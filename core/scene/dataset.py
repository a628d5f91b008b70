# SPDX-License-Identifier: GPL-3.0-or-later
"""Dataset that every reader returns: photographs with cameras, in the world with +Z up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .camera import Camera
from .similarity import moved_points, scale_of
from .surroundings import Surroundings


@dataclass(frozen=True, eq=False)
class View:
    """Photograph with its camera.

    Attributes:
        name: file name without folders, extension or a final `rgba` part; unique in its dataset split.
        camera: pinhole camera of the image (already undistorted and resized).
        path: the image's file.
        colour: (H, W, 3) float32, sRGB-encoded straight colour, 0..1; above 1 only in HDR files and after division by an exposure gain.
        alpha: (H, W) float32 in 0..1, or None where there is neither a mask nor an alpha channel.
        distorted: the file has a lens distortion, which was removed from `colour` and `camera`.
        light: name of the light that the image was taken under, if it is not the dataset's own; else None.
        gain: linear exposure gain (3,) of the file's colours that the dataset states, relative to the other photographs; else None.
        mask_error: distance in pixels by which the edge of `alpha` may be wrong; `colour` then holds the photograph on both sides of it.
        cut_by_colours: the photograph's own colours decided the edge of `alpha`, so that a fit follows the mask there.
        reduction: size of the file over that of `colour`, >= 1 unless the file was enlarged.
        light_rotation: (3, 3) float64 rotation from the world to the frame of the light, where the light turns relative to the object
            (on a turntable); None where it stands still.
    """

    name: str
    camera: Camera
    path: Path
    colour: np.ndarray
    alpha: np.ndarray | None
    distorted: bool = False
    light: str | None = None
    gain: np.ndarray | None = None
    mask_error: float = 0.0
    cut_by_colours: bool = False
    reduction: float = 1.0
    light_rotation: np.ndarray | None = None


def light_rotations(views: Sequence[View]) -> np.ndarray | None:
    """Return the rotations (V, 3, 3) float32 from the world to the frame of the light; None where it stands still in all views."""
    if all(view.light_rotation is None for view in views):
        return None
    return np.stack([np.eye(3) if view.light_rotation is None else view.light_rotation for view in views]).astype(np.float32)


@dataclass(frozen=True)
class Bound:
    """Bounding sphere of the object, in world units.

    Attributes:
        centre: of the sphere.
        radius: of the sphere.
        floor: height Z below which nothing is the object, since it stands on something there; None where that is not known.
    """

    centre: tuple[float, float, float]
    radius: float
    floor: float | None = None

    def moved(self, similarity: np.ndarray) -> Bound:
        """Return the sphere after a similarity (4, 4) of the world, without a floor, which belongs to the world's Z."""
        x, y, z = moved_points(np.array([self.centre], np.float64), similarity)[0].tolist()
        return Bound((x, y, z), self.radius * scale_of(similarity))


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Sparse points of a dataset: position (P, 3) float32 in the world, colour (P, 3) float32 sRGB-encoded in 0..1."""

    position: np.ndarray
    colour: np.ndarray


@dataclass(frozen=True, eq=False)
class Dataset:
    """Photographs ready for reconstruction.

    Attributes:
        path: the folder (or file) that was read.
        format: short name of the format: "transforms", "colmap", "tensoir", ...; see docs/datasets.md.
        train, test: views by split.
        bound: bounding sphere of the object.
        to_world: (4, 4) float64 similarity from the dataset's own frame to the world (+Z up).
        points: sparse points, or None.
        warnings: warnings for the user, one line each.
        lenses: the real cameras as the dataset states them, one line each (the views' cameras are undistorted).
        novel: number of further views under other lights, by light; `load.load_novel_views` reads them.
        surroundings: near surfaces that shadow and light the object, or None.
        lit_from_camera: the light moves with the camera, and the views' `light_rotation` are those of their cameras.
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
    surroundings: Surroundings | None = None
    lit_from_camera: bool = False

    @property
    def turns(self) -> bool:
        """Flag of turntables: True where the object turned between the photographs."""
        return light_rotations(self.train) is not None and not self.lit_from_camera

    @property
    def has_alpha(self) -> bool:
        """Flag of masked photographs: True if every training view has an alpha channel that separates object and background."""
        return bool(self.train) and all(v.alpha is not None for v in self.train)

    @property
    def object_pixels(self) -> float:
        """Mean number of pixels of a training view that show the object by its mask; without masks all of them."""
        masked = self.has_alpha
        counts = [float(v.alpha.sum()) if masked and v.alpha is not None else v.camera.width * v.camera.height for v in self.train]
        return sum(counts) / max(1, len(counts))

    @property
    def reduction(self) -> float:
        """Size of the training photographs' files over that of the views, median."""
        return float(np.median([view.reduction for view in self.train])) if self.train else 1.0

    @property
    def full_size_pixels(self) -> float:
        """Mean number of pixels of the training photographs' files."""
        counts = [view.camera.width * view.camera.height * view.reduction**2 for view in self.train]
        return sum(counts) / max(1, len(counts))

    def full_size_ratio(self, resolution: int) -> float:
        """Return the size of the training photographs' files over that at a resolution, >= 1.

        Args:
            resolution: longest side of a reduced image, pixels.
        """
        full = self.reduction * max((max(view.camera.width, view.camera.height) for view in self.train), default=1)
        return full / min(full, resolution)

    @property
    def outline_pixels(self) -> float:
        """Mean number of pixels of a training view that show the object: by its mask, else by the outline of its bounding sphere."""
        if self.has_alpha:
            return self.object_pixels
        counts = [_sphere_pixels(view.camera, self.bound) for view in self.train]
        return sum(counts) / max(1, len(counts))

    def pixels(self, distorted: bool = False) -> int:
        """Count the pixels of all photographs, or only of those that a lens distorted and that were resampled."""
        views = (view for view in (*self.train, *self.test) if view.distorted or not distorted)
        return sum(view.camera.width * view.camera.height for view in views)


def _sphere_pixels(camera: Camera, bound: Bound) -> float:
    """Return the pixels that the outline of a sphere covers, at most all of the image."""
    distance = float(np.linalg.norm(camera.centre - np.asarray(bound.centre)))
    radius = camera.fx * bound.radius / max(distance, bound.radius)
    return min(math.pi * radius**2, float(camera.width * camera.height))
