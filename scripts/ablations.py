# SPDX-License-Identifier: GPL-3.0-or-later
"""Print the paper's ablation tables for any dataset with ground truth.

    python scripts/ablations.py DATASET RUN [-o OUT] [--views 4]     # variants of relighting a finished run
    python scripts/ablations.py DATASET RUN --training               # and of training: a new job each, with the run's settings

OUT gets ablations.md, ablations.json and ablations.html. The same command continues after an interruption; what is done is kept.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from ablation import published
from ablation.relighting import Report, evaluated
from ablation.variants import FULL, TRAININGS, Training, Variant, relighting_tables
from irgspp.core.batch.batch import batch_folder, run_batch
from irgspp.core.batch.jobs import Job
from irgspp.core.errors import InputError
from irgspp.core.evaluation.protocols import PROTOCOLS
from irgspp.core.progress.terminal import Terminal
from irgspp.core.relight.sample_counts import HQ, is_mostly_metallic
from irgspp.core.run_folder import read_run, write_atomic
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.overrides import from_dict, overrides_from
from irgspp.core.settings.schema import preset
from reproduction.command import run_command
from reproduction.scenes import discard_stale_report
from reproduction.tables import Row, Table, as_html, as_json, as_markdown

COLUMNS = {
    "relight_psnr": "relit, full frame, dB ↑",
    "relight_psnr_object": "object pixels ↑",
    "relight_psnr_scaled": "scaled, full frame ↑",
    "relight_ssim": "SSIM ↑",
    "nvs_psnr": "NVS, shaded, dB ↑",
    "nvs_psnr_object": "object pixels ↑",
    "albedo_psnr": "albedo dB ↑",
    "frames_per_second": "FPS ↑",
}
SIGNS = ("nvs_psnr", "albedo_psnr", "relight_psnr")
HEADS = ("variant", "samples", "relit, to the first row")


def arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; `argv` is that of the process where None."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="dataset with relit ground truth")
    parser.add_argument("run", type=Path, metavar="RUN", help="its finished run")
    parser.add_argument("-o", dest="out", type=Path, default=Path("ablations"), metavar="OUT", help="default: ablations")
    parser.add_argument("--views", type=int, metavar="N", help="number of test views, evenly spread (default: all)")
    parser.add_argument("--protocol", choices=list(PROTOCOLS), default="plain", help="default: plain")
    parser.add_argument("--counts", metavar="A,B", default="16,64,256,1024", help="samples of MIS against strata; default: 16,64,256,1024")
    parser.add_argument("--training", action="store_true", help="train without 2DGRT, too")
    return parser.parse_args(argv)


def table(title: str, rows: list[tuple[str, str, Report]], notes: Sequence[str] = ()) -> Table:
    """Return a table with the paper's rows after ours; the third column is the difference of relit PSNR to the full method.

    Args:
        title: title of the table.
        rows: label, samples and report of each row.
        notes: notes on how to read it.
    """
    first = rows[0][2]["figures"].get("relight_psnr")
    lines = []
    for label, samples, report in rows:
        relit = report["figures"].get("relight_psnr")
        difference = "" if first is None or relit is None or report is rows[0][2] else f"{relit - first:+.2f} dB"
        lines.append(Row(label, samples, difference, {key: report["figures"][key] for key in COLUMNS if key in report["figures"]}))
    theirs = published.ROWS.get(title, [])
    for one in theirs:
        difference = "" if one.psnr == one.full else f"{one.psnr - one.full:+.2f} dB"
        lines.append(Row(f"{one.label} (paper, {one.of})", str(one.samples), difference, {"relight_psnr_scaled": one.psnr}))
    keys = {key for line in lines for key in line.figures}
    columns = {key: text for key, text in COLUMNS.items() if key in keys}
    return Table(title, columns, lines, [*notes, *([published.NOTE] if theirs else [])], HEADS)


def training_job(training: Training, args: argparse.Namespace, out: Path) -> Job:
    """Return the job that trains and evaluates a variant, the second time as it was trained.

    Args:
        training: variant.
        args: parsed options.
        out: folder of runs and reports.
    """
    settings = from_dict(read_run(args.run)["settings"], args.run / "run.json")
    overrides = [*overrides_from(preset(settings.preset), settings), *training.changes]
    run, dataset = out / "runs" / training.name, str(args.dataset.resolve())
    train = ("reconstruct", dataset, "-o", str(run), "--preset", settings.preset, *(w for text in overrides for w in ("--set", text)))
    compare = ("evaluate", str(run), dataset, "--protocol", args.protocol, "--samples", str(HQ))
    compare = (*compare, "--views", str(args.views)) if args.views else compare
    folders = [out / "reports" / training.name, out / "reports" / f"{training.name}-as-trained"]
    steps = [(*compare, "-o", str(folders[0])), (*compare, "-o", str(folders[1]), *training.as_trained)]
    return Job(training.name, run, (train, *steps), out)


def training_table(full: Report, args: argparse.Namespace, out: Path, terminal: Terminal) -> Table:
    """Train every variant and return their table.

    Args:
        full: report of the run itself.
        args: parsed options.
        out: folder of runs and reports.
        terminal: terminal with Ctrl-C.

    Raises:
        InputError: where a job failed.
    """
    jobs = [training_job(training, args, out) for training in TRAININGS]
    for job in jobs:
        discard_stale_report(job)
    states = run_batch(jobs, batch_folder(out / "training"), lambda: terminal.cancelled)
    rows, notes = [(FULL, str(HQ), full)], []
    for training, job in zip(TRAININGS, jobs, strict=True):
        if states[job.name].state != "done":
            raise InputError(training.label, states[job.name].error or states[job.name].state)
        found, own = (
            json.loads((out / "reports" / name / "report.json").read_text(encoding="utf-8"))
            for name in (training.name, f"{training.name}-as-trained")
        )
        found["figures"] |= {key: value for key, value in own["figures"].items() if key.startswith("nvs_")}
        rows.append((training.label, str(HQ), found))
        gains = (f"{key.split('_')[0]} {full['figures'][key] - found['figures'][key]:+.2f} dB" for key in SIGNS if key in full["figures"])
        notes.append(f"Full minus {training.label}: {', '.join(gains)}.")
    notes.append("Relit views: rendered with indirect light and visibility in all rows. NVS: each shaded as it was trained.")
    return table("2DGRT in training", rows, notes)


def ablate(args: argparse.Namespace, terminal: Terminal) -> int:
    """Evaluate all variants, write the tables, and return the exit status.

    Raises:
        InputError: where the run or the dataset is wrong, or a job failed.
    """
    out = args.out.resolve()
    try:
        counts = [int(text) for text in args.counts.split(",")]
    except ValueError as error:
        raise InputError("--counts", f"{args.counts} is not a list of numbers", "write such as 16,64") from error
    if read_run(args.run)["status"] != "done":
        raise InputError(args.run, "is not a finished run", f"irgspp reconstruct {args.dataset} -o {args.run} --resume")
    of: Callable[[Variant], Report] = lambda one: evaluated(  # noqa: E731
        one, args.run, args.dataset, out / "variants", terminal, args.protocol, args.views
    )
    full = of(Variant(FULL, HQ))
    if "relight_psnr" not in full["figures"]:
        raise InputError(args.dataset, "has no relit ground truth with its light maps, which ablations are measured by")
    variants = relighting_tables(is_mostly_metallic(Reconstruction.load(args.run)), counts)
    tables = [table(title, [(one.label, str(one.samples), of(one)) for one in rows]) for title, rows in variants.items()]
    if args.training:
        tables.append(training_table(full, args, out, terminal))
    terminal.end_line()
    tables[0].notes.extend(line for line in full["protocol"] if not line.startswith("Shaded and relit images"))
    text = as_markdown(tables)
    for suffix, content in (("md", text), ("json", json.dumps(as_json(tables), indent=1)), ("html", as_html(tables, []))):
        write_atomic(out / f"ablations.{suffix}", content.encode())
    print(text)
    print(out / "ablations.html")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables and return the exit status."""
    args = arguments(argv)
    return run_command("ablations", lambda terminal: ablate(args, terminal))


if __name__ == "__main__":
    sys.exit(main())
