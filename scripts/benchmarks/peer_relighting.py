# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of ours, Mitsuba and Cycles relighting one object in turns: error over time, each against its own converged image."""

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
from .studio import LitView, RelightVariant, Studio
from .timing import medians

OURS, OURS_NOISY = "ours", "ours, not denoised"
MITSUBA, CYCLES, CYCLES_NOISY = "Mitsuba", "Cycles", "Cycles, not denoised"
PEERS = (MITSUBA, CYCLES, CYCLES_NOISY)
RENDERERS = (OURS, OURS_NOISY, *PEERS)


@dataclass(frozen=True)
class Effort:
    """Number of samples and of rounds of a comparison.

    Attributes:
        counts: samples per pixel by renderer.
        converged: samples per pixel of the peers' converged images.
        rounds: rounds in which all renderers alternate.
    """

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
    """Time and error of one renderer with a number of samples.

    Attributes:
        samples: samples per pixel.
        seconds: wall clock.
        cpu_seconds: CPU time of all threads.
        psnr: dB over the object against the renderer's own converged image.
    """

    samples: int
    seconds: float
    cpu_seconds: float
    psnr: float


@dataclass(frozen=True, eq=False)
class RendererComparison:
    """Measured times and errors of all renderers.

    Attributes:
        rounds: points by renderer, of each round.
        images: converged images by renderer, (H, W, 3) encoded.
    """

    rounds: list[dict[str, list[Point]]]
    images: dict[str, np.ndarray]

    def points(self, name: str) -> list[Point]:
        """Return the points of a renderer, medians over the rounds."""
        of_rounds = zip(*(one[name] for one in self.rounds if name in one), strict=True)
        return [Point(*(statistics.median(values) for values in zip(*map(astuple, points), strict=True))) for points in of_rounds]

    def times_as_long(self, ours: Point, peer: str, clock: str = "seconds") -> float | None:
        """Return how many times as long a peer takes to our error: the median of the rounds.

        Args:
            ours: our point to compare with.
            peer: name of the peer.
            clock: "seconds", or "cpu_seconds", which other load on the machine affects less.

        Returns:
            The ratio; None where the peer does not reach the error.
        """
        ratios = []
        for one in self.rounds:
            mine = next(p for p in one[OURS] if p.samples == ours.samples)
            needed = seconds_to(one.get(peer, []), ours.psnr, clock)
            ratios += [] if needed is None else [needed / getattr(mine, clock)]
        return statistics.median(ratios) if ratios else None

    def at_our_time(self, ours: Point, peer: str) -> float | None:
        """Return the peer's PSNR after our seconds: the median of the rounds.

        Args:
            ours: our point to compare with.
            peer: name of the peer.

        Returns:
            PSNR in dB; None where the peer's first image takes longer.
        """
        found = []
        for one in self.rounds:
            mine = next(p for p in one[OURS] if p.samples == ours.samples)
            reached = psnr_at(one.get(peer, []), mine.seconds)
            found += [] if reached is None else [reached]
        return statistics.median(found) if found else None


def seconds_to(points: Sequence[Point], target: float, clock: str = "seconds") -> float | None:
    """Return the time to a PSNR, interpolated between points by the logarithm of time.

    Args:
        points: points in the order of their samples.
        target: PSNR in dB.
        clock: "seconds" or "cpu_seconds".

    Returns:
        Seconds; None where the PSNR is not reached.
    """
    before = None
    for point in points:
        if point.psnr >= target:
            if before is None:
                return getattr(point, clock)
            fraction = (target - before.psnr) / max(point.psnr - before.psnr, 1e-9)
            return float(getattr(before, clock) * (getattr(point, clock) / getattr(before, clock)) ** fraction)
        before = point
    return None


def psnr_at(points: Sequence[Point], seconds: float) -> float | None:
    """Return the PSNR after some time, interpolated between points by the logarithm of time.

    Args:
        points: points in the order of their samples.
        seconds: time in seconds.

    Returns:
        PSNR in dB; None before the first image.
    """
    if not points or seconds < points[0].seconds:
        return None
    times = np.maximum.accumulate([p.seconds for p in points])
    return float(np.interp(np.log(seconds), np.log(times), [p.psnr for p in points]))


