# SPDX-License-Identifier: GPL-3.0-or-later
"""Unusual places of files and programs: odd names, other locales, read-only folders, case-insensitive file systems."""

from __future__ import annotations

import locale
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from irgspp.core.datasets.load import load_dataset
from irgspp.core.datasets.parsed_dataset import view_names
from irgspp.core.run_folder import read_run
from irgspp.core.scene.camera_files import save_views
from stresses.case import Measured

from .cases import case_of
from .mounts import LEFT_OUT, can_mount, mounted, remount
from .tiny import SETTINGS, JobStarter, KillPoint, differing_files, reference_run, work, write_dataset

case = case_of("places")
ROOT = Path(__file__).resolve().parents[2]
ODD = Path("mit Leerzeichen & 'Strich'", "写真 é ü %s {0}", "lang" * 25, "tief" * 25)
GERMAN = "de_DE.UTF-8"


def check_same_bits(measured: Measured, starter: JobStarter, data: Path, run: Path, function: Callable[..., None] = work) -> None:
    """Check that a job there has the same bits as one in a plain folder.

    Args:
        measured: result of the case.
        starter: starter of processes.
        data: folder of the photographs.
        run: run folder.
        function: function of the job.
    """
    _, reference, _ = reference_run()
    status = starter.run(function, str(data), str(run), False, KillPoint())
    measured.holds(f"the job ends well, not with status {status}: {Path(f'{run}.txt').read_text('utf-8')[-300:]}", status == 0)
    if status == 0:
        different = [name for name in differing_files(run, reference) if name != "cameras.json"]  # names the photographs' folder
        measured.holds(f"the same bits, not others in {', '.join(different)}", not different)
        measured.holds("with scene.blend", (run / "scene.blend").is_file())


@case("odd names", "A job in folders with spaces, quotes, umlauts, Chinese, format signs, 250 characters deep: the same bits as elsewhere.")
def names(measured: Measured) -> None:
    """Check odd names."""
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        odd = Path(name) / ODD
        data, run = write_dataset(odd / "Fotos ä"), odd / "Läufe 1"
        check_same_bits(measured, JobStarter(), data, run)
        measured.note(f"{len(os.fsencode(run))} bytes of path")


def work_in_german_locale(dataset: str, run: str, resume: bool, kill_point: KillPoint) -> None:
    """Run the job where a half is written 0,5, in C libraries too.

    Args:
        dataset: folder of the photographs.
        run: run folder.
        resume: True to resume the run.
        kill_point: see `tiny.work`.
    """
    os.environ |= {"LOCPATH": str(Path(dataset).parent), "LC_ALL": GERMAN, "LANG": GERMAN}  # of Blender's process, too
    locale.setlocale(locale.LC_ALL, GERMAN)
    assert locale.localeconv()["decimal_point"] == ","
    work(dataset, run, resume, kill_point)


@case("German decimals", f"A job under {GERMAN}, set in its process for C as well: the same bits as elsewhere.", quick=False)
def decimals(measured: Measured) -> None:
    """Check the German locale."""
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        folder = Path(name)
        if shutil.which("localedef") is None:
            measured.note("left out: no localedef to make the locale with")
            return
        subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", str(folder / GERMAN)], check=True)
        data = write_dataset(folder / "Fotos")
        check_same_bits(measured, JobStarter(), data, folder / "run", work_in_german_locale)
        measured.note("0,5 in the job's process")


@case(
    "read-only install folder",
    "A job from a folder that can't be written to, with kernels that are not compiled yet, and another with these kernels: the same bits.",
    quick=False,
)
def installed(measured: Measured) -> None:
    """Check a read-only install folder."""
    if not can_mount():
        measured.note(LEFT_OUT)
        return
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        folder = Path(name)
        data, run = write_dataset(folder / "photographs"), folder / "run"
        with mounted("--bind", str(ROOT), place=folder / "installed") as place:
            remount(place, "ro,bind")
            measured.holds("the folder is read-only", not os.access(place / "core", os.W_OK))
            words = ["reconstruct", str(data), "-o", str(run), "--preset", "draft", *(w for s in SETTINGS for w in ("--set", s))]
            command = [sys.executable, "-P", str(place / "irgspp_addon" / "launch.py"), "__main__", *words]
            environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {"IRGSPP_CACHE": str(folder / "cache")}
            second = folder / "second"  # by the kernels that the first has compiled
            for output in (run, second):
                words = [str(output) if word == str(run) else word for word in command]
                done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment, cwd="/")
                measured.holds(f"{output.name} ends well: {done.stderr[-300:]}", done.returncode == 0)
                measured.holds(f"run.json of {output.name} says done", output.is_dir() and read_run(output)["status"] == "done")
            measured.holds("the same bits", not differing_files(second, run))
            measured.note(f"{len(list((folder / 'cache').rglob('*.nbc')))} kernels compiled elsewhere")


@case(
    "a file system where A is a",
    "Views a.png, A.jpg and á.png, á.png of other folders stay separate: as many undistorted copies or images as views (ext4, casefold).",
    quick=False,
)
def one_case(measured: Measured) -> None:
    """Check a case-insensitive file system."""
    if not can_mount() or shutil.which("mkfs.ext4") is None:
        measured.note(LEFT_OUT)
        return
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        image = Path(name) / "image"
        image.write_bytes(bytes(32 << 20))
        subprocess.run(["mkfs.ext4", "-q", "-O", "casefold", "-E", "encoding=utf8", str(image)], check=True)
        try:
            with mounted("-o", "loop", str(image), place=Path(name) / "disk") as disk:
                _check_view_names(measured, disk)
        except OSError as error:
            measured.note(f"left out: {error}")


def _check_view_names(measured: Measured, disk: Path) -> None:
    """Save views whose names differ in case or normalisation alone."""
    runs = disk / "runs"
    runs.mkdir()
    subprocess.run(["chattr", "+F", str(runs)], check=True)
    (runs / "probe").touch()
    measured.holds("A is a there", (runs / "PROBE").exists())
    data = load_dataset(write_dataset(disk / "photographs"))
    listed = ["x/a.png", "y/A.jpg", "x/\u00e1.png", "y/a\u0301.png", "z/a.PNG"]
    views = [replace(v, name=n, distorted=True) for v, n in zip(data.train, view_names(listed), strict=False)]
    save_views(runs / "cameras.json", [("train", view) for view in views])
    kept = list((runs / "photographs" / "train").iterdir())
    measured.at_least("images of 5 views", len(kept), len(listed))
