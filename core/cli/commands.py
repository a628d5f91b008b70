# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands of the command line: each takes its options and a progress receiver, prints its result and returns an exit status."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

from ..errors import InputError
from ..machine.quick_imports import quick_imports
from ..progress.recorder import JobRecorder
from ..progress.terminal import Terminal
from ..run_folder import SPHERE, read_run
from ..settings.overrides import from_dict, with_overrides
from ..settings.schema import Settings, preset
from .option_values import distance
from .renderer_options import relight_settings

HAS_CAMERAS = "leave it out; a capture is changed by irgspp capture"

# torch and numba are imported inside the commands, so that `irgspp --help` answers at once.


def demo(args: argparse.Namespace, terminal: Terminal) -> int:
    """Reconstruct the demo dataset; an earlier demo in the folder is replaced.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    with quick_imports():
        from ..pipeline import DEMO_DATA, DEMO_OVERRIDES, reconstruct

    replace = not args.resume and (args.run / "run.json").exists() and read_run(args.run).get("dataset") == str(DEMO_DATA)
    settings = with_overrides(preset(args.preset), [*DEMO_OVERRIDES, *args.set])
    run = reconstruct(DEMO_DATA, args.run, settings, resume=args.resume, overwrite=replace, progress=terminal)
    terminal.end_line()
    print(run / "contact_sheet.png")
    return 0


def inspect(args: argparse.Namespace, terminal: Terminal) -> int:
    """Print a summary of a dataset as irgspp reads it.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    with quick_imports():
        from ..capture.source import needs_capture, posed_dataset
        from ..datasets.load import load_dataset
        from ..datasets.summary import describe, summary

    if args.export is None and needs_capture(args.dataset):
        return inspect_photographs(args)
    settings = with_overrides(Settings(), args.set).data
    data = load_dataset(posed_dataset(args.dataset), settings, terminal)
    if args.export is not None:
        with quick_imports():
            from ..datasets.export import save_dataset

        save_dataset(data, settings, args.export, terminal)
    terminal.end_line()
    print(json.dumps(summary(data)) if args.json else describe(data))
    return 0


def inspect_photographs(args: argparse.Namespace) -> int:
    """Print what is known about photographs without cameras, with the time that finding them takes; arguments as of `inspect`."""
    with quick_imports():
        from ..capture.expected_work import describe_photographs, summarize_photographs

    found = summarize_photographs(args.dataset, with_overrides(Settings(), args.set))
    print(json.dumps(found) if args.json else describe_photographs(found))
    return 0


def capture(args: argparse.Namespace, terminal: Terminal) -> int:
    """Find cameras, masks and exposures of bare photographs and write them as a dataset.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    with quick_imports():
        from ..capture.recapture import captured_inputs
        from ..capture.true_size import with_true_size

    earlier = captured_inputs(args.photographs)
    folder = _capture_folder(args, earlier is not None)
    source, before, seed = earlier or (args.photographs, Settings().capture, 0)
    if args.distance is not None:
        before = with_true_size(before, folder, *distance(args.distance))
    settings = with_overrides(dataclasses.replace(Settings(), capture=before), [*capture_overrides(args), *args.set]).capture
    with quick_imports():
        from ..capture.capture import capture

    capture(source, folder, settings, seed if args.seed is None else args.seed, terminal)
    terminal.end_line()
    print(folder)
    return 0


def _capture_folder(args: argparse.Namespace, earlier: bool) -> Path:
    """Return the folder to write; raise InputError where none, or for a finished or stopped capture (`earlier`) another one, is named."""
    photographs: Path = args.photographs
    folder: Path | None = args.folder
    if earlier and folder is not None and folder.resolve() != photographs.resolve():
        raise InputError(photographs, "is a capture, which is changed in its place", "leave -o out, or name the photographs")
    if earlier:
        return photographs
    if folder is None:
        raise InputError("capture", "no folder to write is named", "add -o DATASET")
    return folder


def capture_overrides(args: argparse.Namespace) -> list[str]:
    """Return the options of captures as `key=value` texts."""
    chosen = [] if args.marker is None else [f"capture.marker={args.marker!r}"]
    chosen += [] if args.turntable is None else [f"capture.turntable={args.turntable}"]
    if args.sphere is not None:
        x, y, z, radius = args.sphere
        chosen += [f"capture.centre={x!r},{y!r},{z!r}", f"capture.radius={radius!r}"]
    return chosen


def reconstruct(args: argparse.Namespace, terminal: Terminal) -> int:
    """Reconstruct a dataset into a run folder.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    settings = settings_of(args)
    _check_bare(args)
    with quick_imports():
        from ..pipeline import reconstruct  # takes seconds: errors in the settings are reported before

    run = reconstruct(args.dataset, args.run, settings, resume=args.resume, overwrite=args.overwrite, progress=terminal)
    terminal.end_line()
    print(run)
    return 0


