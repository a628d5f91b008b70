# SPDX-License-Identifier: GPL-3.0-or-later
"""Reasons in plain words: why photographs have no pose, and why no poses can be found at all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap

from ..errors import InputError
from .photograph import LeftOut, Photograph

MIN_PHOTOGRAPHS = 3  # photographs
MIN_FEATURES = 50  # below, a photograph can hardly be matched
MIN_PARALLAX = 1.0  # degrees; median over points of the largest angle between two of their rays
MAX_ROTATION_STRETCH = 1.1  # largest ratio of the singular values of a homography that counts as a rotation: focal lengths are not exact
MAX_PANORAMIC_FRACTION = 0.8  # fraction of the pairs
KIND = pycolmap.TwoViewGeometryConfiguration
ADVICE = "take 20 or more photographs around the object, each overlapping the one before by two thirds"


def check_count(photographs: Sequence[Photograph]) -> None:
    """Raise InputError if there are too few photographs for poses."""
    if len(photographs) < MIN_PHOTOGRAPHS:
        raise InputError(_place(photographs), f"{len(photographs)} photographs are too few to find camera poses", ADVICE)


def check_features(photographs: Sequence[Photograph], counts: np.ndarray) -> None:
    """Check that enough photographs have texture.

    Args:
        photographs: photographs in the order of their indices.
        counts: features of each photograph, (N,).

    Raises:
        InputError: if fewer than three photographs have features.
    """
    if (counts >= MIN_FEATURES).sum() < MIN_PHOTOGRAPHS:
        what = f"the photographs have almost no texture (median {int(np.median(counts))} features), so no camera poses can be found"
        raise InputError(
            _place(photographs), what, "put the object on a patterned surface such as a newspaper, in even light, and focus on it"
        )


def check_matches(photographs: Sequence[Photograph], inliers: np.ndarray) -> None:
    """Check that photographs overlap.

    Args:
        photographs: photographs in the order of their indices.
        inliers: verified matches of each pair, (N, N).

    Raises:
        InputError: if fewer than two pairs of photographs match.
    """
    if np.count_nonzero(np.triu(inliers)) < MIN_PHOTOGRAPHS - 1:
        raise InputError(_place(photographs), "the photographs do not show the same surfaces, so no camera poses can be found", ADVICE)


def check_model(photographs: Sequence[Photograph], model: pycolmap.Reconstruction | None, panoramic: bool) -> pycolmap.Reconstruction:
    """Check that a model was found and that its cameras stand at different places.

    Args:
        photographs: photographs in the order of their indices.
        model: the largest model, if there is one.
        panoramic: see `is_panoramic`.

    Returns:
        The model.

    Raises:
        InputError: if it can't be used.
    """
    where = _place(photographs)
    if (model is None and panoramic) or (model is not None and parallax(model) < MIN_PARALLAX):
        raise InputError(
            where, "all photographs were taken from nearly the same place, which shows no depth", f"walk around the object: {ADVICE}"
        )
    if model is None or model.num_reg_images() < MIN_PHOTOGRAPHS:
        raise InputError(where, "the photographs match in parts, but no camera poses explain them", ADVICE)
    return model


def parallax(model: pycolmap.Reconstruction) -> float:
    """Return the median over points of the largest angle between two of their rays, degrees."""
    centres = {number: model.image(number).projection_center() for number in model.reg_image_ids()}
    angles = []
    for point in model.points3D.values():
        rays = point.xyz - np.array([centres[e.image_id] for e in point.track.elements])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        angles.append(np.arccos(np.clip((rays @ rays.T).min(), -1, 1)))
    return float(np.degrees(np.median(angles))) if angles else 0.0


def is_panoramic(path: Path) -> bool:
    """Return True if rotations about one place explain most matching pairs of photographs.

    A homography H between two images is a rotation where the singular values of inv(K2) H K1 are equal; that of a plane, seen from two
    places, has others.

    Args:
        path: the database with the matches.
    """
    with pycolmap.Database.open(path) as database:
        pairs, geometries = database.read_two_view_geometries()
        matrices = {i.image_id: database.read_camera(i.camera_id).calibration_matrix() for i in database.read_all_images()}
    turned = 0
    for pair, geometry in zip(pairs, geometries, strict=True):
        one, other = (matrices[number] for number in pycolmap.pair_id_to_image_pair(pair))
        if geometry.config in (KIND.PANORAMIC, KIND.PLANAR_OR_PANORAMIC) and geometry.H is not None:
            values = np.linalg.svd(np.linalg.inv(other) @ geometry.H @ one, compute_uv=False)
            turned += values[0] < MAX_ROTATION_STRETCH * values[2]
    return turned > MAX_PANORAMIC_FRACTION * len(pairs)


def explain_left_out(
    photographs: Sequence[Photograph], models: Sequence[pycolmap.Reconstruction], counts: np.ndarray, inliers: np.ndarray
) -> list[LeftOut]:
    """Explain why photographs have no pose in the first model.

    Args:
        photographs: photographs in the order of their indices.
        models: the chosen one first; image i + 1 is photograph i.
        counts: features of each photograph, (N,).
        inliers: verified matches of each pair, (N, N).
    """
    members = [{number - 1 for number in model.reg_image_ids()} for model in models]
    missing = [i for i in range(len(photographs)) if i not in members[0]]
    return [LeftOut(photographs[i].name, _reason(i, photographs, members, counts, inliers)) for i in missing]


def _reason(i: int, photographs: Sequence[Photograph], members: list[set[int]], counts: np.ndarray, inliers: np.ndarray) -> str:
    partners = [int(j) for j in np.argsort(-inliers[i], kind="stable") if inliers[i, j] > 0]
    if counts[i] < MIN_FEATURES:
        return f"no texture: only {counts[i]} features were found; it may be blurred, dark or plain"
    if not partners:
        return "no match: it shows nothing that another photograph shows"
    linked = [j for j in partners if j in members[0]]
    group = next((group for group in members[1:] if i in group), None)
    near = [j for j in partners if group is None or j in group] or partners
    if not linked:
        return f"not connected: it matches only with {_names(near, photographs)}; photographs between the groups are missing"
    if group is not None:
        most = int(inliers[i, linked].max())
        return (
            f"weakly connected: it fits together with {_names(near, photographs)}, "
            f"but has at most {most} matches with a photograph that has a pose; photographs between them are missing"
        )
    return f"no consistent pose: it matches {len(partners)} photographs, but too weakly"


def _names(indices: Sequence[int], photographs: Sequence[Photograph]) -> str:
    """Name three photographs, and say how many more there are."""
    return ", ".join(photographs[j].name for j in indices[:3]) + (f" and {len(indices) - 3} more" if len(indices) > 3 else "")


def _place(photographs: Sequence[Photograph]) -> Path | str:
    return photographs[0].source.parent if photographs else "photographs"