def renderer_of(name: str) -> str:
    """Return OURS, MITSUBA or CYCLES for one of RENDERERS."""
    return name.partition(",")[0]


def compare_renderers(studio: Studio, lit_view: LitView, light: np.ndarray, effort: Effort, absent: Container[str]) -> RendererComparison:
    """Render one view by all available renderers in turns.

    Args:
        studio: run to relight.
        lit_view: view and light, the studio's first.
        light: linear lat-long map (H, W, 3) of the view.
        effort: numbers of samples and rounds.
        absent: peers that are not available.
    """
    rounds, limits = [], {OURS: studio.converged("mesh", 0)}
    peers = [peer for name, peer in ((MITSUBA, _mitsuba), (CYCLES, _cycles)) if name not in absent]
    for number in range(effort.rounds):
        frames = _ours(studio, lit_view, effort)
        for peer in peers:
            found, converged = peer(studio, lit_view, light, effort, number == 0)
            frames |= found
            limits |= converged
        rounds.append({name: _points(some, limits[renderer_of(name)], lit_view.inside) for name, some in frames.items()})
    return RendererComparison(rounds, limits)


def _points(frames: list[Frame], limit: np.ndarray, inside: np.ndarray) -> list[Point]:
    """Return time and error of each frame."""
    return [Point(one.samples, one.seconds, one.cpu_seconds, psnr(on_black(one.rgba), limit, inside)) for one in frames]


def _ours(studio: Studio, lit_view: LitView, effort: Effort) -> dict[str, list[Frame]]:
    """Render by our relighter, denoised and not."""
    variants = {OURS: RelightVariant(), OURS_NOISY: RelightVariant(denoise="off")}
    return {name: [_our_frame(studio, lit_view, variant, n) for n in effort.counts[name]] for name, variant in variants.items()}


def _our_frame(studio: Studio, lit_view: LitView, variant: RelightVariant, samples: int) -> Frame:
    """Render one frame by our relighter; its time is a median of three, because it is short."""
    one = studio.relighter(variant, samples)
    made: list[np.ndarray] = []
    work = {"": lambda: made.append(one.relit(one.surface(lit_view.view.camera), lit_view.prepared).numpy())}
    seconds, cpu = (medians(work, 3, clock=clock)[""] for clock in (time.perf_counter, time.process_time))
    return Frame(samples, seconds, cpu, made[-1])


FramesAndLimits = tuple[dict[str, list[Frame]], dict[str, np.ndarray]]


def _mitsuba(studio: Studio, lit_view: LitView, light: np.ndarray, effort: Effort, first: bool) -> FramesAndLimits:
    """Render the frames by Mitsuba, in the first round the converged image too."""
    views, lights = {"view": lit_view.view.camera}, {"light": light}
    counts, converged = effort.counts[MITSUBA], effort.converged if first else 0
    shots = mitsuba_peer.images(mitsuba_peer.textured(studio.run), views, lights, counts, converged)["view", "light"]
    limit = {} if shots.converged is None else {MITSUBA: on_black(shots.converged)}
    return {MITSUBA: shots.frames}, limit


def _cycles(studio: Studio, lit_view: LitView, light: np.ndarray, effort: Effort, first: bool) -> FramesAndLimits:
    """Render the frames by Cycles, in the first round the converged image too."""
    passes = [CyclesPass(n, denoise) for name, denoise in ((CYCLES, True), (CYCLES_NOISY, False)) for n in effort.counts[name]]
    passes += [CyclesPass(effort.converged, False)] if first else []
    made = cycles_images(studio.run, {"view": lit_view.view.camera}, {"light": light}, passes, Silent())["view", "light"]
    limit = {CYCLES: on_black(made.pop().rgba)} if first else {}
    frames = [
        Frame(one.samples, image.seconds, image.cpu_seconds, image.rgba, one.denoise) for one, image in zip(passes, made, strict=False)
    ]
    return {name: [f for f in frames if f.denoised == denoised] for name, denoised in ((CYCLES, True), (CYCLES_NOISY, False))}, limit
