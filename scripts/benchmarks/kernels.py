# SPDX-License-Identifier: GPL-3.0-or-later
"""Section on kernels: rasteriser and ray tracer against other technologies, and how their cost grows."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from irgspp.core.machine.thread_pool import thread_count

from . import other_rasters
from .bench import Bench, Scene
from .section import Block, Chart, Measurement, Note, Series, Table, Task
from .store import EVERYWHERE, Record, Results
from .timing import medians
from .workloads import OURS, PLAIN, RASTER, TRACE, Rays, Splats, disagreement, measure, project, scatter

NAME = "kernels"
TITLE = "Kernels"
ABOUT = (
    "Surfels all over a torus, drawn with 12 channels at 256x256 pixels, and traced by rays from its surface over hemispheres. "
    "Milliseconds of CPU time, all threads together, medians of runs that alternate; hits, pixels and list entries are counted "
    "and do not depend on the machine."
)
ONCE = True
SURFELS, PIXELS, RAYS, CHANNELS = 20_000, 256, 65_536, 4
GAUSSIANS = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000)
SIDES, RAY_COUNTS, EXTRAS = (64, 128, 256, 512, 1024), (4_096, 16_384, 65_536, 262_144), (0, 4, 8, 16, 32)
SMALL = (1_000, 48)  # surfels and pixels that torch can do
CPP, WARP, TORCH = "C++ -O3", "warp, CPU device", "torch"


def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]:
    """Yield the measurements of both kernels, and of the rasteriser by other technologies.

    Args:
        bench: options of the benchmark.
        scene: unused; this section is measured once.
    """
    few = slice(0, 2) if bench.quick else slice(None)
    for count in GAUSSIANS[few]:
        yield Task(f"raster, {count} Gaussians", partial(_raster, bench, count), 2 + count / 30_000)
        yield Task(f"trace, {count} Gaussians", partial(_trace, bench, count), 3 + count / 20_000)
    for side in SIDES[few]:
        yield Task(f"raster, {side} pixels", partial(_raster, bench, SURFELS, side), 1 + side / 100)
    for number in RAY_COUNTS[few]:
        yield Task(f"trace, {number} rays", partial(_trace, bench, SURFELS, number), 1 + number / 20_000)
    for extras in EXTRAS[few]:
        yield Task(f"raster, {extras + 8} channels", partial(_raster, bench, SURFELS, PIXELS, extras), 2.0)
    for threads in range(1, thread_count() + 1):
        if threads & (threads - 1) == 0 or threads == thread_count():
            yield Task(f"threads, {threads}", partial(_threads, bench, threads), 3.0)
    yield Task(f"by {CPP}", partial(_cpp, bench), 4.0)
    yield Task(f"by {TORCH}", partial(_torch, bench), 8.0)
    if not bench.quick:  # its first kernel takes long to compile
        yield Task(f"by {WARP}", partial(_warp, bench), 12.0)


def _raster(bench: Bench, count: int, size: int = PIXELS, extras: int = CHANNELS) -> Measurement:
    """Measure the rasteriser on a torus of `count` surfels."""
    work = project(count, size, extras=extras)
    counted = {"pixels": size * size, "gaussians": count, "channels": extras + 8, "list_entries": len(work.entries)}
    return _compared(bench, work, RASTER, counted)


def _trace(bench: Bench, count: int, number: int = RAYS) -> Measurement:
    """Measure the ray tracer with `number` rays on a torus of `count` surfels."""
    work = scatter(count, number)
    found = _compared(bench, work, TRACE, {"rays": number, "gaussians": count})
    found.counted["hits"] = int(work.count.sum())
    milliseconds = found.figures["forward_ms"]
    assert isinstance(milliseconds, float)
    return Measurement(found.figures | {"mrays_per_second": number / milliseconds / 1e3}, found.counted)


def _compared(bench: Bench, work: Splats | Rays, kernels: dict[str, Any], counted: dict[str, int]) -> Measurement:
    """Compare our kernels with plain loops, forward and backward."""
    apart = disagreement(work, kernels)
    found = measure(work, kernels, bench.repeats)
    figures = {f"{part}_ms": value for part, value in found[OURS].items()}
    figures |= {f"plain_{part}_ms": value for part, value in found[PLAIN].items()}
    figures["times_as_fast"] = sum(found[PLAIN].values()) / sum(found[OURS].values())
    about = {"picture_difference": apart["picture"], "gradient_difference": apart["gradient"], "array_bytes": work.memory}
    return Measurement(figures | about, counted)


def _threads(bench: Bench, threads: int) -> Measurement:
    """Measure the wall clock of both kernels with a number of threads."""
    before = os.environ.get("IRGSPP_THREADS")
    os.environ["IRGSPP_THREADS"] = str(threads)
    try:
        splats, rays = project(SURFELS, 2 * PIXELS), scatter(SURFELS, 2 * RAYS)
        works = {"raster": lambda: splats.forward(RASTER[OURS][0]), "trace": lambda: rays.forward(TRACE[OURS][0])}
        found = medians(works, 2 * bench.repeats)
    finally:
        if before is None:
            del os.environ["IRGSPP_THREADS"]
        else:
            os.environ["IRGSPP_THREADS"] = before
    return Measurement({f"{name}_ms": 1e3 * seconds for name, seconds in found.items()}, {"threads": threads})


def _cpp(bench: Bench) -> Measurement:
    """Compare the rasteriser's forward pass with C++."""
    return _forward(bench, lambda: other_rasters.by_cpp(bench.folder / "build"))


def _warp(bench: Bench) -> Measurement:
    """Compare the rasteriser's forward pass with warp on its CPU device."""
    return _forward(bench, lambda: other_rasters.by_warp(6 + CHANNELS))


