# SPDX-License-Identifier: GPL-3.0-or-later
"""The views that an evaluation compares, and what is known of each, in the world of the run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..datasets.load import load_dataset, load_novel_views
from ..progress.protocol import Progress
from ..scene.camera import Camera
from ..scene.dataset import View
from ..scene.reconstruction import Reconstruction
from ..settings.schema import DataSettings
from .ground_truth import SceneTruth, Truth, load_scene_truth, load_truth


@dataclass(frozen=True, eq=False)
class Case:
    """A view, its camera in the world of the run, and its truth."""

    number: int
    view: View
    camera: Camera
    truth: Truth


@dataclass(frozen=True, eq=False)
class Cases:
    """First the `own` views under the dataset's light, of a split that has `of`, then some of the `novel` ones under other lights."""

    split: str
    own: int
    of: int
    novel: int
    views: list[View]
    cameras: list[Camera]
    scene: SceneTruth
    to_world: np.ndarray

    @cached_property
    def names(self) -> list[str]:
        """Of the views; with their light where one name is that of several."""
        count = Counter(view.name for view in self.views)
        return [view.name if view.light is None or count[view.name] == 1 else f"{view.light}_{view.name}" for view in self.views]

    @property
    def unit(self) -> float:
        """Lengths of the run's world that are one of the dataset's."""
        return float(np.cbrt(np.linalg.det(self.to_world[:3, :3])))

    def __iter__(self) -> Iterator[Case]:
        """One view after the other: at full size, the truth of hundreds of views is more than fits in memory."""
        for number, (view, camera) in enumerate(zip(self.views, self.cameras, strict=True)):
            yield Case(number, view, camera, load_truth(view, self.scene, self.to_world))


def read_cases(
    reconstruction: Reconstruction,
    dataset: Path,
    settings: DataSettings,
    progress: Progress,
    relit: int | None = None,
    wanted: int | None = None,
) -> Cases:
    """The test views of a dataset, or its training views where it has no others, and its views under other lights.

    relit: the first so many under each other light; None: all. wanted: so many of each kind, evenly spread; None: all.
    """
    data = load_dataset(dataset, settings, progress)
    split, every = ("test", data.test) if data.test else ("train", data.train)
    by_light: dict[str | None, list[View]] = {}
    for view in load_novel_views(data, settings, progress):
        by_light.setdefault(view.light, []).append(view)
    chosen = spread_views(every, wanted)
    views = [*chosen, *(view for views in by_light.values() for view in spread_views(views[:relit], wanted))]
    same = reconstruction.to_world @ np.linalg.inv(data.to_world)  # read on its own, a dataset may be placed otherwise
    cameras = [view.camera.moved(same) for view in views]
    scene = load_scene_truth(dataset, reconstruction.to_world)
    novel = sum(len(views) for views in by_light.values())
    return Cases(split, len(chosen), len(every), novel, views, cameras, scene, reconstruction.to_world)


def spread_views(views: list[View], wanted: int | None) -> list[View]:
    """At most `wanted` of the views, evenly apart; None: all."""
    return views if wanted is None else [views[i] for i in spread(len(views), wanted)]


def spread(count: int, wanted: int) -> list[int]:
    """At most `wanted` of the numbers below `count`, evenly apart."""
    return sorted({round(i) for i in np.linspace(0, count - 1, min(wanted, count))}) if wanted and count else []
