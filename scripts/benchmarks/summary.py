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
    better, worse = [], []
    for text, ratio in _duels(store):
        (better if ratio > CLOSE else worse).append(text)
    if better:
        yield Note("Faster than others: " + "; ".join(better) + ".")
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


def _duels(store: Store) -> Iterator[tuple[str, float]]:
    """What was raced against what: a sentence, and how many times as long the other takes."""
    for record in Results(store, "peers").records(prefix="to our error"):
        for name, ratio in record.figures.items():
            if name.endswith(": times as long") and isinstance(ratio, float):
                peer = name.removesuffix(": times as long")
                yield f"{record.scene}, our error at {record.figures['samples']} samples: {peer} takes {ratio:.2g} times as long", ratio
    for record in Results(store, "kernels").records(prefix="by "):
        ratio = record.figures["their_ms"] / record.figures["ours_ms"]
        yield f"rasteriser: {record.configuration.removeprefix('by ')} takes {ratio:.2g} times as long", ratio
