# SPDX-License-Identifier: GPL-3.0-or-later
"""Search for the poses of photographs: the mapper, and again with more matches where few photographs fit together."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from ..progress.protocol import Progress
from ..settings.schema import CaptureSettings
from .feature_database import copy_features, feature_counts, initial_cameras, inlier_counts, open_database, reset_cameras, restore_matches
from .features import find_features
from .mapping import Attempt, Freedom, has_plausible_lenses, map_photographs, triangulate_again
from .matching import MAX_AFFORDABLE, MAX_EXHAUSTIVE, Pairs, every_pair, match_features, select_pairs
from .model_agreement import contradicts
from .photograph import Photograph
from .registration_report import check_features, check_matches, is_panoramic
from .static_features import drop_static_features
from .turntable import Turntable

# Fraction of the photographs that a run must register; otherwise more costly runs follow. Of a plain object on a plain table, 25 of 30
# photographs fitted together by weak matches, one of them 1.3 % of its distance away from its place. Later runs found 27 poses, and the
# root mean square of the errors fell from .27 to .09 %.
MIN_REGISTERED_FRACTION = 0.9

MIN_FIRST_MATCHES = 60  # matches of a photograph with all others, found without guidance, by which alone its pose is fitted


@dataclass(frozen=True, eq=False)
class Solution:
    """Models of one run of the mapper, with what is known of the photographs' matches.

    Attributes:
        models: the largest first.
        path: the database.
        freedom: intrinsics that were refined.
        counts: features of each photograph, (N,).
        inliers: verified matches of each pair, (N, N).
        contradicted: the largest model's poses contradict matches; only checked where weak matches were accepted.
    """

    models: list[pycolmap.Reconstruction]
    path: Path
    freedom: Freedom
    counts: np.ndarray
    inliers: np.ndarray
    contradicted: bool = False

    @property
    def registered(self) -> int:
        """Number of photographs in the largest model."""
        return self.models[0].num_reg_images() if self.models else 0

    @property
    def quality(self) -> tuple[float, float]:
        """Key that orders solutions: registered photographs, of contradicted poses half as many; then smaller reprojection error."""
        error = self.models[0].compute_mean_reprojection_error() if self.models else 0.0
        return self.registered / (2 if self.contradicted else 1), -error


@dataclass(frozen=True, eq=False)
class PoseSearch:
    """Runs of the mapper on the photographs of one capture.

    Attributes:
        photographs: three or more, with upright copies.
        folder: folder of the databases.
        settings: settings of the capture.
        seed: seed of all random choices.
        progress: receiver; it may cancel.
        turntable: static background before which the object turns, or None.
    """

    photographs: Sequence[Photograph]
    folder: Path
    settings: CaptureSettings
    seed: int
    progress: Progress
    turntable: Turntable | None

    def run(self) -> Solution:
        """Run the mapper, and again with more matches while few photographs are registered.

        COLMAP's global mapper is no retry: on weak matches of 66 photographs it registered as many, but put 3 of 9
        models together wrongly.

        Returns:
            The best solution.

        Raises:
            InputError: if photographs have no texture, or don't match.
            Cancelled: if the user stopped the job.
        """
        best, retries = self._search(self.folder / "database.db", False), 0
        for what, attempt in self._retries():
            if self._is_enough(best):
                break
            self.progress.message(f"{self._verdict(best)}; {what}")
            best, retries = max(best, attempt(best), key=lambda s: s.quality), retries + 1
        if retries:
            self.progress.message(self._verdict(best))
        return best

    def _retries(self) -> list[tuple[str, Callable[[Solution], Solution]]]:
        """Return what is tried in turn, each with a function of the best solution so far."""
        count = len(self.photographs)
        retries: list[tuple[str, Callable[[Solution], Solution]]] = []
        if self.settings.matching == "auto" and MAX_EXHAUSTIVE < count <= MAX_AFFORDABLE:
            retries.append(("matching every pair", lambda best: self._match(best.path, every_pair(count), False)))
        retries.append(("trying with weaker matches", lambda best: self._map(best, True)))
        retries.append(("searching more matches in pairs that match", self._match_guided))
        retries.append(("searching for fainter features", lambda _: self._search_fainter()))
        return retries

    def _is_enough(self, best: Solution) -> bool:
        fitting = best.registered >= MIN_REGISTERED_FRACTION * len(self.photographs) and not best.contradicted
        return fitting or is_panoramic(best.path)

    def _verdict(self, best: Solution) -> str:
        """Say how many photographs fit together."""
        count = len(self.photographs)
        if best.contradicted:
            return f"{best.registered} of {count} photographs got poses that some of their matches contradict"
        return f"{'' if self._is_enough(best) else 'only '}{best.registered} of {count} photographs fit together"

    def _search(self, path: Path, thorough: bool) -> Solution:
        """Find features, match the selected pairs, and run the mapper, with the database at a path."""
        photographs, count, matching = self.photographs, len(self.photographs), self.settings.matching
        open_database(path, photographs)
        find_features(photographs, path, self.settings.features, thorough, self.progress, self.turntable)
        if self.turntable is not None:
            drop_static_features(path, photographs)
        check_features(photographs, feature_counts(path, count))
        every = thorough and matching == "auto" and count <= MAX_AFFORDABLE
        pairs = every_pair(count) if every else select_pairs(path, count, matching, self.seed)
        return self._match(path, pairs, thorough)

    def _search_fainter(self) -> Solution:
        """Begin again with fainter features, and if need be match them by guided matching, too."""
        found = self._search(self.folder / "database_thorough.db", True)
        return found if self._is_enough(found) else max(found, self._match_guided(found), key=lambda s: s.quality)

    def _match_guided(self, known: Solution) -> Solution:
        """Match pairs that have matches once more, near their epipolar lines, and run the mapper."""
        path = known.path.with_name(f"{known.path.stem}_guided.db")
        open_database(path, self.photographs)
        copy_features(known.path, path, len(self.photographs))
        pairs = [(int(i), int(j)) for i, j in np.argwhere(np.triu(known.inliers) > 0)]
        found = self._match(path, pairs, True, guided=True)
        return self._with_first_matches(found, known) if found.models else found

    def _with_first_matches(self, found: Solution, known: Solution) -> Solution:
        """Fit the poses that guided matching found to the first matches, which are more exact; photographs with few of these keep theirs.

        66 photographs of a skull: positions off by .64 % of the distance with guided matches, .36 % with the first ones.
        """
        mixed = found.path.with_name("database_mixed.db")
        shutil.copyfile(found.path, mixed)
        try:
            restore_matches(known.path, mixed, set(np.flatnonzero(known.inliers.sum(1) < MIN_FIRST_MATCHES).tolist()))
            exact = triangulate_again(found.models[0], mixed, Attempt(True, found.freedom), self.seed, self.progress)
        finally:
            mixed.unlink()
        return replace(found, models=[exact, *found.models[1:]])

    def _match(self, path: Path, pairs: Pairs, lenient: bool, guided: bool = False) -> Solution:
        """Match pairs, and run the mapper."""
        match_features(path, pairs, self.seed, self.progress, guided)
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
        contradicted = lenient and bool(models) and contradicts(models[0], known.path)
        return Solution(models, known.path, freedom, known.counts, known.inliers, contradicted)
