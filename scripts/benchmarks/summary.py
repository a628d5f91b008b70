# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark in a few lines: what came out, and where something else is better than we are."""

from __future__ import annotations

from collections.abc import Iterator

from .section import Block, Note, Table
from .store import Results, Store

CLOSE = 1.05  # ratios up to this count as even


def blocks(store: Store) -> Iterator[Block]:
    """A table with a row for each scene, and sentences on who is faster."""
    rows = [row for scene in store.scenes if any((row := _row(store, scene))[1:])]
    if rows:
        columns = (
            "scene",
            "job s ↓",
            "relit dB ↑",
            "NVS dB ↑",
            "albedo dB ↑",
            "mesh normals ° ↓",
            "relit frames/s ↑",
            "times IRGS' rate ↑",
        )
        yield Table("In short: the balanced job, default settings", columns, rows)
    raced: dict[str, list[tuple[float, str]]] = {}
    for peer, where, ratio in _duels(store):
        raced.setdefault(peer, []).append((ratio, where))
    if raced:
        yield Note("For the same, others take as many times as long: " + "; ".join(f"{p} {_range(r)}" for p, r in raced.items()) + ".")
    worse = [f"{peer}, {where}, {ratio:.2g} times as long" for peer, r in raced.items() for ratio, where in r if ratio <= CLOSE]
    if worse:
        yield Note("Not faster than others: " + "; ".join(worse) + ".")


def _row(store: Store, scene: str) -> list[str | float | None]:
    job, relit = Results(store, "reconstruction"), Results(store, "relighting")
    parts = Results(store, "decomposition")
    seconds = relit.figure(scene, "speed", "mesh_seconds")
    slow, fast = (job.figure(scene, f"headline, {name}", "frame_seconds") for name in ("IRGS", "IRGS++ efficient"))
    values = [parts.figure(scene, "balanced", name) for name in ("relight_psnr", "nvs_psnr", "albedo_psnr")]
    normals = Results(store, "geometry").figure(scene, "normals", "mesh_degrees")
    rates = [1 / seconds if seconds else None, slow / fast if slow and fast else None]
    return [scene, job.figure(scene, "balanced", "seconds"), *values, normals, *rates]


def _range(ratios: list[tuple[float, str]]) -> str:
    low, high = (f"{ratio:.2g}" for ratio, _ in (min(ratios), max(ratios)))
    return low if low == high else f"{low} to {high}"


def _duels(store: Store) -> Iterator[tuple[str, str, float]]:
    """Who was raced against, over what, and how many times as long they take."""
    for record in Results(store, "peers").records(prefix="to our error"):
        for name, ratio in record.figures.items():
            if name.endswith(": times as long") and isinstance(ratio, float):
                where = f"{record.scene} to our error at {record.figures['samples']} samples"
                yield name.removesuffix(": times as long"), where, ratio
    for record in Results(store, "kernels").records(prefix="by "):
        ratio = record.figures["their_ms"] / record.figures["ours_ms"]
        yield f"rasteriser by {record.configuration.removeprefix('by ')}", "the same picture", ratio
