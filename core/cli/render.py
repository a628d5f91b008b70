# SPDX-License-Identifier: GPL-3.0-or-later
"""Command `irgspp render`: relit images and layers of a run from any views, under any environment maps."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..machine.quick_imports import quick_imports
from ..progress.terminal import Terminal
from ..rendering.layers import LAYERS
from ..run_folder import read_run
from ..settings.overrides import from_dict, with_overrides
from ..settings.schema import DataSettings
from .renderer_options import add_renderer_options, relight_settings

if TYPE_CHECKING:
    from ..scene.camera import Camera
    from ..scene.reconstruction import Reconstruction

# torch and numba are imported inside the functions, so that `irgspp --help` answers at once.

MOST_FRAMES = 1_000_000
SMALLEST_SIDE, LARGEST_SIDE = 16, 16384  # that `--resolution` takes, pixels
LONGEST_SIDE = 1600  # of the images of a dataset's views where `--resolution` is not given, pixels


def render(args: argparse.Namespace, terminal: Terminal) -> int:
    """Render views of a run as image files.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    with quick_imports():
        from ..relight.backends import best_backend, open_relighter
        from ..relight.render_views import load_lamps, load_light, render_views
        from ..rendering.trusted_device import trusted_device
        from ..scene.reconstruction import Reconstruction

    settings = from_dict(read_run(args.run)["settings"], args.run / "run.json")
    lights = [load_light(*one, progress=terminal) for one in _lights(args)]
    lamps = load_lamps(args.lamps) if args.lamps is not None else ()
    reconstruction = Reconstruction.load(args.run).to(trusted_device(args.device).device)
    relight = replace(
        relight_settings(args),
        samples=args.samples,
        albedo_scale=tuple(args.albedo_scale),
        skip=with_overrides(settings, _skip_only(args.set)).skip,
        error=args.error,
    )
    relighter = open_relighter(args.run, reconstruction, args.backend or best_backend(args.run), relight)
    cameras = _cameras(args, settings.data, reconstruction)
    render_views(relighter, cameras, args.out, terminal, layers=args.layers, lights=lights, lamps=lamps)
    terminal.end_line()
    if "rgba" in args.layers:
        print(relighter.tally, file=sys.stderr)
    print(args.out)
    return 0


def _skip_only(overrides: Sequence[str]) -> Sequence[str]:
    """Return the overrides; raise InputError for a setting that rendering a finished run does not use."""
    for text in overrides:
        if not text.startswith("skip."):
            raise InputError(
                f"--set {text}", "is a setting of the reconstruction, not of rendering", "use skip.reuse_visibility or skip.cache_rays"
            )
    return overrides


def _lights(args: argparse.Namespace) -> list[tuple[Path, str | None, float, float]]:
    """Return file, name, rotation (degrees) and strength of each light; the last two are given once for all or once for each."""
    count = len(args.environment)
    columns = [args.environment]
    for option, default in (("name", None), ("rotation", 0.0), ("strength", 1.0)):
        given = getattr(args, option)
        if given and not count:
            raise InputError(f"--{option}", "describes a light, but none is given", "add --environment FILE")
        if len(given) not in (0, count) and (option == "name" or len(given) > 1):
            raise InputError(f"--{option}", f"is given {len(given)} times for {count} lights", "give one for each --environment")
        columns.append(given if len(given) == count else [*given, default][:1] * count)
    return list(zip(*columns, strict=True))


def _cameras(args: argparse.Namespace, settings: DataSettings, reconstruction: Reconstruction) -> list[tuple[str, Camera]]:
    """Return the named views of a dataset, or an orbit with the intrinsics of their first (of the run's own where none is named).

    Views of a dataset have the size of its photographs, not that of the reduced ones that the run was made from.
    """
    with quick_imports():
        from ..capture.source import posed_dataset
        from ..relight.orbit import orbit
        from ..relight.render_views import cameras_of, split_of
        from ..scene.camera_files import load_run_cameras

    if args.orbit is None and args.views is None:
        raise InputError("render", "no views are given", "add --views DATASET[:split] or --orbit N")
    if args.views is not None:
        path, split = split_of(args.views)
        own_size = replace(settings, resolution=args.resolution or LONGEST_SIDE)
        cameras = cameras_of(posed_dataset(path, args.run), split, own_size, reconstruction.to_world)
    else:
        cameras = [(placed.name, placed.camera) for placed in load_run_cameras(args.run / "cameras.json")]
    if args.orbit is not None:
        cameras = orbit(args.orbit, [camera for _, camera in cameras], reconstruction.bound)
    if args.resolution is not None:
        cameras = [(name, camera.with_longest_side(args.resolution)) for name, camera in cameras]
    if args.frames is None:
        return cameras
    if (last := max(args.frames)) >= len(cameras):
        raise InputError("--frames", f"{last}: there are views 0 to {len(cameras) - 1}")
    return [cameras[frame] for frame in args.frames]