def _check_bare(args: argparse.Namespace) -> None:
    """Raise InputError where options of captures are given for a dataset that has its cameras."""
    given = [name for name in ("--marker", "--turntable", "--sphere") if getattr(args, name[2:]) is not None]
    if not given or not args.dataset.exists():
        return
    with quick_imports():
        from ..capture.source import needs_capture

    if not needs_capture(args.dataset):
        raise InputError(" ".join(given), "is for photographs without cameras, which this dataset has", HAS_CAMERAS)


def settings_of(args: argparse.Namespace) -> Settings:
    """Return the settings that the options give; for `--resume` without options, or with another sphere alone, those of the run itself."""
    chosen = {name: getattr(args, name) for name in ("materials", "device", "seed", "time") if getattr(args, name) is not None}
    texture = [] if args.texture is None else [f"surface.texture={args.texture}"]
    tiles = [] if args.udim is None else [f"surface.udim_tiles={args.udim}"]
    changes = [*texture, *tiles, *capture_overrides(args), *args.set]
    of_sphere = all(change.partition("=")[0].strip() in SPHERE for change in changes)
    if args.resume and not chosen and of_sphere and args.preset is None and (args.run / "run.json").exists():
        return with_overrides(from_dict(read_run(args.run)["settings"], args.run / "run.json"), changes)
    return with_overrides(dataclasses.replace(preset(args.preset or "balanced"), **chosen), changes)


def evaluate(args: argparse.Namespace, terminal: Terminal) -> int:
    """Compare a run with a dataset's test views, or check its asset: print a table, write the report; 1 where the asset has defects.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    if args.dataset is None and not args.asset:
        raise InputError("evaluate", "no dataset is named", "name the one to compare with, or give --asset to check the asset alone")
    if args.dataset is not None:
        _compare(args, terminal)
    return _check_asset(args) if args.asset else 0


def _compare(args: argparse.Namespace, terminal: Terminal) -> None:
    """Compare a run with a dataset's test views and print a table."""
    with quick_imports():
        from ..capture.source import posed_dataset
        from ..evaluation.report import evaluate, table

    settings = from_dict(read_run(args.run)["settings"], args.run / "run.json")
    choices = {"protocol": args.protocol, "views": args.views, "samples": args.samples, "lpips": args.lpips}
    choices |= {"relight": relight_settings(args), "backend": args.backend, "device": args.device}
    report = evaluate(args.run, posed_dataset(args.dataset, args.run), args.out, settings.data, terminal, args.cycles, **choices)
    terminal.end_line()
    print(table(report))


def _check_asset(args: argparse.Namespace) -> int:
    """Check the asset of a run, print a line for each check, and return the exit status: 1 where it has defects."""
    with quick_imports():
        from ..evaluation.asset_check import asset_lines, check_asset

    report = check_asset(args.run, args.out)
    print(asset_lines(report))
    return int(report["defects"] > 0)


def batch(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the jobs of a list and print a line for each.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    with quick_imports():
        from ..batch.batch import batch_folder, run_batch
        from ..batch.jobs import read_jobs

    jobs = read_jobs(args.jobs, args.check)
    states = run_batch(jobs, batch_folder(args.jobs), lambda: terminal.cancelled, args.at_once, args.dask)
    for job in jobs:
        state = states[job.name]
        more = f": {state.error} (more in {batch_folder(args.jobs) / job.name / 'log.txt'})" if state.state == "failed" else ""
        print(f"{job.name}: {state.state}{more}")
    return int(any(state.state == "failed" for state in states.values()))


def export(args: argparse.Namespace, terminal: Terminal) -> int:
    """Write a result of a run as one file, by the file's suffix.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    with quick_imports():
        from ..assets.export import export
        from ..assets.options import AssetOptions

    settings = from_dict(read_run(args.run)["settings"], args.run / "run.json")
    transform = tuple(args.scale * value for value in args.transform)
    options = AssetOptions(args.lods, args.collision, args.textures, args.normal_map, transform, args.occlusion)
    export(args.run, args.out, args.material or settings.export.material, terminal, options)
    terminal.end_line()
    print(args.out)
    return 0


def bake(args: argparse.Namespace, terminal: Terminal | JobRecorder) -> int:
    """Bake mesh and textures of a finished run again.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    with quick_imports():
        from ..assets.rebake import bake

    mesh = {"triangles": args.triangles, "edited": args.mesh, "quads": args.quads}
    bake(args.run, terminal, size=args.size, bits=args.bits, udim=args.udim, height=args.height, **mesh)
    terminal.end_line()
    print(args.run)
    return 0


def compile_kernels(args: argparse.Namespace, terminal: Terminal) -> int:
    """Compile the CPU kernels that the first job would compile otherwise.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    with quick_imports():
        from ..kernel_cache import fill_kernel_cache

    compiled = fill_kernel_cache(terminal)
    terminal.end_line()
    print("the kernels are compiled" if compiled else "the kernels were compiled before")
    return 0


def devices(args: argparse.Namespace, terminal: Terminal) -> int:
    """Print the devices that can compute.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    with quick_imports():
        from ..machine.devices import describe
        from ..machine.devices import devices as find_devices

    print(json.dumps(find_devices(), indent=2) if args.json else describe(find_devices()))
    return 0
