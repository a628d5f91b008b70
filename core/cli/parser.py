# SPDX-License-Identifier: GPL-3.0-or-later
"""The options of every command."""

from __future__ import annotations

import argparse
import contextlib
import io
import re
from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError
from ..evaluation.protocols import PROTOCOLS
from ..settings.overrides import with_overrides
from ..settings.schema import PRESETS, preset
from . import commands
from . import render as render_command
from . import serve as serve_command


def parser() -> argparse.ArgumentParser:
    """Reads the words after `irgspp`."""
    top = argparse.ArgumentParser("irgspp", description="Inverse rendering for Blender: photographs in, a relightable object out.")
    several = top.add_subparsers(required=True, metavar="COMMAND")

    one = _command(several, "demo", commands.demo, "reconstruct a small embedded dataset", resumable=True)
    one.add_argument("-o", dest="run", metavar="DIR", type=Path, default=Path("demo"), help="run folder (default: demo)")
    _resume_options(one)

    one = _command(several, "inspect", commands.inspect, "print what is understood of a dataset")
    one.add_argument("dataset", metavar="DATASET", type=Path, help="folder or file of posed photographs")
    one.add_argument("--json", action="store_true", help="for programs: one JSON object")
    one.add_argument("--export", metavar="FOLDER", type=Path, help="write cameras, points and undistorted photographs for other programs")
    _set_option(one)

    one = _command(several, "reconstruct", commands.reconstruct, "photographs to mesh, materials, light and a Blender file", resumable=True)
    one.add_argument("dataset", metavar="DATASET", type=Path, help="folder or file of posed photographs")
    one.add_argument("-o", dest="run", metavar="RUN", type=Path, required=True, help="run folder")
    one.add_argument("--preset", choices=list(PRESETS), help="default: balanced")
    one.add_argument("--materials", choices=("auto", "low-gloss", "glossy"), help="what the object is made of")
    one.add_argument("--device", choices=("auto", "cpu", "cuda"))
    one.add_argument("--seed", type=int, metavar="N", help="of every random choice (default: 0)")
    budget = "seconds, minutes or hours the job may take: 90s, 5m, 1h; roughly: schedules are as short as that asks, or as long as helps"
    one.add_argument("--time", type=_seconds, metavar="5m", help=budget)
    _resume_options(one)
    one.add_argument("--overwrite", action="store_true", help="replace the run in the folder")

    one = _command(several, "render", render_command.render, "views of a run as images and layers")
    _run_argument(one)
    render_command.add_options(one)

    one = _command(several, "serve", serve_command.serve, "keep a run warm and answer requests for images through files")
    _run_argument(one)
    serve_command.add_options(one)

    one = _command(several, "evaluate", commands.evaluate, "compare a run with a dataset: every figure its truth allows")
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

    one = _command(several, "export", commands.export, "the asset, Blender scene, Gaussians or light of a run as one file")
    _run_argument(one)
    one.add_argument("-o", dest="out", metavar="FILE", type=Path, required=True, help="ends with .glb, .blend, .ply or .exr")
    one.add_argument("--material", choices=("textures", "attributes"), help="what the material in a .blend reads")

    one = _command(several, "bake", commands.bake, "textures of a finished run at another size, with other triangles, or on an edited mesh")
    _run_argument(one)
    one.add_argument("--size", type=int, metavar="N", help="texels along a side (default: as before)")
    one.add_argument("--triangles", type=int, metavar="N", help="make a new mesh of at most so many")
    one.add_argument("--mesh", metavar="FILE", type=Path, help="a PLY in the run's frame that takes the mesh's place; its UVs are kept")

    one = _command(several, "batch", commands.batch, "many jobs from a list, several at a time or on many machines")
    one.set_defaults(check=check_words)  # given along: commands.py must not import this module
    one.add_argument("jobs", metavar="JOBS.toml", type=Path, help="[defaults] and [[job]] tables, see docs/batch.md")
    one.add_argument("-j", dest="at_once", type=_positive, default=1, metavar="N", help="jobs at a time on this machine (default: 1)")
    one.add_argument("--dask", metavar="ADDRESS", help="on the workers of this scheduler (tcp://HOST:PORT), which see the same folders")

    one = _command(several, "devices", commands.devices, "print what can be used to compute on")
    one.add_argument("--json", action="store_true")
    return top


def _command(several, name: str, function, text: str, resumable: bool = False) -> argparse.ArgumentParser:
    one = several.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
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


def check_words(words: Sequence[str]) -> None:
    """Raise InputError where these words after `irgspp` are no command, in one line; nothing is done."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            args = parser().parse_args(list(words))
    except SystemExit:
        lines = said.getvalue().strip().splitlines()
        raise InputError(words[0], lines[-1].partition("error: ")[2] if lines else "is not understood") from None
    if args.command is commands.reconstruct:
        with_overrides(preset(args.preset or "balanced"), args.set)
