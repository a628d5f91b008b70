# SPDX-License-Identifier: GPL-3.0-or-later
"""History of speed by commit: CPU time and wall clock of fixed works, as multiples of reference loops timed in the same run.

    .venv/bin/python scripts/speed_history.py             # measure, and compare with the last entry of docs/speed_history.json
    .venv/bin/python scripts/speed_history.py --record    # the same, and append this commit's entry to the file

Nothing else should run on the machine meanwhile. The wall clock is compared: CPU time also counts threads that wait for one another.

Exit status: 0 no work is slower than TOLERANCE allows, 1 one is, 2 bad usage or a damaged file. Not part of the tests: other load on the
machine would make them fail.
"""

from __future__ import annotations

import argparse
import datetime
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.speed_works import Work, references, works
from irgspp.core.errors import InputError
from irgspp.core.io.atomic import atomic_file

ROOT = Path(__file__).resolve().parent.parent
HISTORY = ROOT / "docs" / "speed_history.json"
TOLERANCE = 1.25  # times the last entry's wall clock from which a work counts as slower; equal commits differ by up to a fifth
LONG = 5.0  # seconds from which a work is measured once

Entry = dict[str, Any]


def main(argv: list[str] | None = None) -> int:
    """Measure, compare, record if asked for, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", action="store_true", help="append this commit's entry to the file")
    parser.add_argument("--file", type=Path, default=HISTORY, help="history to compare with (default: docs/speed_history.json)")
    parser.add_argument("--repeats", type=int, default=7, metavar="N", help="repeats, of which the median counts (default: 7)")
    args = parser.parse_args(argv)
    if args.repeats < 1:
        parser.error("--repeats must be at least 1")
    try:
        history = read(args.file)
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    entry = {"commit": commit(), "date": datetime.date.today().isoformat(), "works": ratios(args.repeats)}
    last = history[-1] if history else None
    print(table(entry, last))
    if args.record:
        with atomic_file(args.file) as path:
            path.write_text(json.dumps([*history, entry], indent=1) + "\n", encoding="utf-8")
    return 1 if last and slower(entry, last) else 0


def read(path: Path) -> list[Entry]:
    """Read a history, the oldest entry first; empty where there is no file.

    Raises:
        InputError: it is not one.
    """
    if not path.exists():
        return []
    try:
        history = json.loads(path.read_text(encoding="utf-8"))
        fits = all({"commit", "date", "works"} <= entry.keys() for entry in history)
    except (ValueError, AttributeError, TypeError):
        fits = False
    if not fits:
        raise InputError(str(path), "is no history of speed", "restore it from version control, or delete it to begin a new one")
    return history


def commit() -> str:
    """Return the short name of the current commit, with a + where files were changed since."""
    command = ["git", "-C", str(ROOT), "describe", "--always", "--exclude=*", "--dirty=+"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def ratios(repeats: int) -> dict[str, dict[str, float]]:
    """Time all works; return by name their CPU time and wall clock as multiples of the geometric mean of the reference loops."""
    ours, fixed = works(), references()
    seconds = _median_seconds(fixed | ours, repeats)
    unit = np.exp(np.mean([np.log(seconds[name]) for name in fixed], 0))
    return {name: dict(zip(("cpu", "wall"), np.round(seconds[name] / unit, 2).tolist(), strict=True)) for name in ours}


def _median_seconds(timed: dict[str, Work], repeats: int) -> dict[str, np.ndarray]:
    """Return the median CPU time and wall clock (2,) of each work; they alternate, after one call each that does not count.

    Works that take longer than LONG are called twice in all.
    """
    found: dict[str, list[np.ndarray]] = {name: [] for name in timed}
    for turn in range(repeats + 1):
        for name, work in timed.items():
            if turn > 1 and found[name][-1][1] > LONG:
                continue
            before = _clocks()
            work()
            found[name].append(_clocks() - before)
    return {name: np.median(values[1:], 0) for name, values in found.items()}


def _clocks() -> np.ndarray:
    """Return CPU time of all threads and wall clock in seconds."""
    return np.array([time.process_time(), time.perf_counter()])


def slower(entry: Entry, last: Entry) -> list[str]:
    """Return the names of works whose wall clock exceeds that of the last entry by more than TOLERANCE."""
    return [name for name, change in changes(entry, last).items() if change > TOLERANCE]


def changes(entry: Entry, last: Entry) -> dict[str, float]:
    """Return the wall clock of each work as a multiple of the last entry's; works that only one of them has are left out."""
    return {name: work["wall"] / last["works"][name]["wall"] for name, work in entry["works"].items() if name in last["works"]}


def table(entry: Entry, last: Entry | None) -> str:
    """Return the entry as a Markdown table, with the change of wall clock against the last one."""
    change = changes(entry, last) if last else {}
    head = f"commit {entry['commit']}" + (f", compared with {last['commit']} of {last['date']}" if last else ", the first entry")
    rows = [f"| {name} | {work['cpu']} | {work['wall']} | {_in_words(change.get(name))} |" for name, work in entry["works"].items()]
    return "\n".join([head, "", "| work | CPU time | wall clock | change of wall clock |", "| --- | ---: | ---: | ---: |", *rows])


def _in_words(change: float | None) -> str:
    """Return a change of wall clock as a percentage, marked where it is too slow."""
    if change is None:
        return "–"
    return f"{change - 1:+.0%}" + (" slower" if change > TOLERANCE else "")


if __name__ == "__main__":
    sys.exit(main())
