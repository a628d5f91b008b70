# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of every command."""

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
from .renderer_options import add_renderer_options

EXPORTED = "ends with .glb, .usd, .usdc, .usda, .usdz, .obj or .fbx (asset), .blend (scene), .ply (Gaussians) or .exr (light)"


def parser() -> argparse.ArgumentParser:
    """Return the parser of the words after `irgspp`."""
    top = argparse.ArgumentParser("irgspp", description="Inverse rendering for Blender: photographs in, a relightable object out.")
    subparsers = top.add_subparsers(required=True, metavar="COMMAND")

    one = _command(subparsers, "demo", commands.demo, "reconstruct the small dataset that comes with irgspp", resumable=True)
    one.add_argument("-o", dest="run", metavar="DIR", type=Path, default=Path("demo"), help="run folder (default: demo)")
    _resume_options(one)

    one = _command(subparsers, "inspect", commands.inspect, "print what irgspp reads in a dataset, and how long a job will take")
    one.add_argument("dataset", metavar="DATASET", type=Path, help="folder or file of photographs with known cameras")
    one.add_argument("--json", action="store_true", help="print one JSON object, for programs")
    one.add_argument("--export", metavar="FOLDER", type=Path, help="also write cameras, points and undistorted photographs to a folder")
    _set_option(one)

    one = _command(
        subparsers,
        "capture",
        commands.capture,
        "photographs without cameras, or a video, to a dataset: cameras, masks, exposures, true size",
        repeatable=True,
    )
    one.add_argument("photographs", metavar="PHOTOS", type=Path, help="folder of photographs and videos, or a video")
    one.add_argument("-o", dest="folder", metavar="DATASET", type=Path, required=True, help="folder to write")
    side = "side of the black square of an ArUco or AprilTag marker in the photographs, such as 5cm: the object gets its true size"
    one.add_argument("--marker", type=_length, metavar="SIZE", help=side)
    fixed = "the object turns before a fixed camera (default: auto, where a background with texture stays at its place)"
    one.add_argument("--turntable", choices=("auto", "on", "off"), help=fixed)
    one.add_argument("--seed", type=int, default=0, metavar="N", help="seed of every random number generator (default: 0)")
    _set_option(one)

    one = _command(
        subparsers, "reconstruct", commands.reconstruct, "photographs to mesh, materials, light and a Blender file", resumable=True
    )
    source = "folder of photographs, a video, or a dataset with known cameras"
    one.add_argument("dataset", metavar="DATASET", type=Path, help=source)
    one.add_argument("-o", dest="run", metavar="RUN", type=Path, required=True, help="run folder")
    one.add_argument("--preset", choices=list(PRESETS), help="amount of work: draft, balanced, high or paper (default: balanced)")
    one.add_argument(
        "--materials", choices=("auto", "low-gloss", "glossy"), help="material class of the object (default: auto, by trial fits)"
    )
    texture = "texture size, texels along a side: 1k, 2k, 4k, 8k or a number (default: by the preset)"
    one.add_argument("--texture", type=_texels, metavar="SIZE", help=texture)
    one.add_argument("--device", choices=("auto", "cpu", "cuda"), help="device to compute on (default: auto)")
    one.add_argument("--seed", type=int, metavar="N", help="seed of every random number generator (default: 0)")
    budget = "approximate time budget, such as 90s, 5m or 1h: schedules are shortened to fit, or lengthened as far as that helps"
    one.add_argument("--time", type=_seconds, metavar="5m", help=budget)
    _resume_options(one)
    one.add_argument("--overwrite", action="store_true", help="replace the run in the folder")

    one = _command(
        subparsers, "render", render_command.render, "render views of a run: relit images, albedo, normals, depth and other layers"
    )
    _run_argument(one)
    render_command.add_options(one)

    one = _command(subparsers, "serve", serve_command.serve, "keep a run loaded and render images on request, for programs")
    _run_argument(one)
    serve_command.add_options(one)

    one = _command(subparsers, "evaluate", commands.evaluate, "compare a run with a dataset: all metrics that its ground truth allows")
    _run_argument(one)
    one.add_argument("dataset", metavar="DATASET", type=Path, nargs="?", help="folder or file of photographs with known cameras")
    defects = "check mesh, UVs and textures for defects: a line each, asset.json; exit status 1 where there are some"
    one.add_argument("--asset", action="store_true", help=defects)
    one.add_argument("-o", dest="out", metavar="REPORT", type=Path, help="folder for report.html and report.json (default: RUN/evaluation)")
    cycles = "also render N of the views in Cycles, from the exported object, and show them next to ours"
    one.add_argument("--cycles", type=_count, default=0, metavar="N", help=cycles)
    whose = "scale, background, masks and colour space of the metrics, as in that paper's own code (default: plain)"
    one.add_argument("--protocol", choices=list(PROTOCOLS), default="plain", help=whose)
    one.add_argument("--views", type=_positive, metavar="N", help="number of views, evenly spread (default: all)")
    one.add_argument("--samples", type=_positive, metavar="N", help="light samples per pixel (default: 64; 512 in the protocols of papers)")
    add_renderer_options(one)
    one.add_argument("--lpips", metavar="FILE", type=Path, help="LPIPS network as TorchScript, where the package lpips is not installed")

    one = _command(subparsers, "export", commands.export, "write the asset, Blender scene, Gaussians or light of a run as one file")
    _run_argument(one)
    one.add_argument("-o", dest="out", metavar="FILE", type=Path, required=True, help=EXPORTED)
    one.add_argument("--material", choices=("textures", "attributes"), help="source of the material's values in a .blend")
    one.add_argument("--lods", action="store_true", help="add levels of detail NAME_LOD1 and NAME_LOD2 that share the textures")
    one.add_argument("--collision", action="store_true", help="add convex hulls UCX_NAME_00 and so on for game engines")
    where = "textures inside the file, or beside it in NAME_textures (default: inside where the format can)"
    one.add_argument("--textures", choices=("auto", "packed", "beside"), default="auto", help=where)
    green = "direction of green in the normal map of .fbx and .obj (default: opengl; directx is the inverse)"
    one.add_argument("--normal-map", choices=("opengl", "directx"), default="opengl", help=green)

    one = _command(subparsers, "bake", commands.bake, "bake a run again: other texture size, other triangles, or an edited mesh")
    _run_argument(one)
    one.add_argument("--size", type=_texels, metavar="N", help="texture size, texels along a side, such as 4k (default: as before)")
    one.add_argument("--triangles", type=int, metavar="N", help="make a new mesh of at most N triangles")
    one.add_argument(
        "--mesh", metavar="FILE", type=Path, help="PLY in the coordinates of the run's mesh.ply that replaces the mesh; its UVs are kept"
    )

    one = _command(subparsers, "batch", commands.batch, "run many jobs from a list, several at a time or on several machines")
    one.set_defaults(check=check_words)  # passed on, since commands.py must not import this module
    one.add_argument("jobs", metavar="JOBS.toml", type=Path, help="[defaults] and [[job]] tables, see docs/batch.md")
    one.add_argument("-j", dest="at_once", type=_positive, default=1, metavar="N", help="jobs at a time on this machine (default: 1)")
    one.add_argument(
        "--dask", metavar="ADDRESS", help="run on the workers of this Dask scheduler (tcp://HOST:PORT); they must see the same folders"
    )

    one = _command(subparsers, "devices", commands.devices, "print the devices that can compute")
    one.add_argument("--json", action="store_true", help="print one JSON object, for programs")
    return top


