# SPDX-License-Identifier: GPL-3.0-or-later
"""Summary of the benchmark: the main results, and where another renderer or optimiser is better."""

from __future__ import annotations

from collections.abc import Iterator

from . import irgs_baseline
from .peer_inverse import FIGURES, MITSUBA, OURS, PREFIX, UNITS
from .section import Block, Note, Table, formatted
from .store import Results, Store

COLUMNS = (
    "scene",
    "job s ↓",
    "relit dB ↑",
    "NVS dB ↑",
    "albedo dB ↑",
    "mesh normals ° ↓",
    "relit frames/s ↑",
    "times IRGS' rate ↑",
)
CLOSE = 1.05  # time ratios up to this count as equal


def blocks(store: Store) -> Iterator[Block]:
    """Yield a table with a row for each scene, and sentences on who is faster."""
    rows = [row for scene in store.scenes if any((row := _row(store, scene))[1:])]
    if rows:
        compared = any(Results(store, "reconstruction").get(scene, f"headline, {irgs_baseline.NAME}") for scene in store.scenes)
        count = len(COLUMNS) - (not compared)
        yield Table("Summary: the balanced job, default settings", COLUMNS[:count], [row[:count] for row in rows])
        if compared:
            yield Note(irgs_baseline.ABOUT)
    ratios: dict[str, list[tuple[float, str]]] = {}
    for peer, where, ratio in _time_ratios(store):
        ratios.setdefault(peer, []).append((ratio, where))
    if ratios:
        yield Note(
            "Time of others for the same result, relative to ours: " + "; ".join(f"{p} {_range(r)}" for p, r in ratios.items()) + "."
        )
    worse = [f"{peer}, {where}, {ratio:.2g} times as long" for peer, r in ratios.items() for ratio, where in r if ratio <= CLOSE]
    if worse:
        yield Note("Not faster than others: " + "; ".join(worse) + ".")
    yield from _inverse(store)


def _inverse(store: Store) -> Iterator[Note]:
    """Yield how Mitsuba's inverse rendering compares with our second stage in the same time, and where it is better."""
    pairs = []
    for record in Results(store, "peers").records(prefix=f"{PREFIX}{MITSUBA}, 1 x"):
        ours = Results(store, "peers").get(record.scene, f"{PREFIX}{OURS}")
        if ours is not None:
            pairs.append((record.scene, ours.figures, record.figures))
    if not pairs:
        return
    relit = "; ".join(f"{scene} {a['relight_psnr']:.1f} and {b['relight_psnr']:.1f} dB" for scene, a, b in pairs)
    yield Note(f"Relit after our second stage, and after as many seconds of Mitsuba's optimiser with our mesh: {relit}.")
    worse = [
        f"{unit.rstrip(' ↑↓')} of {scene}, {formatted(a[name])} and {formatted(b[name])}"
        for scene, a, b in pairs
        for name, unit in zip(FIGURES, UNITS, strict=True)
        if name in a and name in b and (b[name] > a[name] if unit.endswith("↑") else b[name] < a[name])
    ]
    if worse:
        yield Note(f"Mitsuba's is better in: {'; '.join(worse)}.")


def _row(store: Store, scene: str) -> list[str | float | None]:
    """Return the main results of a scene."""
    job, relit = Results(store, "reconstruction"), Results(store, "relighting")
    parts = Results(store, "decomposition")
    seconds = relit.figure(scene, "speed", "mesh_seconds")
    values = [parts.figure(scene, "balanced", name) for name in ("relight_psnr", "nvs_psnr", "albedo_psnr")]
    normals = Results(store, "geometry").figure(scene, "normals", "mesh_degrees")
    rates = [1 / seconds if seconds else None, irgs_baseline.times_as_fast(job, scene, "IRGS++ efficient")]
    return [scene, job.figure(scene, "balanced", "seconds"), *values, normals, *rates]


def _range(ratios: list[tuple[float, str]]) -> str:
    """Return the range of time ratios as text."""
    low, high = (f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.2g}" for ratio, _ in (min(ratios), max(ratios)))
    return low if low == high else f"{low} to {high}"


def _time_ratios(store: Store) -> Iterator[tuple[str, str, float]]:
    """Yield who was compared, on what, and how many times as long they take."""
    for record in Results(store, "peers").records(prefix="to our error"):
        for name, ratio in record.figures.items():
            if name.endswith(": times as long") and isinstance(ratio, float):
                where = f"{record.scene} to our error at {record.figures['samples']} samples"
                yield name.removesuffix(": times as long"), where, ratio
    for record in Results(store, "kernels").records(prefix="by "):
        ratio = record.figures["their_ms"] / record.figures["ours_ms"]
        yield f"rasteriser by {record.configuration.removeprefix('by ')}", "the same image", ratio
