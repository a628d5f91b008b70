# SPDX-License-Identifier: GPL-3.0-or-later
"""Views that an evaluation compares, with their cameras and ground truth in the world frame of the run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
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
    """View to compare, with its camera in the world frame of the run and its ground truth.

    Attributes:
        number: its index among the cases.
    """

    number: int
    view: View
    camera: Camera
    truth: Truth


@dataclass(frozen=True, eq=False)
class Cases:
    """All views to compare: those under the dataset's light first, then those under other lights.

    Attributes:
        split: "test", or "train" where the dataset has no test views.
        own: number of views under the dataset's light.
        of: number of views that the split has.
        novel: number of views under other lights that the dataset has.
        views: to compare; the first `own` of them are under the dataset's light.
        cameras: of the views, in the world frame of the run.
        scene: ground truth of the scene.
        to_world: (4, 4) from the dataset's frame to the run's world frame.
    """

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
        """Names of the views, preceded by their light where several views have the same name."""
        count = Counter(view.name for view in self.views)
        return [view.name if view.light is None or count[view.name] == 1 else f"{view.light}_{view.name}" for view in self.views]

    @property
    def unit(self) -> float:
        """Length in the run's world frame of one unit of the dataset."""
        return float(np.cbrt(np.linalg.det(self.to_world[:3, :3])))

    def __iter__(self) -> Iterator[Case]:
        """Yield one view after the other, since the full-size ground truth of hundreds of views does not fit in memory."""
        for number, (view, camera) in enumerate(zip(self.views, self.cameras, strict=True)):
            yield Case(number, view, camera, load_truth(view, self.scene, self.to_world))


def read_cases(
    reconstruction: Reconstruction,
    dataset: Path,
    settings: DataSettings,
    progress: Progress,
    relit_limit: int | None = None,
    limit: int | None = None,
) -> Cases:
    """Read the test views of a dataset (its training views where it has no others) and its views under other lights.

    Args:
        reconstruction: whose world frame the cameras and the ground truth are brought into.
        dataset: folder or file.
        settings: of reading the dataset.
        progress: reporter of reading.
        relit_limit: only so many of the first views under each other light; None: all.
        limit: only so many views of each kind, evenly spread; None: all.
    """
    data = load_dataset(dataset, settings, progress)
    split, every = ("test", data.test) if data.test else ("train", data.train)
    by_light: dict[str | None, list[View]] = {}
    for view in load_novel_views(data, settings, progress):
        by_light.setdefault(view.light, []).append(view)
    chosen = spread_views(every, limit)
    views = [*chosen, *(view for views in by_light.values() for view in spread_views(views[:relit_limit], limit))]
    # Read on its own, a dataset may be normalised to another world frame.
    to_run = reconstruction.to_world @ np.linalg.inv(data.to_world)
    cameras, turn = [view.camera.moved(to_run) for view in views], to_run[:3, :3] / np.cbrt(np.linalg.det(to_run[:3, :3]))
    views = [one if (own := one.light_rotation) is None else replace(one, light_rotation=turn @ own @ turn.T) for one in views]
    scene = load_scene_truth(dataset, reconstruction.to_world)
    novel = sum(len(views) for views in by_light.values())
    return Cases(split, len(chosen), len(every), novel, views, cameras, scene, reconstruction.to_world)


def spread_views(views: list[View], limit: int | None) -> list[View]:
    """Return some of the views, evenly spread.

    Args:
        views: to choose from.
        limit: how many at most; None: all.
    """
    return views if limit is None else [views[i] for i in spread(len(views), limit)]


def spread(count: int, limit: int) -> list[int]:
    """Return indices below `count`, evenly spread.

    Args:
        count: of all elements.
        limit: number of indices at most.
    """
    return sorted({round(i) for i in np.linspace(0, count - 1, min(limit, count))}) if limit and count else []