def _command(subparsers, name: str, function, text: str, resumable: bool = False, repeatable: bool = False) -> argparse.ArgumentParser:
    """Add a command; with `resumable`, --resume makes it go on after a stop, with `repeatable`, the same words do."""
    one = subparsers.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
    one.set_defaults(command=function, resumable=resumable, repeatable=repeatable)
    return one


def _run_argument(one: argparse.ArgumentParser) -> None:
    one.add_argument("run", metavar="RUN", type=Path, help="run folder")


def _set_option(one: argparse.ArgumentParser) -> None:
    change = "change one setting, such as first.iterations=600 (repeatable); run.json of a run lists all settings"
    one.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=change)


def _positive(text: str) -> int:
    if int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} must be at least 1")
    return int(text)


def _texels(text: str) -> int:
    match = re.fullmatch(r"(\d+)(k?)", text.lower())
    if match is None or int(match[1]) < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a texture size such as 2k or 2048")
    return int(match[1]) * (1024 if match[2] else 1)


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} must be at least 0")
    return value


def _seconds(text: str) -> float:
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([smh]?)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text} is not a duration such as 90s, 5m or 1h")
    return float(match[1]) * {"": 1, "s": 1, "m": 60, "h": 3600}[match[2]]


def _length(text: str) -> float:
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(mm|cm|m)", text)
    if match is None or float(match[1]) == 0:
        raise argparse.ArgumentTypeError(f"{text} is not a length such as 50mm, 5cm or 0.05m")
    return float(match[1]) * {"mm": 0.001, "cm": 0.01, "m": 1.0}[match[2]]


def _resume_options(one: argparse.ArgumentParser) -> None:
    one.add_argument("--resume", action="store_true", help="continue the run in the folder")
    _set_option(one)


def check_words(words: Sequence[str]) -> None:
    """Check the words after `irgspp` without running the command; raise InputError where it would refuse them."""
    output = io.StringIO()
    try:
        with contextlib.redirect_stderr(output), contextlib.redirect_stdout(output):
            args = parser().parse_args(list(words))
    except SystemExit:
        lines = output.getvalue().strip().splitlines()
        raise InputError(words[0], lines[-1].partition("error: ")[2] if lines else "is not a command of irgspp") from None
    if args.command is commands.reconstruct:
        with_overrides(preset(args.preset or "balanced"), args.set)
