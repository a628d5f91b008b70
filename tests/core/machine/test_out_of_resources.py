# SPDX-License-Identifier: GPL-3.0-or-later
"""Full disks and exhausted memory are reported in one line, whatever library met them; other errors pass as they are."""

import errno
import os

import pytest
from irgspp.core import run_folder
from irgspp.core.cli import commands
from irgspp.core.cli import main as cli
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import InputError
from irgspp.core.machine import disk_space
from irgspp.core.machine.out_of_resources import OutOfResources, as_out_of_resources, translate_errors
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.run_folder import RunFolder, read_run
from irgspp.core.settings.schema import Settings, preset
from irgspp.core.settings.sizes import with_sizes


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "/runs/a/mesh.ply"), "/runs/a/mesh.ply: the disk is full"),
        (OSError(errno.EDQUOT, "x"), "quota"),
        (OSError(errno.EROFS, "x"), "can only be read"),
        (OSError(errno.EFBIG, "x"), "larger than"),
        (RuntimeError(f"Cannot write image file: {os.strerror(errno.ENOSPC)}."), "the disk is full"),
        (MemoryError(), "memory ran out"),
        (RuntimeError("[enforce fail at alloc_cpu.cpp] DefaultCPUAllocator: can't allocate memory: you tried 9 bytes"), "memory ran out"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "memory ran out"),
    ],
)
def test_exhausted_resources_are_reported(tmp_path, error, words):
    with pytest.raises(OutOfResources, match=r"--resume$") as found, translate_errors(tmp_path):
        raise error
    assert words in str(found.value) and "\n" not in str(found.value)
    assert found.value.exit_status == 1


def test_full_disk_behind_another_error_is_found(tmp_path):
    with pytest.raises(OutOfResources, match="the disk is full"), translate_errors(tmp_path):
        try:
            raise OSError(errno.ENOSPC, "x")
        except OSError:
            raise RuntimeError("PytorchStreamWriter failed") from None


def test_resuming_is_not_advised_where_it_is_impossible(tmp_path):
    assert str(as_out_of_resources(MemoryError(), tmp_path, resumable=False)) == f"{tmp_path}: memory ran out; close other programs"


def test_libraries_that_do_not_say_why_are_asked_about_the_disk(tmp_path, monkeypatch):
    error = RuntimeError("write failed")
    assert as_out_of_resources(error, tmp_path) is None
    monkeypatch.setattr("irgspp.core.machine.out_of_resources.FULL", 1 << 62)
    assert "the disk is full" in str(as_out_of_resources(error, tmp_path))


@pytest.mark.parametrize("error", [InputError("a", "is bad"), FileNotFoundError(2, "x"), ValueError("x")])
def test_other_errors_pass(tmp_path, error):
    with pytest.raises(type(error)), translate_errors(tmp_path):
        raise error


def test_disk_that_is_too_full_for_the_log_too(tmp_path, monkeypatch, capsys):
    """The handler of an error must not meet the same disk and end in a traceback."""

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(commands, "devices", full)
    monkeypatch.setattr(cli.tempfile, "mkstemp", full)
    assert cli.main(["devices"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("irgspp: ") and line.endswith("the disk is full; free some disk space")  # nothing of it can be resumed


def test_job_on_a_full_disk_reports_the_disk(tmp_path, monkeypatch):
    folder = RunFolder.open(tmp_path / "run", Settings(), "photos")

    def full(*_):
        raise OSError(errno.ENOSPC, "x")

    monkeypatch.setattr(run_folder, "write_atomic", full)
    with pytest.raises(OutOfResources, match="the disk is full"), folder.job(), folder.timed("fit"):
        raise ValueError("the disk was full, so to speak")
    folder.close()
    assert read_run(tmp_path / "run")["status"] == "running"  # as after a kill


def test_disk_space_is_checked_before_anything_is_written(tmp_path, monkeypatch):
    data = load_dataset(DEMO_DATA)
    settings = with_sizes(preset("balanced"), data.object_pixels)
    needed = disk_space.estimate_disk_space(settings, data.pixels(distorted=True))
    assert 50e6 < needed < 500e6
    assert (
        disk_space.estimate_disk_space(preset("paper"), data.pixels(distorted=True))
        > 2 * needed
        > 2 * disk_space.estimate_disk_space(preset("draft"), data.pixels(distorted=True))
    )
    disk_space.check_disk_space(tmp_path / "a" / "run", settings, data.pixels(distorted=True))
    usage = type("Usage", (), {"free": 10**6})
    monkeypatch.setattr(disk_space.shutil, "disk_usage", lambda _: usage)
    with pytest.raises(InputError, match=r"run: the job needs about \d+ MB of disk space, of which 1 MB are free; free some disk space"):
        disk_space.check_disk_space(tmp_path / "a" / "run", settings, data.pixels(distorted=True))
    assert not list(tmp_path.iterdir())
