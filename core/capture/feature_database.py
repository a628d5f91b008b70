# SPDX-License-Identifier: GPL-3.0-or-later
"""Database of features and matches (COLMAP's format), which a stopped job continues to fill."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from statistics import median

import numpy as np
import pycolmap

from .photograph import Photograph
from .quarter_turns import stored_size

UNKNOWN_FOCAL = 1.2  # first guess of the focal length in long sides of the image
DETAILED_LENS = 8  # photographs of a camera from which its lens gets four distortion coefficients (OPENCV) instead of one


def lens_groups(photographs: Sequence[Photograph]) -> list[list[int]]:
    """Group photographs whose intrinsics are the same in stored pixels.

    Photographs of one phone that were held upright and on the side have different lens keys only by the size in them.

    Args:
        photographs: photographs in the order of their indices.

    Returns:
        Indices of the photographs of each camera.
    """
    groups: dict[tuple[str, tuple[int, int]], list[int]] = {}
    for i, one in enumerate(photographs):
        size = stored_size(one)
        key = one.lens.replace(f"{one.width}x{one.height}", f"{size[0]}x{size[1]}")
        groups.setdefault((key, size), []).append(i)
    return list(groups.values())


def initial_cameras(photographs: Sequence[Photograph], radial: bool = False) -> list[pycolmap.Camera]:
    """Return the cameras with the focal length of EXIF, or a guess, as the start of their refinement; camera i + 1 is lens group i.

    Args:
        photographs: photographs in the order of their indices.
        radial: one focal length and one distortion coefficient (SIMPLE_RADIAL) for all cameras, also those of many photographs.
    """
    cameras = []
    for number, group in enumerate(lens_groups(photographs), 1):
        width, height = stored_size(photographs[group[0]])
        known = [focal for i in group if (focal := photographs[i].focal)]
        model = "OPENCV" if len(group) >= DETAILED_LENS and not radial else "SIMPLE_RADIAL"
        focal = median(known) if known else UNKNOWN_FOCAL * max(width, height)
        camera = pycolmap.Camera.create_from_model_name(number, model, focal, width, height)
        camera.has_prior_focal_length = bool(known)
        cameras.append(camera)
    return cameras


def reset_cameras(path: Path, cameras: Sequence[pycolmap.Camera]) -> None:
    """Replace the intrinsics in the database, from which the mapper starts.

    Args:
        path: the database file.
        cameras: all cameras.
    """
    with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        for camera in cameras:
            database.update_camera(camera)


def open_database(path: Path, photographs: Sequence[Photograph]) -> None:
    """Make the database, with cameras and images but no features; one that is complete so far is kept, a damaged one replaced.

    Args:
        path: the database file.
        photographs: image i + 1 of the database is photograph i.
    """
    if path.exists() and _is_sound(path, len(photographs)):
        return
    for file in path.parent.glob(path.name + "*"):  # with SQLite's journals
        file.unlink()
    with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        for camera, group in zip(initial_cameras(photographs), lens_groups(photographs), strict=True):
            database.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=camera.camera_id)
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
            for i in group:
                _write_image(database, i + 1, camera.camera_id)


def copy_features(source: Path, path: Path, count: int) -> None:
    """Copy the features that another database of the same photographs holds, where they are missing.

    Args:
        source: the other database file.
        path: the database file that receives them.
        count: number of photographs.
    """
    with pycolmap.Database.open(source) as given, pycolmap.Database.open(path) as database:
        for number in range(1, count + 1):
            if not database.exists_descriptors(number):
                with pycolmap.DatabaseTransaction(database):
                    database.write_keypoints(number, given.read_keypoints(number))
                    database.write_descriptors(number, given.read_descriptors(number))


def restore_matches(source: Path, path: Path, kept: set[int]) -> None:
    """Replace the verified matches of pairs by those of another database with the same features.

    Args:
        source: the other database file.
        path: the database file, which is changed.
        kept: photographs whose pairs keep their matches.
    """
    with pycolmap.Database.open(source) as given, pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        pairs, geometries = given.read_two_view_geometries()
        for pair, geometry in zip(pairs, geometries, strict=True):
            one, other = pycolmap.pair_id_to_image_pair(pair)
            if one - 1 in kept or other - 1 in kept:
                continue
            known = database.exists_two_view_geometry(one, other)
            (database.update_two_view_geometry if known else database.write_two_view_geometry)(one, other, geometry)


def image_name(number: int) -> str:
    """Return the name of an image in the database: its number, since COLMAP's lists of pairs know no names with spaces."""
    return f"{number:06d}"


def _write_image(database: pycolmap.Database, number: int, camera: int) -> None:
    image = pycolmap.Image(name=image_name(number), keypoints=np.zeros((0, 2)), camera_id=camera, image_id=number)
    image.frame_id = number
    frame = pycolmap.Frame()
    frame.frame_id, frame.rig_id = number, camera
    frame.add_data_id(image.data_id)
    database.write_frame(frame, use_frame_id=True)
    database.write_image(image, use_image_id=True)


def _is_sound(path: Path, count: int) -> bool:
    """Check a database that a killed job may have left behind.

    Python's SQLite must not touch the file while COLMAP has it open: two copies of the library in a process break each other's locks.
    """
    try:
        with closing(sqlite3.connect(path)) as database:
            sound = database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
            return sound and database.execute("SELECT COUNT(*) FROM images").fetchone() == (count,)
    except sqlite3.DatabaseError:
        return False


def feature_counts(path: Path, count: int) -> np.ndarray:
    """Return the number of features (N,) of the photographs.

    Args:
        path: the database file.
        count: number of photographs.
    """
    with pycolmap.Database.open(path) as database:
        return np.array([database.num_keypoints_for_image(i + 1) for i in range(count)], int)


def inlier_counts(path: Path, count: int) -> np.ndarray:
    """Return the number of verified matches (N, N) of each pair of photographs.

    Args:
        path: the database file.
        count: number of photographs.
    """
    table = np.zeros((count, count), int)
    with pycolmap.Database.open(path) as database:
        pairs, inliers = database.read_two_view_geometry_num_inliers()
    for pair, number in zip(pairs, inliers, strict=True):
        i, j = pycolmap.pair_id_to_image_pair(pair) if isinstance(pair, int) else pair
        table[i - 1, j - 1] = table[j - 1, i - 1] = number
    return table
