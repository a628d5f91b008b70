# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes below a folder, and the job that reconstructs and evaluates each."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from irgspp.core.batch.jobs import Job
from irgspp.core.datasets.format_detection import LOOKED_FOR, NoDataset, parse_dataset
from irgspp.core.errors import InputError
from irgspp.core.settings.schema import DataSettings

DEEPEST = 3  # levels of folders below the root
STAND_IN = "stand_in.json"  # file in the folder of a collection of stand-ins
TRUTH = {"relight_gt", "ground_truth"}  # folders of ground truth next to scenes, which have cameras of their own


@dataclass(frozen=True)
class Scene:
    """Dataset below the root.

    Attributes:
        name: path from the root, with _ between folders.
        path: folder of the dataset.
        format: name of the format.
        trouble: reason why it can't be read; "" where it can.
        stand_in: it stands in for a published scene, see scripts/stand_ins.py.
    """

    name: str
    path: Path
    format: str
    trouble: str = ""
    stand_in: bool = False

    @property
    def known_as(self) -> str:
        """Name that papers use: the folder's name without what converters add."""
        return self.path.resolve().name.lower().removesuffix("_blender")


def find_scenes(root: Path, names: Sequence[str] | None = None) -> list[Scene]:
    """Return the datasets below a folder in order of their names.

    Args:
        root: folder to search.
        names: names of the scenes to return; None: all.

    Raises:
        InputError: where there is no dataset, or a name is unknown.
    """
    if not root.is_dir():
        raise InputError(root, "is not a folder")
    found = sorted(_scenes(root, root, DEEPEST), key=lambda scene: scene.name)
    if not found:
        raise InputError(root, "no dataset in it or below", LOOKED_FOR)
    if names is None:
        return found
    if missing := [name for name in names if name not in {scene.name for scene in found}]:
        raise InputError("--scenes", f"unknown scene {', '.join(missing)}", f"use {', '.join(scene.name for scene in found)}")
    return [scene for scene in found if scene.name in names]


def _scenes(folder: Path, root: Path, deeper: int) -> Iterator[Scene]:
    """Yield the datasets in and below a folder, `deeper` levels deep at most."""
    name = "_".join(folder.relative_to(root).parts) or root.resolve().name
    try:
        parsed = parse_dataset(folder, DataSettings())
        yield Scene(name, folder, parsed.format, stand_in=any((above / STAND_IN).is_file() for above in folder.parents[:2]))
    except NoDataset:
        for below in sorted(folder.iterdir()) if deeper else []:
            if below.is_dir() and below.name not in TRUTH and not below.name.startswith("."):
                yield from _scenes(below, root, deeper - 1)
    except InputError as error:  # it is a dataset, and damaged
        yield Scene(name, folder, "", str(error))


def job_of(scene: Scene, out: Path, protocol: str, reconstruct: Sequence[str], evaluate: Sequence[str]) -> Job:
    """Return the job that reconstructs a scene into out/runs/SCENE and evaluates it into out/reports/SCENE.

    Args:
        scene: scene of the job.
        out: folder of runs and reports.
        protocol: protocol of the evaluation.
        reconstruct: further options of `irgspp reconstruct`.
        evaluate: further options of `irgspp evaluate`.
    """
    run, report, dataset = out / "runs" / scene.name, out / "reports" / scene.name, str(scene.path.resolve())
    first = ("reconstruct", dataset, "-o", str(run), *reconstruct)
    return Job(scene.name, run, (first, ("evaluate", str(run), dataset, "-o", str(report), "--protocol", protocol, *evaluate)), out)


def discard_stale_report(job: Job) -> None:
    """Remove the report of a job whose run is newer, or that is not whole, so that it is evaluated again.

    Args:
        job: from `job_of`.
    """
    run, folder = job.run / "run.json", Path(job.steps[1][job.steps[1].index("-o") + 1])
    report = folder / "report.json"
    if folder.is_dir() and not (report.is_file() and run.is_file() and report.stat().st_mtime >= run.stat().st_mtime):
        shutil.rmtree(folder)
