# SPDX-License-Identifier: GPL-3.0-or-later
"""Render stand-ins for published datasets with Cycles: two scenes of each kind, in its layout and conventions.

    python scripts/stand_ins.py -o STAND_INS [--kinds tensoir,ref-real] [--resolution 128]
    python scripts/reproduce.py STAND_INS -o tables/ --preset draft

Scenes that exist already are kept. A file stand_in.json in each collection says that these are not the published scenes.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import render_dataset
from formats.source import load_source
from irgspp.core.errors import InputError, IrgsppError
from reproduction.scenes import STAND_IN
from stand_in.kinds import KINDS, Kind
from stand_in.lights import write_light


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line; `argv` is that of the process where None."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="DIR", help="folder of the collections")
    parser.add_argument("--kinds", metavar="A,B", help=f"some of {', '.join(KINDS)} (default: all)")
    parser.add_argument("--resolution", type=int, default=128, help="pixels along a side (default: 128)")
    parser.add_argument("--train", type=int, default=32, help="training views (default: 32)")
    parser.add_argument("--test", type=int, default=6, help="test views (default: 6)")
    parser.add_argument("--samples", type=int, default=32, help="Cycles samples per pixel, then denoised (default: 32)")
    parser.add_argument("--light-height", type=int, default=128, help="rows of the light maps (default: 128)")
    parser.add_argument("--threads", type=int, default=0, help="of Cycles; default: 0, as many as the machine has")
    return parser.parse_args(argv)


def chosen(names: str | None) -> dict[str, Kind]:
    """Return the kinds of a list of names, all for None; raise InputError for an unknown one."""
    listed = list(KINDS) if names is None else names.split(",")
    if unknown := [name for name in listed if name not in KINDS]:
        raise InputError("--kinds", f"unknown kind {', '.join(unknown)}", f"use {', '.join(KINDS)}")
    return {name: KINDS[name] for name in listed}


def make_scene(kind: Kind, name: str, folder: Path, args: argparse.Namespace) -> Path:
    """Render a scene and write it in the layout of its kind; return its folder.

    Args:
        kind: kind of the stand-in.
        name: name of the scene.
        folder: folder of the collection.
        args: parsed options.

    Raises:
        InputError: where the scene can't be rendered.
    """
    with tempfile.TemporaryDirectory(prefix="irgspp-stand-in-") as temporary:
        train, *relights = (str(write_light(light, Path(temporary) / "lights", args.light_height)) for light in kind.lights)
        numbers = {"resolution": args.resolution, "train": args.train, "test": args.test, "samples": args.samples, "threads": args.threads}
        words = [word for option, value in numbers.items() for word in (f"--{option}", str(value))]
        words += ["--scene", kind.scenes[name], "--name", name, "--light", train, *kind.options, "--relight", *relights]
        rendered = Path(temporary) / "scene"
        if render_dataset.main([*words, "-o", str(rendered)]):
            raise InputError(f"{folder.name} {name}", "could not be rendered")
        return kind.write(load_source(rendered), folder)[0]


def make_all(args: argparse.Namespace) -> None:
    """Make the scenes that are missing.

    Raises:
        InputError: where a kind is unknown, or a scene can't be rendered.
    """
    for name, kind in chosen(args.kinds).items():
        folder = args.out / name
        mark = folder / STAND_IN
        made = json.loads(mark.read_text(encoding="utf-8"))["scenes"] if mark.is_file() else {}
        for scene in kind.scenes:
            if scene in made and (folder / made[scene]).is_dir():
                continue
            print(f"{name}: {scene}", file=sys.stderr, flush=True)
            path = make_scene(kind, scene, folder, args)
            made |= {scene: str(path.relative_to(folder))}
            mark.write_text(json.dumps({"stands_in_for": name, "scenes": made}, indent=1), encoding="utf-8")


def main(argv: list[str] | None = None) -> int:
    """Make the stand-ins and return the exit status."""
    args = arguments(argv)
    try:
        make_all(args)
    except IrgsppError as error:
        print(f"stand_ins: {error}", file=sys.stderr)
        return error.exit_status
    print(args.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
