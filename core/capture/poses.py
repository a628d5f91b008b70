# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera poses of bare photographs by structure from motion (COLMAP)."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import pycolmap

from ..io.atomic import replaced_folder, write_atomic
from ..progress.protocol import Progress
from ..settings.schema import CaptureSettings
from .colmap_library import silence
from .mapping import refine_robustly
from .photograph import LeftOut, Photograph
from .pose_search import PoseSearch
from .registration_report import check_count, check_model, explain_left_out, is_panoramic
from .sparse_model import SparseModel
from .turntable import Turntable
from .upright_model import sparse_model, turn_upright

MODEL = "distorted/sparse/0"
STATE = "poses.json"
FORMAT = 2  # of the state and the database; a change makes older ones invalid


def find_poses(
    photographs: Sequence[Photograph],
    folder: Path,
    settings: CaptureSettings,
    seed: int,
    progress: Progress,
    turntable: Turntable | None = None,
) -> SparseModel:
    """Find the poses, lenses and sparse points of photographs; what an earlier call finished is read back.

    The model of the upright copies is written to `distorted/sparse/0` of the folder, in COLMAP's format.

    Args:
        photographs: three or more, with upright copies.
        folder: the capture's folder, which keeps features, matches and the model.
        settings: settings of the capture.
        seed: seed of all random choices.
        progress: receiver; it may cancel.
        turntable: static background before which the object turns, or None: the poses are then those about the object at rest.

    Returns:
        The sparse model, with the reasons of photographs that have no pose.

    Raises:
        InputError: if no poses can be found.
        Cancelled: if the user stopped the job; what is finished is kept.
    """
    check_count(photographs)
    silence()
    folder.mkdir(parents=True, exist_ok=True)
    key = _fingerprint(photographs, settings, seed, turntable is not None)
    state = _read_state(folder, key)
    if "left_out" in state and (found := _read_back(folder, photographs, [LeftOut(**one) for one in state["left_out"]])) is not None:
        return found
    if not state:
        _forget(folder)
        write_atomic(folder / STATE, json.dumps({"key": key}).encode())
    solution = PoseSearch(photographs, folder, settings, seed, progress, turntable).run()
    model = check_model(photographs, solution.models[0] if solution.models else None, is_panoramic(solution.path))
    left_out = explain_left_out(photographs, solution.models, solution.counts, solution.inliers)
    refine_robustly(model, solution.freedom)
    upright = turn_upright(model, photographs)
    _write(folder, upright, key, left_out)
    return sparse_model(upright, photographs, left_out)


def _fingerprint(photographs: Sequence[Photograph], settings: CaptureSettings, seed: int, turntable: bool) -> str:
    """Return a digest of everything that the result depends on."""
    chosen = (settings.features, settings.matching) + ((True,) if turntable else ())
    digest = hashlib.sha256(repr((FORMAT, pycolmap.__version__, seed, *chosen)).encode())
    for one in photographs:
        values = one.name, one.image.name, one.width, one.height, one.lens, one.focal, one.turned
        digest.update(repr(values).encode() + hashlib.sha256(one.image.read_bytes()).digest())
    return digest.hexdigest()


def _read_state(folder: Path, key: str) -> dict:
    """Read the state of an earlier call for the same photographs; empty if there is none."""
    try:
        state = json.loads((folder / STATE).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return state if isinstance(state, dict) and state.get("key") == key else {}


def _forget(folder: Path) -> None:
    """Remove what was found for other photographs or settings."""
    for file in folder.glob("database*.db*"):
        file.unlink()
    shutil.rmtree(folder / MODEL, ignore_errors=True)


def _read_back(folder: Path, photographs: Sequence[Photograph], left_out: list[LeftOut]) -> SparseModel | None:
    """Read the model of an earlier call; None if its files are damaged or missing."""
    try:
        model = pycolmap.Reconstruction(folder / MODEL)
    except (ValueError, RuntimeError):
        return None
    return sparse_model(model, photographs, left_out)


def _write(folder: Path, upright: pycolmap.Reconstruction, key: str, left_out: list[LeftOut]) -> None:
    """Write the model, then the state that says that it is complete."""
    with replaced_folder(folder / MODEL) as partial:
        upright.write(partial)
    state = {"key": key, "left_out": [asdict(one) for one in left_out]}
    write_atomic(folder / STATE, json.dumps(state, indent=1).encode())
