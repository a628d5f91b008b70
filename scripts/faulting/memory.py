# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory of a job: estimated before the start; where it is short, the job takes less of it or ends with one clear message."""

from __future__ import annotations

import resource
import shutil
import tempfile
from pathlib import Path

import psutil
from irgspp.core.datasets.load import load_dataset
from irgspp.core.machine.cpu_memory import estimate_memory
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.run_folder import read_run
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings, preset
from stresses.case import Measured

from .cases import case_of
from .tiny import JobStarter, KillPoint, differing_files, reference_run, settings, user_lines, work, write_dataset

case = case_of("memory")
WITHIN = 0.25  # fraction of the measured peak by which the estimate may be off
MIB = 1 << 20
STATED = {  # jobs whose peak is compared with the estimate: preset and changes
    "tiny": ("draft", ()),
    "draft": ("draft", ("data.resolution=64",)),
    "balanced": ("balanced", ("data.resolution=64",)),
    "more points": ("balanced", ("data.resolution=64", "second.points=5000", "second.rows=20")),
}


def job(dataset: str, run: str, preset_name: str, changes: tuple[str, ...]) -> None:
    """Run a job in a process of its own.

    Args:
        dataset: folder of the photographs.
        run: run folder.
        preset_name: preset to start from.
        changes: settings as `KEY=VALUE`.
    """
    import os

    from irgspp.core.pipeline import reconstruct

    reconstruct(Path(dataset), Path(run), with_overrides(preset(preset_name), changes))
    os._exit(0)


def peak(run: Path) -> int:
    """Return the peak memory of a finished run in bytes."""
    return max(phase["peak_memory"] for phase in read_run(run)["phases"].values())


def compare_estimate(measured: Measured, name: str, dataset: Path, job_settings: Settings, run: Path) -> None:
    """Compare the estimate with the measured peak.

    Args:
        measured: result of the case.
        name: name of the job.
        dataset: folder of the photographs.
        job_settings: settings of the job.
        run: run folder.
    """
    estimate, found = estimate_memory(job_settings, load_dataset(dataset, job_settings.data).pixels()), peak(run)
    measured.at_most(f"{name}: {estimate / MIB:.0f} MB estimated, {found / MIB:.0f} used, off by", abs(estimate / found - 1), WITHIN)


@case("estimate of a job of seconds", f"The estimate before the start is within {WITHIN:.0%} of the measured peak.", quick=False)
def estimate(measured: Measured) -> None:
    """Check the estimate of a job of seconds."""
    starter = JobStarter()
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        data, run = write_dataset(Path(name, "photographs")), Path(name, "run")
        measured.holds("the job ends well", starter.run(work, str(data), str(run), False, KillPoint()) == 0)
        compare_estimate(measured, "tiny", data, settings(), run)


@case(
    "estimates of presets",
    f"On the demonstration's photographs, within {WITHIN:.0%} for draft, balanced, and more points.",
    quick=False,
)
def estimates(measured: Measured) -> None:
    """Check the estimates of the presets."""
    starter = JobStarter()
    for title, (name, changes) in STATED.items():
        if title == "tiny":
            continue
        with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as folder:
            run = Path(folder, "run")
            measured.holds(f"{title} ends well", starter.run(job, str(DEMO_DATA), str(run), name, changes) == 0)
            compare_estimate(measured, title, DEMO_DATA, with_overrides(preset(name), changes), run)


def work_with_memory_limit(dataset: str, run: str, more: int) -> None:
    """Run the job with a limit on its address space once it has read the dataset.

    Args:
        dataset: folder of the photographs.
        run: run folder.
        more: bytes beyond those in use then.
    """
    from irgspp.core import pipeline

    load = pipeline.load_dataset

    def limited(*words, **options):
        """Read the dataset and set the limit."""
        data = load(*words, **options)
        most = psutil.Process().memory_info().vms + more
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        return data

    pipeline.load_dataset = limited
    work(dataset, run, False, KillPoint())


@case(
    "ulimit -v, from plenty to nothing",
    """The job succeeds with the same bits as without a limit, with fewer rays at a time where that makes it fit, or says in one line
    that memory is short, before anything is written or with finished phases kept; it is never killed.""",
    quick=False,
)
def limits(measured: Measured) -> None:
    """Check limits from plenty to too little."""
    starter, ends = JobStarter(), []
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        folder = Path(name)
        data, reference, _ = reference_run()
        for more in (2000, 1200, 900, 700, 500, 350, 200, 100, 20):
            run = folder / "run"
            status, lines = starter.run(work_with_memory_limit, str(data), str(run), more * MIB), user_lines(Path(f"{run}.txt"))
            fewer = "memory is short" in Path(f"{run}.txt").read_text("utf-8")
            ends.append(f"{more} MB: {'fewer rays' if fewer else 'well' if status == 0 else f'status {status}'}")
            if status == 0:
                different = differing_files(run, reference)
                measured.holds(f"{more} MB: the same bits, not others in {', '.join(different)}", not different)
            else:
                measured.holds(f"{more} MB: status 1 or 2, not {status}", status in (1, 2))
                measured.holds(f"{more} MB: one line on memory, not {lines}", len(lines) == 1 and "memory" in lines[0])
            shutil.rmtree(run, ignore_errors=True)
        measured.note("; ".join(ends))


@case("no memory at all", "With 20 MB to spare no job begins: exit status 2 and one line with the memory that is needed.")
def none(measured: Measured) -> None:
    """Check that a job without enough memory does not begin."""
    starter = JobStarter()
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        data, run = write_dataset(Path(name, "photographs")), Path(name, "run")
        status, lines = starter.run(work_with_memory_limit, str(data), str(run), 20 * MIB), user_lines(Path(f"{run}.txt"))
        measured.holds(f"exit status 2, not {status}", status == 2)
        measured.holds(f"one line, not {lines}", len(lines) == 1 and "the job needs about" in lines[0] and "ulimit -v" in lines[0])
        measured.holds("nothing is left behind", not run.exists())
        measured.note("one line")
