# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera poses of bare photographs by structure from motion (COLMAP)."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pycolmap

from ..io.atomic import replaced_folder, write_atomic
from ..progress.protocol import Progress
from ..settings.schema import CaptureSettings
from .colmap_library import silence
from .feature_database import feature_counts, initial_cameras, inlier_counts, open_database, reset_cameras
from .features import find_features
from .mapping import Attempt, Freedom, has_plausible_lenses, map_photographs, refine_robustly
from .matching import MAX_AFFORDABLE, MAX_EXHAUSTIVE, Pairs, every_pair, match_features, select_pairs
from .photograph import LeftOut, Photograph
from .registration_report import check_count, check_features, check_matches, check_model, explain_left_out, is_panoramic
from .sparse_model import SparseModel
from .turntable import Turntable
from .upright_model import sparse_model, turn_upright

MODEL = "distorted/sparse/0"
STATE = "poses.json"
MIN_REGISTERED_FRACTION = 0.8  # fraction of the photographs that a first run must register; otherwise more costly runs follow
FORMAT = 1  # of the state and the database; a change makes older ones invalid


@dataclass(frozen=True, eq=False)
class Solution:
    """Models of one run of the mapper, with what is known of the photographs' matches.

    Attributes:
        models: the largest first.
        path: the database.
        freedom: intrinsics that were refined.
        counts: features of each photograph, (N,).
        inliers: verified matches of each pair, (N, N).
    """

    models: list[pycolmap.Reconstruction]
    path: Path
    freedom: Freedom
    counts: np.ndarray
    inliers: np.ndarray

    @property
    def registered(self) -> int:
        """Number of photographs in the largest model."""
        return self.models[0].num_reg_images() if self.models else 0

    @property
    def quality(self) -> tuple[int, float]:
        """Key that orders solutions: registered photographs, then smaller reprojection error."""
        return self.registered, -self.models[0].compute_mean_reprojection_error() if self.models else 0.0


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
    solution = _Solver(photographs, folder, settings, seed, progress, turntable).solve()
    model = check_model(photographs, solution.models[0] if solution.models else None, is_panoramic(solution.path))
    left_out = explain_left_out(photographs, solution.models, solution.counts, solution.inliers)
    refine_robustly(model, solution.freedom)
    upright = turn_upright(model, photographs)
    _write(folder, upright, key, left_out)
    return sparse_model(upright, photographs, left_out)


@dataclass(frozen=True, eq=False)
class _Solver:
    """Runs of the mapper; see `find_poses` for the attributes."""

    photographs: Sequence[Photograph]
    folder: Path
    settings: CaptureSettings
    seed: int
    progress: Progress
    turntable: Turntable | None

    def solve(self) -> Solution:
        """Run the mapper, and again with more matches while few photographs are registered; return the best solution."""
        count, path, thorough = len(self.photographs), self.folder / "database.db", self.folder / "database_thorough.db"
        best = self._search(path)
        attempts: list[tuple[str, Callable[[], Solution]]] = []
        if self.settings.matching == "auto" and MAX_EXHAUSTIVE < count <= MAX_AFFORDABLE:
            attempts.append(("matching every pair", lambda: self._match(path, every_pair(count), False)))
        attempts.append(("trying with weaker matches", lambda: self._map(best, True)))
        attempts.append(("searching for fainter features", lambda: self._search(thorough, thorough=True)))
        for what, attempt in attempts:
            if best.registered >= MIN_REGISTERED_FRACTION * count or is_panoramic(best.path):
                break
            self.progress.message(f"only {best.registered} of {count} photographs fit together; {what}")
            best = max(best, attempt(), key=lambda s: s.quality)
        return best

    def _search(self, path: Path, thorough: bool = False) -> Solution:
        """Find features, match the selected pairs, and run the mapper, with the database at a path."""
        photographs, count, matching = self.photographs, len(self.photographs), self.settings.matching
        open_database(path, photographs)
        find_features(photographs, path, self.settings.features, thorough, self.progress, self.turntable)
        check_features(photographs, feature_counts(path, count))
        every = thorough and matching == "auto" and count <= MAX_AFFORDABLE
        pairs = every_pair(count) if every else select_pairs(path, count, matching, self.seed)
        return self._match(path, pairs, thorough)

    def _match(self, path: Path, pairs: Pairs, lenient: bool) -> Solution:
        """Match pairs, and run the mapper."""
        match_features(path, pairs, self.seed, self.progress)
        counts, inliers = feature_counts(path, len(self.photographs)), inlier_counts(path, len(self.photographs))
        check_matches(self.photographs, inliers)
        return self._map(Solution([], path, Freedom.FULL, counts, inliers), lenient)

    def _map(self, known: Solution, lenient: bool) -> Solution:
        """Run the mapper; while a lens is impossible, again with fewer of its intrinsics free.

        Small models of weak matches fit any distortion, so that a lenient run begins with one coefficient.
        """
        freedoms = [Freedom.RADIAL, Freedom.FIXED] if lenient else list(Freedom)
        for freedom in freedoms:
            given = initial_cameras(self.photographs, radial=freedom is not Freedom.FULL)
            reset_cameras(known.path, given)
            models = map_photographs(known.path, len(self.photographs), Attempt(lenient, freedom), self.seed, self.progress)
            if not models or freedom is freedoms[-1] or has_plausible_lenses(models[0], given):
                break
            fewer = freedoms[freedoms.index(freedom) + 1]
            self.progress.message(f"no real lens fits the photographs; intrinsics that are refined: {fewer.value}")
        return Solution(models, known.path, freedom, known.counts, known.inliers)


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
