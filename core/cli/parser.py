# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of every command."""

from __future__ import annotations

import argparse
import contextlib
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..assets.options import UNTURNED
from ..errors import InputError
from ..evaluation.protocols import PROTOCOLS
from ..settings.overrides import with_overrides
from ..settings.schema import PRESETS, preset
from . import commands
from . import render as render_command
from . import serve as serve_command
from .option_values import count, decimal_words, length, positive, positive_factor, seconds, texels
from .renderer_options import add_renderer_options

Subparsers = Any  # what argparse returns has no public type
EXPORTED = "ends with .glb, .usd, .usdc, .usda, .usdz, .obj or .fbx (asset), .blend (scene), .ply (Gaussian splats) or .exr (light)"


def parser() -> argparse.ArgumentParser:
    """Return the parser of the words after `irgspp`."""
    top = argparse.ArgumentParser("irgspp", description="Inverse rendering for Blender: photographs in, a relightable object out.")
    subparsers = top.add_subparsers(required=True, metavar="COMMAND")
    for add in (
        _add_demo,
        _add_inspect,
        _add_capture,
        _add_reconstruct,
        _add_render,
        _add_serve,
        _add_evaluate,
        _add_export,
        _add_bake,
        _add_batch,
        _add_devices,
        _add_compile,
    ):
        add(subparsers)
    return top


def _add_demo(subparsers: Subparsers) -> None:
    one = _command(subparsers, "demo", commands.demo, "reconstruct the small dataset that comes with irgspp", resumable=True)
    one.add_argument("-o", dest="run", metavar="DIR", type=Path, default=Path("demo"), help="run folder (default: demo)")
    one.add_argument("--preset", choices=("draft", "balanced"), default="balanced", help="amount of work (default: balanced)")
    _resume_options(one)


def _add_inspect(subparsers: Subparsers) -> None:
    one = _command(subparsers, "inspect", commands.inspect, "print what irgspp reads in a dataset, and how long a job will take")
    one.add_argument("dataset", metavar="DATASET", type=Path, help="folder or file of photographs with known cameras")
    one.add_argument("--json", action="store_true", help="print one JSON object, for programs")
    one.add_argument("--export", metavar="FOLDER", type=Path, help="also write cameras, points and undistorted photographs to a folder")
    _set_option(one)


def _add_capture(subparsers: Subparsers) -> None:
    one = _command(
        subparsers,
        "capture",
        commands.capture,
        "photographs without cameras, or a video, to a dataset: cameras, masks, exposures, true size",
        repeatable=True,
    )
    source = "folder of photographs and videos, or a video; a dataset with cameras, out of which the object is cut; or a finished capture, "
    source += "to change its options in place"
    one.add_argument("photographs", metavar="PHOTOS", type=Path, help=source)
    one.add_argument("-o", dest="folder", metavar="DATASET", type=Path, help="folder to write; not needed for a finished capture")
    _capture_options(one)
    ends = ("X", "Y", "Z", "X", "Y", "Z", "LENGTH")
    known = "two points of a finished capture, in its coordinates, and their true distance such as 12cm: all lengths become metres"
    one.add_argument("--distance", nargs=7, metavar=ends, help=known)
    one.add_argument("--seed", type=int, metavar="N", help="seed of every random number generator (default: 0)")
    _set_option(one)


def _add_reconstruct(subparsers: Subparsers) -> None:
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
    texture = "texture size, texels along a side: 1k, 2k, 4k, 8k or a number (default: by the photographs' pixels on the object)"
    one.add_argument("--texture", type=texels, metavar="SIZE", help=texture)
    tiles = "N x N UDIM tiles of that size; no chart crosses the border of a tile (default: 1, one square)"
    one.add_argument("--udim", type=positive, metavar="N", help=tiles)
    one.add_argument("--device", choices=("auto", "cpu", "cuda"), help="device to compute on (default: auto)")
    one.add_argument("--seed", type=int, metavar="N", help="seed of every random number generator (default: 0)")
    budget = "approximate time budget, such as 90s, 5m or 1h: schedules are shortened to fit, or lengthened as far as that helps"
    one.add_argument("--time", type=seconds, metavar="5m", help=budget)
    _capture_options(one.add_argument_group("photographs without cameras"))
    _resume_options(one)
    one.add_argument("--overwrite", action="store_true", help="replace the run in the folder")


