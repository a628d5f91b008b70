# SPDX-License-Identifier: GPL-3.0-or-later
"""Kills of a capture at random moments: the next start must reach the same dataset as an undisturbed capture."""

from __future__ import annotations

import json
import os
import random
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from irgspp.core.datasets.formats.captured import FILE
from PIL import Image
from stresses.case import Measured
from stresses.table_scene import photographed_table

from .cases import case_of
from .tiny import JobStarter, KillPoint, differing_files, kill_after, redirect_output, user_lines, watch_operations

case = case_of("kill")
DATABASE = "database.db"  # of the features: SQLite orders its pages by the history of its writes
COUNT, WIDTH, STEP = 8, 320, 9.0  # photographs, their width in pixels, and degrees between neighbours


def work(photographs: str, dataset: str, kill_point: KillPoint) -> None:
    """Capture photographs from the command line and end the process with its exit status.

    Args:
        photographs: folder of the photographs.
        dataset: folder to write; messages go to DATASET.txt.
        kill_point: operation before which the process kills itself.
    """
    redirect_output(Path(f"{dataset}.txt"))
    from irgspp.core.cli.main import main

    operations = watch_operations(Path(dataset), kill_point)
    status = main(["capture", photographs, "-o", dataset])
    if kill_point.counted:
        Path(kill_point.counted).write_text(str(len(operations)), encoding="utf-8")
    sys.stdout.flush()
    os._exit(status)


def write_photographs(folder: Path) -> Path:
    """Write photographs of a box on a table, and return the folder."""
    folder.mkdir()
    for view in photographed_table(count=COUNT, width=WIDTH, step=STEP).views:
        Image.fromarray(np.uint8(np.round(255 * view.colour))).save(folder / view.path.name)
    return folder


def check_kills(measured: Measured, moments: int, seed: int = 0) -> None:
    """Kill captures and start them again; half of the moments are random times, half are just before an operation on the dataset's files.

    Args:
        measured: result of the case.
        moments: number of moments.
        seed: seed of the moments.
    """
    chance, starter, killed = random.Random(seed), JobStarter(), 0
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        folder = Path(name)
        photographs, reference, counted = write_photographs(folder / "photographs"), folder / "reference", folder / "operations"
        began = time.monotonic()
        status = starter.run(work, str(photographs), str(reference), KillPoint(counted=str(counted)))
        if status:
            raise RuntimeError(f"the undisturbed capture ended with status {status}: {user_lines(Path(f'{reference}.txt'))}")
        seconds, operations = time.monotonic() - began, int(counted.read_text("utf-8"))
        for i in range(moments):
            progress = (i // 2 + chance.random()) / ((moments + 1) // 2)  # spread over the whole capture
            dataset = folder / "dataset"
            if i % 2:
                killed += starter.run(work, str(photographs), str(dataset), KillPoint(1 + int(0.95 * progress * operations))) == -9
            else:
                process = starter.start(work, str(photographs), str(dataset), KillPoint())
                killed += kill_after(process, 0.9 * progress * seconds)
            _started_again(measured, starter, photographs, dataset, reference, f"moment {i}, at {100 * progress:.0f} %")
            shutil.rmtree(dataset)
        measured.at_least("moments", killed, 0.8 * moments)


def _started_again(measured: Measured, starter: JobStarter, photographs: Path, dataset: Path, reference: Path, where: str) -> None:
    """Start a killed capture again and check its dataset."""
    status = starter.run(work, str(photographs), str(dataset), KillPoint())
    measured.holds(f"{where}: the next start ends well, not with status {status}", status == 0)
    if status == 0:
        measured.holds(f"{where}: {FILE} says done", json.loads((dataset / FILE).read_text("utf-8"))["status"] == "done")
        different = [file for file in differing_files(dataset, reference) if file != DATABASE]
        measured.holds(f"{where}: the same bits, not others in {', '.join(different)}", not different)


@case(
    "2 moments of a capture of seconds",
    """SIGKILL of a capture at random moments of the clock and before random operations on files: the next start goes on and ends with the
    same bits as an undisturbed capture.""",
    quick=False,
)
def some_moments(measured: Measured) -> None:
    """Check two moments."""
    check_kills(measured, 2)


@case("20 moments of a capture of seconds", "The same at 20 moments, spread over the whole capture.", quick=False)
def many_moments(measured: Measured) -> None:
    """Check 20 moments."""
    check_kills(measured, 20, seed=1)
