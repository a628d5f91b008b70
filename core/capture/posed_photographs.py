# SPDX-License-Identifier: GPL-3.0-or-later
"""Posed photographs of a capture, out of which the object is cut, and the frame that they and the object give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datasets.bound import bound_of_cameras, bound_of_points
from ..io.image import read_image
from ..progress.protocol import Progress
from ..scene.dataset import Bound
from ..settings.schema import CaptureSettings
from .captured_frame import CapturedFrame
from .chosen_sphere import check_sphere
from .dense_points import DensePoints
from .marker import find_marker_scale
from .object_masks import ObjectMasks, cut_out
from .sparse_model import SparseModel
from .static_background import SeenBackground
from .undistortion import UndistortedImage
from .upright import is_wall, world_similarity


@dataclass(frozen=True, eq=False)
class PosedPhotographs:
    """Posed photographs, out of which the object is cut.

    Attributes:
        model: sparse model, in its own frame.
        images: undistorted images of `model.posed`.
        seen: static background of a turntable, or None.
        settings: settings of the capture.
        seed: seed of every random number generator.
        progress: receives the progress and may cancel.
        widening: pixels at 640 a side by which masks may be wrong.
        dense: dense points of the images, where they are known.
    """

    model: SparseModel
    images: list[UndistortedImage]
    seen: SeenBackground | None
    settings: CaptureSettings
    seed: int
    progress: Progress
    widening: int = 0
    dense: DensePoints | None = None

    def cut_out(self, sphere: Bound | None) -> ObjectMasks | None:
        """Cut the object out, unless the settings say not to.

        Args:
            sphere: the person's sphere, in the model's frame; None to find the object.
        """
        if sphere is not None:
            check_sphere(sphere, [one.camera for one in self.images])
        given = {one.view.name: one.mask for one in self.images if one.mask is not None}
        background = None if self.seen is None else self.seen.masks
        views = [one.view for one in self.images]
        dense, points = self.dense if sphere is None else None, self.model.points
        return cut_out(views, points, self.settings, self.seed, self.progress, sphere, given or None, background, self.widening, dense)

    def frame(self, found: ObjectMasks | None) -> CapturedFrame:
        """Return the frame of the dataset.

        Args:
            found: the object, cut out without a person's sphere; None where there is none.
        """
        metres = _metres_per_unit(self.model, self.settings, self.progress)
        scale = 1.0 if self.model.has_given_cameras else metres  # a dataset keeps its unit
        bound = _scene_bound(self.model, self.images) if found is None else found.bound
        plane = None if found is None or found.plane is None else (found.plane.normal, found.plane.offset)
        cameras = [one.camera for one in self.images]
        if plane is not None and is_wall(cameras, plane[0]):
            self.progress.message("the object is on a wall, which becomes the ground: it lies on its back in the dataset")
        similarity = world_similarity(cameras, bound, plane, scale)
        similarity[:3] *= self.settings.scale or 1.0
        return CapturedFrame(similarity, metres is not None or self.settings.scale is not None)


def _metres_per_unit(model: SparseModel, settings: CaptureSettings, progress: Progress) -> float | None:
    """Return the model's scale by the printed marker; None where none is expected or found."""
    if settings.marker is None:
        return None
    marker = find_marker_scale(model, settings.marker, lambda photograph: _eight_bits(read_image(photograph.image).colour))
    if marker is None:
        progress.message("no marker was found in three photographs: the true size is not known; print it larger, or lay it flat and lit")
        return None
    progress.message(f"marker {marker.name}, found in {marker.photographs} photographs to {marker.error:.2f} pixels, gives the true size")
    return marker.metres_per_unit


def _eight_bits(colour: np.ndarray) -> np.ndarray:
    return colour if colour.dtype == np.uint8 else (colour >> 8).astype(np.uint8)


def _scene_bound(model: SparseModel, images: list[UndistortedImage]) -> Bound:
    """Return the sphere about what the cameras look at, where no object was cut out."""
    cameras = [one.camera for one in images]
    return bound_of_points(cameras, model.position) or bound_of_cameras(cameras)