def _add_render(subparsers: Subparsers) -> None:
    one = _command(
        subparsers, "render", render_command.render, "render views of a run: relit images, albedo, normals, depth and other layers"
    )
    _run_argument(one)
    render_command.add_options(one)


def _add_serve(subparsers: Subparsers) -> None:
    one = _command(subparsers, "serve", serve_command.serve, "keep a run loaded and render images on request, for programs")
    _run_argument(one)
    serve_command.add_options(one)


def _add_evaluate(subparsers: Subparsers) -> None:
    one = _command(subparsers, "evaluate", commands.evaluate, "compare a run with a dataset: all metrics that its ground truth allows")
    _run_argument(one)
    one.add_argument("dataset", metavar="DATASET", type=Path, nargs="?", help="folder or file of photographs with known cameras")
    defects = "check mesh, UVs and textures for defects: a line each, asset.json; exit status 1 where there are some"
    one.add_argument("--asset", action="store_true", help=defects)
    one.add_argument("-o", dest="out", metavar="REPORT", type=Path, help="folder for report.html and report.json (default: RUN/evaluation)")
    cycles = "also render N of the views in Cycles, from the exported object, and show them next to ours"
    one.add_argument("--cycles", type=count, default=0, metavar="N", help=cycles)
    whose = "scale, background, masks and colour space of the metrics, as in that paper's own code (default: plain)"
    one.add_argument("--protocol", choices=list(PROTOCOLS), default="plain", help=whose)
    one.add_argument("--views", type=positive, metavar="N", help="number of views, evenly spread (default: all)")
    one.add_argument("--samples", type=positive, metavar="N", help="light samples per pixel (default: 64; 512 in the protocols of papers)")
    add_renderer_options(one)
    one.add_argument("--lpips", metavar="FILE", type=Path, help="LPIPS network as TorchScript, where the package lpips is not installed")


def _add_export(subparsers: Subparsers) -> None:
    one = _command(subparsers, "export", commands.export, "write the asset, Blender scene, Gaussians or light of a run as one file")
    _run_argument(one)
    one.add_argument("-o", dest="out", metavar="FILE", type=Path, required=True, help=EXPORTED)
    one.add_argument("--material", choices=("textures", "attributes"), help="source of the material's values in a .blend")
    one.add_argument("--lods", action="store_true", help="add levels of detail NAME_LOD1 and NAME_LOD2 that share the textures")
    one.add_argument("--collision", action="store_true", help="add convex hulls UCX_NAME_00 or UCX_NAME_LOD0_00 and so on for game engines")
    where = "textures inside the file, beside it in NAME_textures, or beside it as UDIM tiles (default: inside where the format can)"
    one.add_argument("--textures", choices=("auto", "packed", "beside", "tiles"), default="auto", help=where)
    green = "direction of green in the normal map of .fbx and .obj (default: opengl; directx is the inverse)"
    one.add_argument("--normal-map", choices=("opengl", "directx"), default="opengl", help=green)
    occlusion = "trace ambient occlusion (seconds): red of orm.png, occlusion.png, and the occlusion texture of .glb"
    one.add_argument("--occlusion", action="store_true", help=occlusion)
    one.add_argument("--scale", type=positive_factor, default=1.0, metavar="X", help="factor of all lengths (default: 1)")
    turned = "rows of a 3 x 3 matrix that turns and scales the object before it is put on its foot (default: as reconstructed)"
    one.add_argument("--transform", type=float, nargs=9, default=UNTURNED, metavar="M", help=turned)


