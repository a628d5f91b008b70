# SPDX-License-Identifier: GPL-3.0-or-later
"""Time against error: relighting, reconstruction, geometry, materials, peers, kernels, and what skipping work saves.

python scripts/benchmark.py [SCENES...] [-o DIR] [--quick]

SCENES are folders with photographs and ground truth as scripts/render_dataset.py writes them, or folders of such; without any, two small
ones are rendered by Cycles. DIR gets results.json, a CSV for each section, report.html, the reconstructions and their images. Run it
again to go on after an interruption, or to measure what failed once more. Nothing else should run meanwhile.
"""

from __future__ import annotations

import argparse
import importlib
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "scenes", nargs="*", type=Path, metavar="SCENES", help="folders of scenes with ground truth (default: small ones of our own)"
    )
    parser.add_argument(
        "-o", dest="out", type=Path, default=Path("benchmark"), metavar="DIR", help="folder of results (default: benchmark)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="the embedded 64x64 scene and short schedules: whether all of it works, in minutes"
    )
    parser.add_argument("--sections", default=",".join(SECTIONS), metavar="A,B", help=f"some of {', '.join(SECTIONS)} (default: all)")
    parser.add_argument("--repeats", type=_count, metavar="N", help="of timings, whose median counts (default: 5)")
    parser.add_argument("--budgets", type=_minutes, metavar="M,M", help="minutes for reconstructing (default: 1,2,4)")
    parser.add_argument(
        "--lpips", type=Path, metavar="FILE", help="the metric LPIPS as TorchScript, where the package lpips is not installed"
    )
    parser.add_argument("--fresh", action="store_true", help="measure anew what DIR has results of; reconstructions are kept")
    parser.add_argument("--report-only", action="store_true", help="measure nothing; write the report of what is there")
    parser.add_argument("--write-docs", action="store_true", help="write docs/benchmark.md and the table in docs/skipping.md")
    return parser.parse_args(argv)


def _count(text: str) -> int:
    if int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: at least 1")
    return int(text)


def _minutes(text: str) -> tuple[float, ...]:
    minutes = tuple(float(part) for part in text.split(","))
    if not all(0 < m < 10_000 for m in minutes):
        raise argparse.ArgumentTypeError(f"{text}: not minutes")
    return minutes


def chosen(names: str) -> list[ModuleType]:
    """Modules of sections by name, in their order. Raises InputError for an unknown one."""
    wanted = {name.strip() for name in names.split(",") if name.strip()}
    if unknown := wanted - set(SECTIONS):
        raise InputError("--sections", f"there is no {', '.join(sorted(unknown))}", f"use {', '.join(SECTIONS)}")
    return [importlib.import_module(f"benchmarks.{name}") for name in SECTIONS if name in wanted]


def scenes_of(args: argparse.Namespace) -> list[Scene]:
    """What is measured."""
    if args.scenes:
        return scenes.named(args.scenes)
    return scenes.embedded() if args.quick else scenes.own(args.out / "scenes", lambda text: print(text, file=sys.stderr, flush=True))


def measure(args: argparse.Namespace, sections: list[ModuleType]) -> tuple[Store, int]:
    """All that is missing; the store, and an exit status."""
    args.out.mkdir(parents=True, exist_ok=True)
    store = Store(args.out, machine(), args.fresh)
    repeats, budgets = (2, (0.25,)) if args.quick else (5, (1, 2, 4))
    bench = Bench(args.out, scenes_of(args), args.quick, args.repeats or repeats, args.budgets or budgets, args.lpips)
    store.scenes |= {scene.name: {"glossy": scene.glossy, "size": scene.views[0].camera.width} for scene in bench.scenes}
    session = Session(bench, store)
    try:
        failures = session.work(steps_of(bench, sections))
    except KeyboardInterrupt:
        session.say(f"stopped; all that was measured is in {store.path}, the same command goes on")
        return store, 130
    return store, 1 if failures else 0


def main(argv: list[str] | None = None) -> int:
    args = arguments(argv)
    try:
        sections = chosen(args.sections)
        store, status = (Store(args.out), 0) if args.report_only else measure(args, sections)
        if not store.records and status:
            return status
        if not store.records:
            raise InputError(store.path, "holds no results", "run without --report-only")
        everything = chosen(",".join(SECTIONS))
        from benchmarks import documents, page  # matplotlib: no measurement waits for it

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
