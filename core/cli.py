# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: `irgspp demo|inspect|reconstruct|render|evaluate|batch|export|bake|devices`."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import io
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path

from . import render_command, serve_command
from .config import PRESETS, Settings, preset
from .errors import Cancelled, InputError, IrgsppError
from .evaluation.protocols import PROTOCOLS
from .journal import JobJournal, JobNotes
from .overrides import from_dict, with_overrides
from .run_folder import read_run
from .shortage import shortage
from .terminal import Terminal

JOB_FOLDER = "IRGSPP_JOB"  # variable of the environment

# Heavy imports (torch, numba) stand inside the commands: `irgspp --help` answers at once.


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit status: 0 done, 1 failed, 2 bad usage or bad input, 130 cancelled."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        args = parser().parse_args(words)
    except SystemExit as end:
        return int(end.code or 0)
    with Terminal().signals() as terminal:
        return _run(args, words, watched(terminal))


def watched(terminal: Terminal) -> Terminal | JobJournal:
    """Progress as the program that started this process wants it: in the folder $IRGSPP_JOB as well, where it names one."""
    folder = os.environ.pop(JOB_FOLDER, "")
    return JobJournal(JobNotes(Path(folder)), terminal) if folder else terminal


def _run(args: argparse.Namespace, words: list[str], terminal: Terminal | JobJournal) -> int:
    try:
        return args.command(args, terminal)
    except Cancelled as error:
        _complain(terminal, f"cancelled: {error}")
        if args.resumable:
            _complain(terminal, f"go on with: {resume_line(words)}")
        return error.exit_status
    except IrgsppError as error:
        _complain(terminal, str(error))
        return error.exit_status
    except Exception as error:  # a fault of ours or of the machine: one line here, the rest where it can be read later
        short, log = shortage(error, getattr(args, "run", Path())), _keep_traceback(args)
        line = str(short) if short else f"failed: {type(error).__name__}: {' '.join(str(error).split())}"
        _complain(terminal, line + (f" (more in {log})" if log else ""))
        return 1


def _complain(terminal: Terminal | JobJournal, line: str) -> None:
    terminal.end_line()
    print(f"irgspp: {line}", file=sys.stderr, flush=True)


def _keep_traceback(args: argparse.Namespace) -> Path | None:
    """Append the traceback to the run's log.txt, or to a new temporary file where the command has no run folder; None on a full disk."""
    run = getattr(args, "run", None)
    try:
        if run is not None and (run / "log.txt").exists():
            log = run / "log.txt"
        else:
            handle, name = tempfile.mkstemp(prefix="irgspp-", suffix=".log")
            os.close(handle)
            log = Path(name)
        with log.open("a", encoding="utf-8") as file:
            traceback.print_exc(file=file)
    except OSError:
        return None
    return log


def resume_line(words: Sequence[str]) -> str:
    """The command line that goes on with a stopped `reconstruct` or `demo`."""
    kept = [word for word in words if word not in ("--resume", "--overwrite")]
    join = subprocess.list2cmdline if sys.platform == "win32" else shlex.join
    return join(["irgspp", *kept, "--resume"])


# --- the commands


def demo(args: argparse.Namespace, terminal: Terminal) -> int:
    """Reconstruct the embedded dataset; an earlier demonstration in the folder is replaced."""
    from .pipeline import DEMO_DATA, DEMO_OVERRIDES, reconstruct

    replace = not args.resume and (args.run / "run.json").exists() and read_run(args.run).get("dataset") == str(DEMO_DATA)
    settings = with_overrides(preset("balanced"), [*DEMO_OVERRIDES, *args.set])
    run = reconstruct(DEMO_DATA, args.run, settings, resume=args.resume, overwrite=replace, progress=terminal)
    terminal.end_line()
    print(run / "contact_sheet.png")
    return 0


def inspect(args: argparse.Namespace, terminal: Terminal) -> int:
    """Print what was understood of a dataset."""
    from .datasets.inspect import describe, facts
    from .datasets.load import load_dataset

    settings = with_overrides(Settings(), args.set).data
    data = load_dataset(args.dataset, settings, terminal)
    if args.export is not None:
        from .scene.dataset_files import save_dataset

        save_dataset(data, settings, args.export, terminal)
    terminal.end_line()
    print(json.dumps(facts(data)) if args.json else describe(data))
    return 0