def _add_bake(subparsers: Subparsers) -> None:
    one = _command(subparsers, "bake", commands.bake, "bake a run again: other texture size, other triangles, quads, or an edited mesh")
    _run_argument(one)
    size = "texels along a side, such as 4k; textures smaller than the last bake are made from it (default: bake its size again)"
    one.add_argument("--size", type=texels, metavar="N", help=size)
    tiles = "N x N UDIM tiles of that size, into which the charts are packed; 1: one square (default: as in the last bake)"
    one.add_argument("--udim", type=positive, metavar="N", help=tiles)
    deep = "bits of each value of albedo, roughness, metallic and normal.png; a .glb always has 8 (default: as in the last bake)"
    one.add_argument("--bits", type=int, choices=(8, 16), help=deep)
    one.add_argument("--triangles", type=int, metavar="N", help="make a new mesh of at most N triangles")
    one.add_argument(
        "--mesh", metavar="FILE", type=Path, help="PLY in the coordinates of the run's mesh.ply that replaces the mesh; its UVs are kept"
    )
    remeshed = "remesh the run's mesh to about N quads by Blender's QuadriFlow"
    one.add_argument("--quads", type=int, metavar="N", help=remeshed)
    finer = "also bake the height of the surface as it was fused above a mesh of fewer triangles: textures/height.png, 16 bits"
    one.add_argument("--height", action="store_true", help=finer)


def _add_batch(subparsers: Subparsers) -> None:
    one = _command(subparsers, "batch", commands.batch, "run many jobs from a list, several at a time or on several machines")
    one.set_defaults(check=check_words)  # passed on, since commands.py must not import this module
    one.add_argument("jobs", metavar="JOBS.toml", type=Path, help="[defaults] and [[job]] tables, see docs/batch.md")
    one.add_argument("-j", dest="at_once", type=positive, default=1, metavar="N", help="jobs at a time on this machine (default: 1)")
    one.add_argument(
        "--dask", metavar="ADDRESS", help="run on the workers of this Dask scheduler (tcp://HOST:PORT); they must see the same folders"
    )


def _add_devices(subparsers: Subparsers) -> None:
    one = _command(subparsers, "devices", commands.devices, "print the devices that can compute")
    one.add_argument("--json", action="store_true", help="print one JSON object, for programs")


def _add_compile(subparsers: Subparsers) -> None:
    _command(subparsers, "compile", commands.compile_kernels, "compile the kernels for this processor, so that the first job need not")


def _command(
    subparsers: Subparsers, name: str, function: Callable[..., object], text: str, resumable: bool = False, repeatable: bool = False
) -> argparse.ArgumentParser:
    """Add a command; with `resumable`, --resume makes it go on after a stop, with `repeatable`, the same words do."""
    one = subparsers.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
    one.set_defaults(command=function, resumable=resumable, repeatable=repeatable)
    return one


def _run_argument(one: argparse.ArgumentParser) -> None:
    one.add_argument("run", metavar="RUN", type=Path, help="run folder")


def _set_option(one: argparse.ArgumentParser) -> None:
    change = "change one setting, such as first.iterations=600 (repeatable); run.json of a run lists all settings"
    one.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=change)


def _capture_options(one: Any) -> None:
    """Add the options of captures to a parser or a group of it."""
    side = "side of the black square of an ArUco or AprilTag marker in the photographs, such as 5cm: the object gets its true size"
    one.add_argument("--marker", type=length, metavar="SIZE", help=side)
    fixed = "the object turns before a fixed camera (default: auto, where a background with texture stays at its place)"
    one.add_argument("--turntable", choices=("auto", "on", "off"), help=fixed)
    sphere = "sphere that holds the object, in the coordinates of the captured dataset (default: the object is found)"
    one.add_argument("--sphere", type=float, nargs=4, metavar=("X", "Y", "Z", "RADIUS"), help=sphere)


def _resume_options(one: argparse.ArgumentParser) -> None:
    one.add_argument("--resume", action="store_true", help="continue the run in the folder")
    _set_option(one)


def check_words(words: Sequence[str]) -> None:
    """Check the words after `irgspp` without running the command; raise InputError where it would refuse them."""
    output = io.StringIO()
    try:
        with contextlib.redirect_stderr(output), contextlib.redirect_stdout(output):
            args = parser().parse_args(decimal_words(words))
    except SystemExit:
        lines = output.getvalue().strip().splitlines()
        raise InputError(words[0], lines[-1].partition("error: ")[2] if lines else "is not a command of irgspp") from None
    if args.command is commands.reconstruct:
        from ..capture.chosen_sphere import chosen_sphere

        chosen_sphere(with_overrides(preset(args.preset or "balanced"), [*commands.capture_overrides(args), *args.set]).capture)
