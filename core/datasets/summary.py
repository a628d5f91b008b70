# SPDX-License-Identifier: GPL-3.0-or-later
"""Summary of a loaded dataset, as text for the user and as values for programs."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from ..machine.cpu_memory import estimate_memory
from ..machine.job_time import estimate_seconds, in_words
from ..machine.texture_size import size_by_pixels
from ..scene.dataset import Dataset, View
from ..settings.schema import PRESETS
from ..settings.sizes import with_sizes, with_texture_size

SHOWN = 5  # lines of one kind before the rest is only counted


def describe(dataset: Dataset) -> str:
    """Format a dataset's summary as a table: format, views, sizes, cameras, points, masks, object's bound, warnings."""
    return "\n".join(f"{name:<10}{text}" for name, text in _rows(dataset, estimate_jobs(dataset)))


def summary(dataset: Dataset) -> dict[str, Any]:
    """Return a dataset's summary as plain values for JSON.

    Returns:
        path, format; train, test: numbers of views; novel: numbers of views under other lights, by light; sizes: [[width, height,
        images]], the most common first; kinds: file types; lenses: the real cameras, one line each; distorted: number of photographs with
        lens distortion; masked: number of training views with a mask; object_share: fraction of their pixels that the object covers, or
        None; points: their number, or None; centre, radius: the object's bound in the world; to_world: (4, 4) from the dataset's own
        frame to the world; jobs: by preset, {seconds, memory (bytes), text} of a reconstruction on the CPU; warnings; rows:
        [[name, text]] as in `describe`.
    """
    views = [*dataset.train, *dataset.test]
    masks = [v.alpha for v in dataset.train if v.alpha is not None]
    jobs = estimate_jobs(dataset)
    return {
        "path": str(dataset.path),
        "format": dataset.format,
        "train": len(dataset.train),
        "novel": dataset.novel,
        "test": len(dataset.test),
        "sizes": [[*size, count] for size, count in Counter((v.camera.width, v.camera.height) for v in views).most_common()],
        "kinds": sorted({v.path.suffix.lower().lstrip(".") for v in views}),
        "lenses": dataset.lenses,
        "distorted": sum(v.distorted for v in views),
        "masked": len(masks),
        "object_share": _object_share(masks),
        "points": None if dataset.points is None else len(dataset.points.position),
        "centre": list(dataset.bound.centre),
        "radius": dataset.bound.radius,
        "to_world": dataset.to_world.tolist(),
        "jobs": jobs,
        "warnings": dataset.warnings,
        "rows": [list(row) for row in _rows(dataset, jobs)],
    }


def _rows(dataset: Dataset, jobs: dict[str, dict[str, Any]]) -> list[tuple[str, str]]:
    return [
        ("dataset", str(dataset.path)),
        ("format", dataset.format),
        ("views", f"{len(dataset.train)} training, {len(dataset.test)} test"),
        *([("relit", _novel(dataset))] if dataset.novel else []),
        ("images", _sizes([*dataset.train, *dataset.test])),
        *(("camera" if i == 0 else "", line) for i, line in enumerate(_shortened(dataset.lenses))),
        ("used as", _pinholes(dataset.train)),
        ("distance", _distances(dataset)),
        ("masks", _masks(dataset.train)),
        ("points", f"{len(dataset.points.position):,}" if dataset.points is not None else "none"),
        ("object", f"centre ({_numbers(dataset.bound.centre, dataset.bound.radius)}), radius {dataset.bound.radius:.4g}"),
        ("own frame", _frame(dataset)),
        ("on CPU", "; ".join(f"{name} {job['text']}" for name, job in jobs.items())),
        *(("warning", line) for line in _shortened(dataset.warnings)),
    ]


def estimate_jobs(dataset: Dataset) -> dict[str, dict[str, Any]]:
    """Estimate a reconstruction on the CPU with each preset whose time is known: by preset, the values of `job_in_words`."""
    jobs = {}
    for name, settings in PRESETS.items():
        sized = with_texture_size(settings, size_by_pixels(settings, dataset).size)
        seconds = estimate_seconds(sized, dataset)
        if seconds is not None:
            sized = with_sizes(sized, dataset.object_pixels if dataset.has_alpha else None)
            jobs[name] = job_in_words(seconds, estimate_memory(sized, dataset.pixels()))
    return jobs


def job_in_words(seconds: float, memory: int) -> dict[str, Any]:
    """Return a job's seconds, its memory in bytes, and both as text."""
    text = f"about {in_words(seconds)}, {memory / 2**30:.1f} GiB of memory"
    return {"seconds": round(seconds), "memory": memory, "text": text}


def _sizes(views: list[View]) -> str:
    counts = Counter((v.camera.width, v.camera.height) for v in views)
    sizes = [f"{w}x{h}" + (f" ({n})" if len(counts) > 1 else "") for (w, h), n in counts.most_common(SHOWN)]
    kinds = Counter(v.path.suffix.lower().lstrip(".") for v in views)
    return ", ".join(sizes) + f", {', '.join(sorted(kinds))}"


def _novel(dataset: Dataset) -> str:
    return f"{sum(dataset.novel.values())} views under other lights: {', '.join(dataset.novel)}"


def _pinholes(views: list[View]) -> str:
    focal = np.array([v.camera.fx for v in views])
    angle = np.degrees(2 * np.arctan(np.array([v.camera.width for v in views]) / (2 * focal)))
    return f"pinhole, focal {_range(focal, '.1f')} px, horizontal field of view {_range(angle, '.1f')} degrees"


def _distances(dataset: Dataset) -> str:
    distance = [np.linalg.norm(v.camera.centre - dataset.bound.centre) for v in dataset.train]
    return f"{_range(np.array(distance), '.3g')} from the object's centre"


def _masks(views: list[View]) -> str:
    masked = [v.alpha for v in views if v.alpha is not None]
    if not masked:
        return "none"
    return f"{len(masked)} of {len(views)} training views, object on {100 * (_object_share(masked) or 0):.0f} % of the pixels"


def _object_share(masks: list[np.ndarray]) -> float | None:
    return float(np.mean([float(mask.mean()) for mask in masks])) if masks else None


def _frame(dataset: Dataset) -> str:
    if np.array_equal(dataset.to_world, np.eye(4)):
        return "the same as the world"
    up = dataset.to_world[2, :3] / np.linalg.norm(dataset.to_world[2, :3])
    origin = np.linalg.inv(dataset.to_world)[:3, 3]
    radius = dataset.bound.radius / np.cbrt(np.linalg.det(dataset.to_world[:3, :3]))
    centre = _numbers(_own_centre(dataset), radius)
    return f"up is ({_numbers(up, 1.0)}), the world's origin is at ({_numbers(origin, radius)}), the object at ({centre})"


def _own_centre(dataset: Dataset) -> np.ndarray:
    return (np.linalg.inv(dataset.to_world) @ [*dataset.bound.centre, 1])[:3]


def _numbers(values: object, scale: float) -> str:
    """Format values rounded to a thousandth of `scale`, since smaller digits are noise."""
    rounded = np.round(np.asarray(values, np.float64), 3 - int(np.floor(np.log10(scale)))) + 0.0  # avoids -0
    return ", ".join(f"{v:.6g}" for v in rounded)


def _range(values: np.ndarray, style: str) -> str:
    low, high = format(values.min(), style), format(values.max(), style)
    return low if low == high else f"{low} to {high}"


def _shortened(lines: list[str]) -> list[str]:
    return lines if len(lines) <= SHOWN else [*lines[: SHOWN - 1], f"and {len(lines) - SHOWN + 1} more"]