def reconstruct(args: argparse.Namespace, terminal: Terminal) -> int:
    """Photographs to a run folder."""
    settings = settings_of(args)
    from .pipeline import reconstruct  # takes seconds: what is wrong in the settings is told before

    run = reconstruct(args.dataset, args.run, settings, resume=args.resume, overwrite=args.overwrite, progress=terminal)
    terminal.end_line()
    print(run)
    return 0


def settings_of(args: argparse.Namespace) -> Settings:
    """The settings that the options say; those of the run itself for a bare `--resume`."""
    chosen = {name: getattr(args, name) for name in ("materials", "device", "seed", "time") if getattr(args, name) is not None}
    if args.resume and not chosen and not args.set and args.preset is None and (args.run / "run.json").exists():
        return from_dict(read_run(args.run)["settings"], args.run / "run.json")
    return with_overrides(dataclasses.replace(preset(args.preset or "balanced"), **chosen), args.set)


def evaluate(args: argparse.Namespace, terminal: Terminal) -> int:
    """Compare a run with a dataset's test views: a table here, a page and JSON in the report folder."""
    from .evaluation.report import evaluate, table

    settings = from_dict(read_run(args.run)["settings"], args.run / "run.json")
    choices = {"protocol": args.protocol, "views": args.views, "samples": args.samples, "lpips": args.lpips}
    report = evaluate(args.run, args.dataset, args.out, settings.data, terminal, args.cycles, **choices)
    terminal.end_line()
    print(table(report))
    return 0


def batch(args: argparse.Namespace, terminal: Terminal) -> int:
    """Many jobs from a list; a line for each on stdout."""
    from .batch.batch import notes_of, run_batch
    from .batch.jobs import read_jobs

    jobs = read_jobs(args.jobs, check_words)
    states = run_batch(jobs, notes_of(args.jobs), lambda: terminal.cancelled, args.at_once, args.dask)
    for job in jobs:
        state = states[job.name]
        more = f": {state.error} (more in {notes_of(args.jobs) / job.name / 'log.txt'})" if state.state == "failed" else ""
        print(f"{job.name}: {state.state}{more}")
    return int(any(state.state == "failed" for state in states.values()))


def check_words(words: Sequence[str]) -> None:
    """Raise InputError where these words after `irgspp` are no command, in one line; nothing is done."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            args = parser().parse_args(list(words))
    except SystemExit:
        lines = said.getvalue().strip().splitlines()
        raise InputError(words[0], lines[-1].partition("error: ")[2] if lines else "is not understood") from None
    if args.command is reconstruct:
        with_overrides(preset(args.preset or "balanced"), args.set)


def export(args: argparse.Namespace, terminal: Terminal) -> int:
    """Copy or write what a run made, by the file's suffix."""
    from .export import export

    settings = from_dict(read_run(args.run)["settings"], args.run / "run.json")
    export(args.run, args.out, args.material or settings.export.material, terminal)
    print(args.out)
    return 0


def bake(args: argparse.Namespace, terminal: Terminal | JobJournal) -> int:
    """Mesh and textures of a finished run once more."""
    from .baking import bake

    bake(args.run, terminal, size=args.size, triangles=args.triangles, edited=args.mesh)
    terminal.end_line()
    print(args.run)
    return 0


def devices(args: argparse.Namespace, terminal: Terminal) -> int:
    """Print what can be used to compute on."""
    from .devices import describe
    from .devices import devices as found

    print(json.dumps(found(), indent=2) if args.json else describe(found()))
    return 0


# --- their options


