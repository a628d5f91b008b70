# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes below a folder, and the job that reconstructs and evaluates each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from irgspp.core.batch.jobs import Job
from irgspp.core.datasets.format_detection import LOOKED_FOR, NoDataset, parse_dataset
from irgspp.core.errors import InputError
from irgspp.core.settings.schema import DataSettings

DEEPEST = 3  # folders below the root
TRUTH = {"relight_gt", "ground_truth"}  # what collections keep beside their scenes, with cameras of its own


@dataclass(frozen=True)
class Scene:
    """A dataset below the root: its name (the way there, with _ between folders) and format; `trouble`: why it can't be read."""

    name: str
    path: Path
    format: str
    trouble: str = ""

    @property
    def known_as(self) -> str:
        """What papers call it: the folder's name, without what converters add."""
        return self.path.resolve().name.lower().removesuffix("_blender")


def find_scenes(root: Path, wanted: Sequence[str] | None = None) -> list[Scene]:
    """All datasets below a folder, or those of the `wanted` names. Raises InputError where there are none, or a name is missing."""
    if not root.is_dir():
        raise InputError(root, "is no folder")
    found = sorted(_scenes(root, root, DEEPEST), key=lambda scene: scene.name)
    if not found:
        raise InputError(root, "no dataset in it or below", LOOKED_FOR)
    if wanted is None:
        return found
    if missing := [name for name in wanted if name not in {scene.name for scene in found}]:
        raise InputError("--scenes", f"there is no {', '.join(missing)}", f"use {', '.join(scene.name for scene in found)}")
    return [scene for scene in found if scene.name in wanted]


def _scenes(folder: Path, root: Path, deeper: int) -> Iterator[Scene]:
    name = "_".join(folder.relative_to(root).parts) or root.resolve().name
    try:
        yield Scene(name, folder, parse_dataset(folder, DataSettings()).format)
    except NoDataset:
        for below in sorted(folder.iterdir()) if deeper else []:
            if below.is_dir() and below.name not in TRUTH and not below.name.startswith("."):
                yield from _scenes(below, root, deeper - 1)
    except InputError as error:  # it is a dataset, and damaged
        yield Scene(name, folder, "", str(error))


def job_of(scene: Scene, out: Path, protocol: str, reconstruct: Sequence[str], evaluate: Sequence[str]) -> Job:
    """Reconstruct into out/runs/SCENE and evaluate into out/reports/SCENE, with further words for each of the two."""
    run, report, dataset = out / "runs" / scene.name, out / "reports" / scene.name, str(scene.path.resolve())
    first = ("reconstruct", dataset, "-o", str(run), *reconstruct)
    return Job(scene.name, run, (first, ("evaluate", str(run), dataset, "-o", str(report), "--protocol", protocol, *evaluate)), out)
