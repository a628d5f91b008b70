# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP model of the stored images, turned to the upright copies and coloured; and its conversion to a sparse model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pycolmap

from ..datasets.parsed_dataset import Lens
from ..io.image import read_image
from ..scene.camera import GL_TO_CV
from .photograph import LeftOut, Photograph
from .quarter_turns import camera_turn, turn_lens, turn_pixels
from .sparse_model import PosedPhotograph, SparseModel

TURNS = 4


def turn_upright(model: pycolmap.Reconstruction, photographs: Sequence[Photograph]) -> pycolmap.Reconstruction:
    """Return the model of the upright copies, without features that have no point.

    Args:
        model: sparse model of the stored images; image i + 1 is photograph i.
        photographs: photographs in the order of their indices.
    """
    upright, places, kept = pycolmap.Reconstruction(), {}, {}
    for number in sorted(model.reg_image_ids()):
        image, photograph = model.image(number), photographs[number - 1]
        camera, stored_camera = TURNS * image.camera_id + photograph.turned, model.camera(image.camera_id)
        if not upright.exists_camera(camera):
            lens = turn_lens(camera_lens(stored_camera), photograph.turned)
            upright.add_camera_with_trivial_rig(_lens_camera(lens, camera, stored_camera))
        kept[number] = {index: k for k, index in enumerate(image.get_observation_point2D_idxs())}
        stored = np.array([image.points2D[index].xy for index in kept[number]]).reshape(-1, 2)
        places[number] = turn_pixels(stored, stored_camera.width, stored_camera.height, photograph.turned)
        turned = pycolmap.Image(name=photograph.image.name, keypoints=places[number], camera_id=camera, image_id=number)
        turn = pycolmap.Rigid3d(np.hstack([camera_turn(photograph.turned), np.zeros((3, 1))]))
        upright.add_image_with_trivial_frame(turned, turn * image.cam_from_world())
    points = [model.point3D(i) for i in sorted(model.point3D_ids())]
    tracks = [[(e.image_id, kept[e.image_id][e.point2D_idx]) for e in point.track.elements] for point in points]
    for point, track, colour in zip(points, tracks, _colours(tracks, places, photographs), strict=True):
        elements = [pycolmap.TrackElement(*place) for place in track]
        upright.add_point3D(point.xyz, pycolmap.Track(elements=elements), colour)
    upright.update_point_3d_errors()
    return upright


def _colours(tracks: list[list[tuple[int, int]]], places: dict[int, np.ndarray], photographs: Sequence[Photograph]) -> np.ndarray:
    """Return the mean colour (P, 3) uint8 of the pixels that see each point."""
    total, count = np.zeros((len(tracks), 3)), np.zeros(len(tracks))
    point_of = {number: np.full(len(xy), -1) for number, xy in places.items()}
    for i, track in enumerate(tracks):
        for number, k in track:
            point_of[number][k] = i
    for number, points in point_of.items():
        colour = read_image(photographs[number - 1].image).colour[..., :3]
        scale = 255 / np.iinfo(colour.dtype).max if colour.dtype.kind == "u" else 255
        seen = points >= 0
        column, row = (np.clip(places[number].T.astype(int), 0, np.array([[colour.shape[1] - 1], [colour.shape[0] - 1]])))[:, seen]
        np.add.at(total, points[seen], colour[row, column] * scale)
        np.add.at(count, points[seen], 1)
    return np.clip(np.round(total / np.maximum(count, 1)[:, None]), 0, 255).astype(np.uint8)


def camera_lens(camera: pycolmap.Camera) -> Lens:
    """Return the intrinsics of a camera with the model OPENCV or SIMPLE_RADIAL."""
    if camera.model_name == "OPENCV":
        fx, fy, cx, cy, *k = camera.params
        return Lens("OPENCV", camera.width, camera.height, fx, fy, cx, cy, (*map(float, k), 0.0))
    f, cx, cy, k1 = camera.params
    return Lens("SIMPLE_RADIAL", camera.width, camera.height, f, f, cx, cy, (float(k1), 0.0, 0.0, 0.0, 0.0))


def _lens_camera(lens: Lens, number: int, given: pycolmap.Camera) -> pycolmap.Camera:
    camera = pycolmap.Camera.create_from_model_name(number, lens.model, lens.fx, lens.width, lens.height)
    opencv = [lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion[:4]]
    camera.params = opencv if lens.model == "OPENCV" else [lens.fx, lens.cx, lens.cy, lens.distortion[0]]
    camera.has_prior_focal_length = given.has_prior_focal_length
    return camera


def sparse_model(upright: pycolmap.Reconstruction, photographs: Sequence[Photograph], left_out: list[LeftOut]) -> SparseModel:
    """Convert the model of the upright copies.

    Args:
        upright: the model; image i + 1 is photograph i.
        photographs: photographs in the order of their indices.
        left_out: photographs that are not in the model.
    """
    numbers = sorted(upright.reg_image_ids())
    posed = [_posed(photographs[number - 1], upright, number) for number in numbers]
    index = {number: i for i, number in enumerate(numbers)}
    points = [upright.point3D(i) for i in sorted(upright.point3D_ids())]
    xy = {number: np.array([p.xy for p in upright.image(number).points2D], np.float32).reshape(-1, 2) for number in numbers}
    tracks = [(i, index[e.image_id], xy[e.image_id][e.point2D_idx]) for i, p in enumerate(points) for e in p.track.elements]
    return SparseModel(
        posed,
        np.array([p.xyz for p in points], float).reshape(-1, 3),
        np.array([p.color for p in points], np.uint8).reshape(-1, 3),
        np.array([t[0] for t in tracks], np.int32),
        np.array([t[1] for t in tracks], np.int32),
        np.array([t[2] for t in tracks], np.float32).reshape(-1, 2),
        float(upright.compute_mean_reprojection_error()),
        left_out,
    )


def _posed(photograph: Photograph, upright: pycolmap.Reconstruction, number: int) -> PosedPhotograph:
    image = upright.image(number)
    to_camera = np.eye(4)
    to_camera[:3] = image.cam_from_world().matrix()
    lens = camera_lens(upright.camera(image.camera_id))
    if not any(lens.distortion):
        lens = replace(lens, distortion=())
    return PosedPhotograph(photograph, lens, np.linalg.inv(to_camera) @ GL_TO_CV)