def _forward(bench: Bench, made: Callable[[], other_rasters.Forward]) -> Measurement:
    """Time the rasteriser's forward pass by our kernel, by plain loops and by another technology, in turns."""
    work, began = project(SURFELS, PIXELS), time.perf_counter()
    other = made()
    other(work)
    start, theirs = time.perf_counter() - began, work.image.copy()
    works = {"ours": lambda: work.forward(RASTER[OURS][0]), "plain": lambda: work.forward(RASTER[PLAIN][0]), "their": lambda: other(work)}
    found = medians(works, 2 * bench.repeats, clock=time.process_time)
    work.forward(RASTER[OURS][0])
    apart = np.abs(other_rasters.cropped(work, PIXELS) - _as_image(theirs, work)[:-1, :PIXELS, :PIXELS])
    figures = {f"{name}_ms": 1e3 * seconds for name, seconds in found.items()}
    return Measurement({**figures, "difference": float(np.median(apart)), "first_start_seconds": start}, {"gaussians": SURFELS})


def _as_image(flat: np.ndarray, work: Splats) -> np.ndarray:
    """Return the rasteriser's flat output as (channels, rows, columns)."""
    return flat.reshape(-1, work.plane // work.stride, work.stride)


def _torch(bench: Bench) -> Measurement:
    """Compare the rasteriser's forward pass with torch on a small image."""
    count, size = SMALL
    work, reference = project(count, size), other_rasters.by_torch(count, size)
    theirs = reference().numpy()
    works = {"ours": lambda: work.forward(RASTER[OURS][0]), "plain": lambda: work.forward(RASTER[PLAIN][0]), "their": reference}
    found = medians(works, bench.repeats, clock=time.process_time)
    apart = np.abs(other_rasters.cropped(work, size) - theirs)
    figures = {f"{name}_ms": 1e3 * seconds for name, seconds in found.items()}
    return Measurement({**figures, "difference": float(np.median(apart))}, {"gaussians": count})


# --- report


def blocks(results: Results) -> Iterator[Block]:
    """Yield the tables of technologies and sizes, and the chart of growing cost."""
    yield from _technologies(results)
    panels = {}
    for title, operator, unit in (
        ("rasteriser by Gaussians", "raster", "gaussians"),
        ("rays by Gaussians", "trace", "gaussians"),
        ("rasteriser by pixels", "raster", "pixels"),
        ("rays by rays", "trace", "rays"),
        ("rasteriser by channels", "raster", "channels"),
    ):
        suffix = {"gaussians": " Gaussians"}.get(unit, f" {unit}")
        found = [r for r in results.records(EVERYWHERE, f"{operator}, ") if r.configuration.endswith(suffix)]
        found.sort(key=lambda record: record.counted[unit])
        panels[title] = [_curve(found, unit, name, label) for name, label in (("", OURS), ("plain_", PLAIN))]
    panels = {title: series for title, series in panels.items() if series[0].x}
    if panels:
        yield Chart("How cost grows: forward and backward together", "number", "CPU milliseconds ↓", panels, image="benchmark_kernels")
    yield from _scaling(results)


def _technologies(results: Results) -> Iterator[Block]:
    """Yield the table of the rasteriser by other technologies."""
    rows = []
    for label in (CPP, WARP, TORCH):
        record = results.get(EVERYWHERE, f"by {label}")
        if record is not None:
            f, number = record.figures, record.counted["gaussians"]
            rows.append(
                [f"{label}, {number:,} surfels", f["their_ms"], f["plain_ms"], f["ours_ms"], f["their_ms"] / f["ours_ms"], f["difference"]]
            )
    if rows:
        columns = ("rasteriser, forward", "CPU ms ↓", "numba, plain loops ↓", "ours ↓", "ours is faster by ↑", "median difference")
        yield Table("The same image by other technologies", columns, rows)
        yield Note(
            "C++ without vector types, compiled for this CPU; torch compares every pixel with every surfel, so that it gets few of both."
        )


def _curve(found: list[Record], unit: str, name: str, label: str) -> Series:
    """Return the time of forward and backward pass together as a curve over a count."""
    y = [r.figures[f"{name}forward_ms"] + r.figures[f"{name}backward_ms"] for r in found]
    return Series(label, [r.counted[unit] for r in found], y)


def _scaling(results: Results) -> Iterator[Block]:
    """Yield the table of all sizes, wall clock by threads, and the rate of rays."""
    rows = []
    for record in results.records(EVERYWHERE):
        f, c = record.figures, record.counted
        if "plain_forward_ms" in f:
            work = c.get("hits", c.get("list_entries", 0)) / c.get("rays", c.get("pixels", 1))
            times = (f["forward_ms"], f["backward_ms"], f["plain_forward_ms"], f["plain_backward_ms"], f["times_as_fast"])
            rows.append([record.configuration, *times, work, f["array_bytes"] / 2**20, f["gradient_difference"]])
    if rows:
        columns = (
            "",
            "forward ms ↓",
            "backward ↓",
            "plain forward",
            "backward",
            "times as fast ↑",
            "hits a ray, entries a pixel",
            "arrays MiB ↓",
        )
        yield Table("Cost by size", [*columns, "gradients differ by"], rows, detail=True)
    by_threads = [[str(r.counted["threads"]), r.figures["raster_ms"], r.figures["trace_ms"]] for r in results.records(prefix="threads")]
    if by_threads:
        yield Table("Wall clock by threads, milliseconds ↓", ("threads", "rasteriser", "rays"), by_threads)
    rates = [r.figures["mrays_per_second"] for r in results.records(prefix="trace") if "mrays_per_second" in r.figures]
    if rates:
        yield Note(f"Secondary rays through Gaussians: {statistics.median(rates):.2f} million a CPU second (median of the sizes above).")