def add_options(one: argparse.ArgumentParser) -> None:
    """Add the options of `render`, except the run folder, to its parser."""
    views = "cameras of this dataset; split: train, test or all (default: the test views, or all where it has none)"
    one.add_argument("--views", metavar="DATASET[:split]", help=views)
    one.add_argument("--orbit", type=int, metavar="N", help="N views on a circle around the object instead")
    of_views = f"that of the photographs of --views, at most {LONGEST_SIDE}, or of the run's own cameras"
    side = f"longest side of the images, pixels (default: {of_views})"
    one.add_argument("--resolution", type=_side, metavar="N", help=side)
    some = "only these views, counted from 0, such as 0-9,20: several machines can share a turntable"
    one.add_argument("--frames", type=_frames, metavar="A-B,C", help=some)
    one.add_argument("-o", dest="out", metavar="OUT", type=Path, required=True, help="folder for the images")
    one.add_argument("--layers", type=_layers, default=LAYERS, metavar="A,B", help=f"layers to write (default: {','.join(LAYERS)})")
    _light_options(one)
    add_renderer_options(one)
    _accuracy_options(one)


def _light_options(one: argparse.ArgumentParser) -> None:
    files = "lat-long environment map (.exr, .hdr, .png or .jpg) to relight the object with; repeatable (default: the recovered light)"
    one.add_argument("--environment", metavar="FILE", type=Path, action="append", default=[], help=files)
    one.add_argument("--name", action="append", default=[], help="the light's name in file names (default: that of its file)")
    turn = "rotation of the light about +Z, degrees, counter-clockwise seen from above; once for all lights or once for each"
    one.add_argument("--rotation", type=float, action="append", default=[], metavar="DEG", help=turn)
    one.add_argument(
        "--strength",
        type=float,
        action="append",
        default=[],
        metavar="X",
        help="factor of the light's radiance; once for all lights or once for each",
    )
    lamps = "JSON list of lamps (core/scene/lamps.py) that add to each light, in the run's frame"
    one.add_argument("--lamps", metavar="FILE", type=Path, help=lamps)


def _accuracy_options(one: argparse.ArgumentParser) -> None:
    one.add_argument("--samples", default="hq", metavar="hq|efficient|N", help="light samples per pixel (hq: 512, efficient: 32 or 16)")
    error = "take as many samples as this error needs, by an estimate: root mean square of the object in sRGB, 0.01 is 1 %%"
    one.add_argument("--error", type=_error, metavar="E", help=error)
    rules = "skip.reuse_visibility=off traces every shadow ray, skip.cache_rays=off traces again for each light; on, off or auto"
    one.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=rules)
    scale = "factors of the albedo, whose brightness is ambiguous under unknown light; `irgspp evaluate` prints the best ones"
    one.add_argument("--albedo-scale", type=_factor, nargs=3, default=(1.0, 1.0, 1.0), metavar=("R", "G", "B"), help=scale)


def _frames(text: str) -> list[int]:
    """Parse a list of frames such as 0-9,20 into sorted numbers without duplicates."""
    found: set[int] = set()
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)(?:\s*(?:-|\.\.)\s*(\d+))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if not first <= last < MOST_FRAMES:
            raise argparse.ArgumentTypeError(f"{text} is not a list of frames such as 0-9,20")
        found |= set(range(first, last + 1))
    return sorted(found)


def _factor(text: str) -> float:
    value = float(text)
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} must be at least 0 and finite")
    return value


def _side(text: str) -> int:
    if not text.isdecimal() or not SMALLEST_SIDE <= int(text) <= LARGEST_SIDE:
        raise argparse.ArgumentTypeError(f"{text} must be a number of pixels from {SMALLEST_SIDE} to {LARGEST_SIDE}")
    return int(text)


def _error(text: str) -> float:
    value = float(text)
    if not 1e-4 <= value < 1:
        raise argparse.ArgumentTypeError(f"{text} must be from 0.0001 up to, but not including, 1")
    return value


def _layers(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if unknown := [name for name in names if name not in LAYERS]:
        raise argparse.ArgumentTypeError(f"unknown layer {', '.join(unknown)} (known: {', '.join(LAYERS)})")
    return names
