# SPDX-License-Identifier: GPL-3.0-or-later
"""Ours, Mitsuba and Cycles relighting one object, in turns: error by seconds of each, each against its own converged image."""

from __future__ import annotations

import statistics
import time
from collections.abc import Container, Sequence
from dataclasses import astuple, dataclass

import numpy as np
from irgspp.core.evaluation.cycles import CyclesPass, cycles_images
from irgspp.core.evaluation.metrics import on_black, psnr
from irgspp.core.progress.protocol import Silent

from . import mitsuba_peer
from .mitsuba_peer import Frame
from .studio import Place, Studio, Way
from .timing import medians

OURS, OURS_NOISY = "ours", "ours, not denoised"
MITSUBA, CYCLES, CYCLES_NOISY = "Mitsuba", "Cycles", "Cycles, not denoised"
PEERS = (MITSUBA, CYCLES, CYCLES_NOISY)
EVERYONE = (OURS, OURS_NOISY, *PEERS)


@dataclass(frozen=True)
class Effort:
    """Samples of each, of the peers' converged images, and how often all take turns."""

    counts: dict[str, tuple[int, ...]]
    converged: int
    rounds: int


FULL = Effort(
    {
        OURS: (4, 16, 64, 256),
        OURS_NOISY: (16, 64, 256),
        MITSUBA: (1, 2, 4, 8, 16, 32, 64, 128, 256),
        CYCLES: (1, 2, 4, 8, 16, 32, 64, 128),
        CYCLES_NOISY: (1, 4, 16, 64, 256),
    },
    converged=2048,
    rounds=3,
)
QUICK = Effort({OURS: (16, 64), OURS_NOISY: (64,), MITSUBA: (1, 8, 64), CYCLES: (1, 8, 64), CYCLES_NOISY: (8, 64)}, converged=512, rounds=1)


@dataclass(frozen=True)
class Point:
    """Of so many samples a pixel: seconds, CPU seconds of all threads, and PSNR in dB over the object to the own converged image."""

    samples: int
    seconds: float
    cpu_seconds: float
    psnr: float


@dataclass(frozen=True, eq=False)
class Duel:
    """What was measured.

    Attributes:
        rounds: of each round, points by renderer. images: converged, by renderer, (H, W, 3) encoded.
    """

    rounds: list[dict[str, list[Point]]]
    images: dict[str, np.ndarray]

    def points(self, name: str) -> list[Point]:
        """Of one renderer, medians over the rounds."""
        of_rounds = zip(*(one[name] for one in self.rounds if name in one), strict=True)
        return [Point(*(statistics.median(values) for values in zip(*map(astuple, points), strict=True))) for points in of_rounds]

    def times_as_long(self, ours: Point, peer: str, clock: str = "seconds") -> float | None:
        """By how much longer a peer takes for our error: the median of the rounds; None where it does not get there.

        clock: or "cpu_seconds", which a busy machine changes less.
        """
        ratios = []
        for one in self.rounds:
            mine = next(p for p in one[OURS] if p.samples == ours.samples)
            needed = seconds_to(one.get(peer, []), ours.psnr, clock)
            ratios += [] if needed is None else [needed / getattr(mine, clock)]
        return statistics.median(ratios) if ratios else None

    def at_our_time(self, ours: Point, peer: str) -> float | None:
        """The peer's PSNR after our seconds: the median of the rounds; None where its first image takes longer."""
        found = []
        for one in self.rounds:
            mine = next(p for p in one[OURS] if p.samples == ours.samples)
            reached = psnr_at(one.get(peer, []), mine.seconds)
            found += [] if reached is None else [reached]
        return statistics.median(found) if found else None


def seconds_to(points: Sequence[Point], wanted: float, clock: str = "seconds") -> float | None:
    """Seconds to a PSNR, between measured points by the logarithm of the time; None where it is not reached."""
    before = None
    for point in points:
        if point.psnr >= wanted:
            if before is None:
                return getattr(point, clock)
            share = (wanted - before.psnr) / max(point.psnr - before.psnr, 1e-9)
            return float(getattr(before, clock) * (getattr(point, clock) / getattr(before, clock)) ** share)
        before = point
    return None


