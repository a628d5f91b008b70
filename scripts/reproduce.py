# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstruct and evaluate every scene below a folder as its paper does, and print the paper's table with our rows in it.

    python scripts/reproduce.py DATASETS [-o OUT] [--preset balanced] [--scenes a,b] [--views N]

OUT gets tables.md, tables.json and tables.html, the runs and their reports. The same command continues after an interruption: finished work
is not repeated, a stopped run resumes.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from irgspp.core.batch.batch import batch_folder, run_batch
from irgspp.core.batch.job_state import State
from irgspp.core.batch.jobs import Job
from irgspp.core.cli.parser import check_words
from irgspp.core.errors import InputError
from irgspp.core.evaluation.protocols import PROTOCOLS
from irgspp.core.progress.terminal import Terminal
from irgspp.core.run_folder import read_run, write_atomic
from irgspp.core.settings.schema import PRESETS
from reproduction.command import run_command
from reproduction.scenes import Scene, discard_stale_report, find_scenes, job_of
from reproduction.tables import Result, as_html, as_json, as_markdown, benchmark_of, tables_of


def arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; `argv` is that of the process where None."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=Path, metavar="DATASETS", help="folder with scenes in it or below")
    parser.add_argument("-o", dest="out", type=Path, default=Path("reproduction"), metavar="OUT", help="default: reproduction")
    parser.add_argument("--scenes", metavar="A,B", help="some of them (default: all)")
    parser.add_argument("--preset", choices=list(PRESETS), default="balanced", help="default: balanced")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the reconstructions (repeatable)")
    parser.add_argument("--protocol", choices=list(PROTOCOLS), help="default: that of each dataset's published table")
    parser.add_argument("--views", type=int, metavar="N", help="number of test views of each scene, evenly spread (default: all)")
    parser.add_argument("--samples", type=int, metavar="N", help="light samples per pixel (default: the protocol's)")
    parser.add_argument("--lpips", type=Path, metavar="FILE", help="the metric LPIPS as TorchScript")
    parser.add_argument("-j", dest="at_once", type=int, default=1, metavar="N", help="scenes at a time on this machine (default: 1)")
    parser.add_argument("--dask", metavar="ADDRESS", help="on the workers of this scheduler, which see the same folders")
    return parser.parse_args(argv)


def jobs_of(args: argparse.Namespace, scenes: Sequence[Scene], out: Path) -> list[Job]:
    """Return a job for each scene that can be read.

    Args:
        args: parsed options.
        scenes: scenes below the folder.
        out: folder of runs and reports.

    Raises:
        InputError: for options that the commands refuse.
    """
    reconstruct = ["--preset", args.preset, *(word for text in args.set for word in ("--set", text))]
    given = {"--views": args.views, "--samples": args.samples, "--lpips": args.lpips and args.lpips.resolve()}
    evaluate = [word for option, value in given.items() if value is not None for word in (option, str(value))]
    jobs = [
        job_of(scene, out, args.protocol or benchmark_of(scene.format)["protocol"], reconstruct, evaluate)
        for scene in scenes
        if not scene.trouble
    ]
    for step in jobs[0].steps if jobs else ():
        check_words(step)
    return jobs


def result_of(scene: Scene, states: Mapping[str, State], out: Path) -> Result:
    """Return the result of a scene.

    Args:
        scene: scene of the batch.
        states: final states of the jobs by name.
        out: folder of runs and reports.
    """
    run, report = out / "runs" / scene.name, out / "reports" / scene.name / "report.json"
    state = states.get(scene.name, State("failed", scene.trouble))
    about = (scene.name, scene.known_as, scene.format)
    if state.state != "done":
        return Result(*about, None, trouble=state.error or state.state, stand_in=scene.stand_in)
    seconds = sum(phase["seconds"] for phase in read_run(run)["phases"].values())
    found = json.loads(report.read_text(encoding="utf-8"))
    return Result(*about, found, seconds / 3600, sheet=run / "contact_sheet.png", stand_in=scene.stand_in)


def write(out: Path, results: Sequence[Result], ours: str) -> str:
    """Write the tables as files.

    Args:
        out: folder of the files.
        results: results of all scenes.
        ours: label of our rows.

    Returns:
        The tables as Markdown.
    """
    tables = tables_of(results, ours)
    text = as_markdown(tables)
    for name, content in (("md", text), ("json", json.dumps(as_json(tables), indent=1)), ("html", as_html(tables, results))):
        write_atomic(out / f"tables.{name}", content.encode())
    return text


def reproduce(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the batch, write the tables, and return the exit status.

    Args:
        args: parsed options.
        terminal: terminal with Ctrl-C.

    Raises:
        InputError: where the options or the folder are wrong.
    """
    out = args.out.resolve()
    scenes = find_scenes(args.root, args.scenes.split(",") if args.scenes else None)
    jobs = jobs_of(args, scenes, out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(out, f"can't be made ({error.strerror})") from error
    for job in jobs:
        discard_stale_report(job)
    states = run_batch(jobs, batch_folder(out / "scenes"), lambda: terminal.cancelled, max(1, args.at_once), args.dask)
    results = [result_of(scene, states, out) for scene in scenes]
    print(write(out, results, f"ours, {args.preset}"))
    print(out / "tables.html")
    return int(any(result.report is None for result in results))


def main(argv: Sequence[str] | None = None) -> int:
    """Reproduce the tables and return the exit status."""
    args = arguments(argv)
    return run_command("reproduce", lambda terminal: reproduce(args, terminal))


if __name__ == "__main__":
    sys.exit(main())
