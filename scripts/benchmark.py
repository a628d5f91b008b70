# SPDX-License-Identifier: GPL-3.0-or-later
"""Benchmark of error against time: relighting, reconstruction, geometry, materials, peers, kernels, and rules that skip work.

    python scripts/benchmark.py [SCENES...] [-o DIR] [--quick]

SCENES are folders with photographs and ground truth as scripts/render_dataset.py writes them, or folders of such; without any, two small
ones are rendered by Cycles. DIR gets results.json, a CSV file for each section, report.html, the reconstructions and their images. Run the
same command again to continue after an interruption or to repeat failed measurements. Nothing else should run on the machine meanwhile.
"""

from __future__ import annotations

import argparse
import importlib
import signal
import sys
from pathlib import Path
from types import ModuleType

from benchmarks import scenes
from benchmarks.bench import Bench, Scene, machine
from benchmarks.session import Session, steps_of
from benchmarks.store import Store
from irgspp.core.errors import InputError, IrgsppError

SECTIONS = ("relighting", "reconstruction", "geometry", "decomposition", "peers", "kernels", "skipping")
DOCS = Path(__file__).resolve().parent.parent / "docs"


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line; `argv` is that of the process where None."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "scenes",
        nargs="*",
        type=Path,
        metavar="SCENES",
        help="folders of scenes with ground truth (default: two small scenes rendered by Cycles)",
    )
    parser.add_argument(
        "-o", dest="out", type=Path, default=Path("benchmark"), metavar="DIR", help="folder of results (default: benchmark)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="the embedded 64x64 scene and short schedules, to check in minutes that everything works"
    )
    parser.add_argument("--sections", default=",".join(SECTIONS), metavar="A,B", help=f"some of {', '.join(SECTIONS)} (default: all)")
    parser.add_argument("--repeats", type=_count, metavar="N", help="repeats of each timing, of which the median counts (default: 5)")
    parser.add_argument("--budgets", type=_minutes, metavar="M,M", help="time budgets of reconstructions in minutes (default: 1,2,4)")
    parser.add_argument(
        "--lpips", type=Path, metavar="FILE", help="LPIPS as a TorchScript file, needed where the package lpips is not installed"
    )
    parser.add_argument(
        "--fresh", action="store_true", help="repeat all measurements, also those with results in DIR; reconstructions are kept"
    )
    parser.add_argument("--report-only", action="store_true", help="measure nothing; write the report of the results in DIR")
    parser.add_argument("--write-docs", action="store_true", help="write docs/benchmark.md and the table in docs/skipping.md")
    return parser.parse_args(argv)


def _count(text: str) -> int:
    """Parse a number of repeats."""
    if int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be at least 1")
    return int(text)


def _minutes(text: str) -> tuple[float, ...]:
    """Parse time budgets."""
    minutes = tuple(float(part) for part in text.split(","))
    if not all(0 < m < 10_000 for m in minutes):
        raise argparse.ArgumentTypeError(f"{text}: minutes must be above 0 and below 10,000")
    return minutes


def sections_of(names: str) -> list[ModuleType]:
    """Return the modules of sections by name, in the order of SECTIONS.

    Args:
        names: names separated by commas.

    Raises:
        InputError: where a name is not one of SECTIONS.
    """
    requested = {name.strip() for name in names.split(",") if name.strip()}
    if unknown := requested - set(SECTIONS):
        raise InputError("--sections", f"unknown section {', '.join(sorted(unknown))}", f"use {', '.join(SECTIONS)}")
    return [importlib.import_module(f"benchmarks.{name}") for name in SECTIONS if name in requested]


def scenes_of(args: argparse.Namespace) -> list[Scene]:
    """Return the scenes that the options name; without any, the embedded or two rendered ones."""
    if args.scenes:
        return scenes.find_scenes(args.scenes)
    return (
        scenes.demo_scenes()
        if args.quick
        else scenes.rendered_scenes(args.out / "scenes", lambda text: print(text, file=sys.stderr, flush=True))
    )


def measure(args: argparse.Namespace, sections: list[ModuleType]) -> tuple[Store, int]:
    """Make all measurements that are missing.

    Args:
        args: parsed options.
        sections: modules of the chosen sections.

    Returns:
        The store, and the exit status: 0, 1 where a measurement failed, 130 after Ctrl-C or SIGTERM.
    """
    # By default SIGTERM would leave the running reconstruction behind, whose folder the next benchmark would find locked.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    args.out.mkdir(parents=True, exist_ok=True)
    store = Store(args.out, machine(), args.fresh)
    repeats, budgets = (2, (0.25,)) if args.quick else (5, (1, 2, 4))
    bench = Bench(args.out, scenes_of(args), args.quick, args.repeats or repeats, args.budgets or budgets, args.lpips)
    store.scenes |= {scene.name: {"glossy": scene.glossy, "size": scene.views[0].camera.width} for scene in bench.scenes}
    session = Session(bench, store)
    try:
        failures = session.work(steps_of(bench, sections))
    except KeyboardInterrupt:
        session.say(f"stopped; all measurements so far are in {store.path}, the same command continues")
        return store, 130
    return store, 1 if failures else 0


def main(argv: list[str] | None = None) -> int:
    """Run the benchmark and return the exit status."""
    args = arguments(argv)
    try:
        sections = sections_of(args.sections)
        store, status = (Store(args.out), 0) if args.report_only else measure(args, sections)
        if not store.records and status:
            return status
        if not store.records:
            raise InputError(store.path, "holds no results", "run without --report-only")
        everything = sections_of(",".join(SECTIONS))
        from benchmarks import documents, page  # imported late: no measurement waits for matplotlib

        store.write_tables()
        print(page.write(store, everything))
        if args.write_docs:
            documents.write(store, everything, DOCS)
    except IrgsppError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return error.exit_status
    return status


if __name__ == "__main__":
    sys.exit(main())