def psnr_at(points: Sequence[Point], seconds: float) -> float | None:
    """PSNR after so many seconds, between measured points by the logarithm of the time; None before the first image."""
    if not points or seconds < points[0].seconds:
        return None
    times = np.maximum.accumulate([p.seconds for p in points])
    return float(np.interp(np.log(seconds), np.log(times), [p.psnr for p in points]))


def renderer_of(name: str) -> str:
    """OURS, MITSUBA or CYCLES, of one of EVERYONE."""
    return name.partition(",")[0]


def fight(studio: Studio, place: Place, light: np.ndarray, effort: Effort, absent: Container[str]) -> Duel:
    """All renderers but those that are `absent`, in turns. light: (H, W, 3) of the place, which is the studio's first."""
    rounds, limits = [], {OURS: studio.converged("mesh", 0)}
    peers = [peer for name, peer in ((MITSUBA, _mitsuba), (CYCLES, _cycles)) if name not in absent]
    for number in range(effort.rounds):
        frames = _ours(studio, place, effort)
        for peer in peers:
            found, converged = peer(studio, place, light, effort, number == 0)
            frames |= found
            limits |= converged
        rounds.append({name: _points(some, limits[renderer_of(name)], place.inside) for name, some in frames.items()})
    return Duel(rounds, limits)


def _points(frames: list[Frame], limit: np.ndarray, inside: np.ndarray) -> list[Point]:
    return [Point(one.samples, one.seconds, one.cpu_seconds, psnr(on_black(one.rgba), limit, inside)) for one in frames]


def _ours(studio: Studio, place: Place, effort: Effort) -> dict[str, list[Frame]]:
    ways = {OURS: Way(), OURS_NOISY: Way(denoise="off")}
    return {name: [_our_frame(studio, place, way, n) for n in effort.counts[name]] for name, way in ways.items()}


def _our_frame(studio: Studio, place: Place, way: Way, samples: int) -> Frame:
    """Median of three: a frame is short."""
    one = studio.relighter(way, samples)
    made: list[np.ndarray] = []
    work = {"": lambda: made.append(one.relit(one.surface(place.view.camera), place.prepared).numpy())}
    seconds, cpu = (medians(work, 3, clock=clock)[""] for clock in (time.perf_counter, time.process_time))
    return Frame(samples, seconds, cpu, made[-1])


Found = tuple[dict[str, list[Frame]], dict[str, np.ndarray]]


def _mitsuba(studio: Studio, place: Place, light: np.ndarray, effort: Effort, first: bool) -> Found:
    views, lights = {"view": place.view.camera}, {"light": light}
    counts, converged = effort.counts[MITSUBA], effort.converged if first else 0
    shots = mitsuba_peer.images(mitsuba_peer.textured(studio.run), views, lights, counts, converged)["view", "light"]
    limit = {} if shots.converged is None else {MITSUBA: on_black(shots.converged)}
    return {MITSUBA: shots.frames}, limit


def _cycles(studio: Studio, place: Place, light: np.ndarray, effort: Effort, first: bool) -> Found:
    passes = [CyclesPass(n, denoise) for name, denoise in ((CYCLES, True), (CYCLES_NOISY, False)) for n in effort.counts[name]]
    passes += [CyclesPass(effort.converged, False)] if first else []
    made = cycles_images(studio.run, {"view": place.view.camera}, {"light": light}, passes, Silent())["view", "light"]
    limit = {CYCLES: on_black(made.pop().rgba)} if first else {}
    frames = [
        Frame(one.samples, image.seconds, image.cpu_seconds, image.rgba, one.denoise) for one, image in zip(passes, made, strict=False)
    ]
    return {name: [f for f in frames if f.denoised == denoised] for name, denoised in ((CYCLES, True), (CYCLES_NOISY, False))}, limit