def parser() -> argparse.ArgumentParser:
    """The options of every command."""
    top = argparse.ArgumentParser("irgspp", description="Inverse rendering for Blender: photographs in, a relightable object out.")
    commands = top.add_subparsers(required=True, metavar="COMMAND")

    one = _command(commands, "demo", demo, "reconstruct a small embedded dataset", resumable=True)
    one.add_argument("-o", dest="run", metavar="DIR", type=Path, default=Path("demo"), help="run folder (default: demo)")
    _resume_options(one)

    one = _command(commands, "inspect", inspect, "print what is understood of a dataset")
    one.add_argument("dataset", metavar="DATASET", type=Path, help="folder or file of posed photographs")
    one.add_argument("--json", action="store_true", help="for programs: one JSON object")
    one.add_argument("--export", metavar="FOLDER", type=Path, help="write cameras, points and undistorted photographs for other programs")
    _set_option(one)

    one = _command(commands, "reconstruct", reconstruct, "photographs to mesh, materials, light and a Blender file", resumable=True)
    one.add_argument("dataset", metavar="DATASET", type=Path, help="folder or file of posed photographs")
    one.add_argument("-o", dest="run", metavar="RUN", type=Path, required=True, help="run folder")
    one.add_argument("--preset", choices=list(PRESETS), help="default: balanced")
    one.add_argument("--materials", choices=("auto", "low-gloss", "glossy"), help="what the object is made of")
    one.add_argument("--device", choices=("auto", "cpu", "cuda"))
    one.add_argument("--seed", type=int, metavar="N", help="of every random choice (default: 0)")
    budget = "seconds, minutes or hours the job may take: 90s, 5m, 1h; roughly: schedules become as long or short as that allows"
    one.add_argument("--time", type=_seconds, metavar="5m", help=budget)
    _resume_options(one)
    one.add_argument("--overwrite", action="store_true", help="replace the run in the folder")

    one = _command(commands, "render", render_command.render, "views of a run as pictures and layers")
    _run_argument(one)
    render_command.add_options(one)

    one = _command(commands, "serve", serve_command.serve, "keep a run warm and answer requests for pictures through files")
    _run_argument(one)
    serve_command.add_options(one)

    one = _command(commands, "evaluate", evaluate, "compare a run with a dataset: every figure its truth allows")
    _run_argument(one)
    one.add_argument("dataset", metavar="DATASET", type=Path, help="folder or file of posed photographs")
    one.add_argument("-o", dest="out", metavar="REPORT", type=Path, help="folder for report.html and report.json (default: RUN/evaluation)")
    cycles = "render N of the views by Cycles too, from the exported object, and set them beside ours"
    one.add_argument("--cycles", type=_count, default=0, metavar="N", help=cycles)
    whose = "whose choices of scale, background, masks and colour space: as that paper's own code has them (default: plain)"
    one.add_argument("--protocol", choices=list(PROTOCOLS), default="plain", help=whose)
    one.add_argument("--views", type=_positive, metavar="N", help="so many of the views, evenly spread (default: all)")
    one.add_argument("--samples", type=_positive, metavar="N", help="light samples per pixel (default: 64, of the papers' protocols 512)")
    one.add_argument("--lpips", metavar="FILE", type=Path, help="the metric LPIPS as TorchScript, where the package lpips is not installed")

    one = _command(commands, "export", export, "the asset, Blender scene, Gaussians or light of a run as one file")
    _run_argument(one)
    one.add_argument("-o", dest="out", metavar="FILE", type=Path, required=True, help="ends with .glb, .blend, .ply or .exr")
    one.add_argument("--material", choices=("textures", "attributes"), help="what the material in a .blend reads")

    one = _command(commands, "bake", bake, "textures of a finished run at another size, with other triangles, or on an edited mesh")
    _run_argument(one)
    one.add_argument("--size", type=int, metavar="N", help="texels along a side (default: as before)")
    one.add_argument("--triangles", type=int, metavar="N", help="make a new mesh of at most so many")
    one.add_argument("--mesh", metavar="FILE", type=Path, help="a PLY in the run's frame that takes the mesh's place; its UVs are kept")

    one = _command(commands, "batch", batch, "many jobs from a list, several at a time or on many machines")
    one.add_argument("jobs", metavar="JOBS.toml", type=Path, help="[defaults] and [[job]] tables, see docs/batch.md")
    one.add_argument("-j", dest="at_once", type=_positive, default=1, metavar="N", help="jobs at a time on this machine (default: 1)")
    one.add_argument("--dask", metavar="ADDRESS", help="on the workers of this scheduler (tcp://HOST:PORT), which see the same folders")

    one = _command(commands, "devices", devices, "print what can be used to compute on")
    one.add_argument("--json", action="store_true")
    return top


def _command(commands, name: str, function, text: str, resumable: bool = False) -> argparse.ArgumentParser:
    one = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
    one.set_defaults(command=function, resumable=resumable)
    return one


def _run_argument(one: argparse.ArgumentParser) -> None:
    one.add_argument("run", metavar="RUN", type=Path, help="run folder")


def _set_option(one: argparse.ArgumentParser) -> None:
    one.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change one setting; run.json lists all (repeatable)")


def _positive(text: str) -> int:
    if int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: at least 1")
    return int(text)


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is no number of views")
    return value


def _seconds(text: str) -> float:
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([smh]?)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text} is no time, such as 90s, 5m or 1h")
    return float(match[1]) * {"": 1, "s": 1, "m": 60, "h": 3600}[match[2]]


def _resume_options(one: argparse.ArgumentParser) -> None:
    one.add_argument("--resume", action="store_true", help="go on with the run in the folder")
    _set_option(one)
