# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes of a benchmark: those that are named, or small ones that Cycles renders."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.pipeline import DEMO_DATA

from .bench import Scene

SCRIPTS = Path(__file__).resolve().parent.parent
OWN = ("low-gloss", "glossy")  # kinds of the scenes that are made
SIZE = ("--resolution", "128", "--train", "48", "--test", "8", "--samples", "96", "--light-height", "64")


def named(paths: Sequence[Path]) -> list[Scene]:
    """Each path is a scene's folder, or a folder of such. Raises InputError where one is neither, or two have one name."""
    scenes = []
    for path in paths:
        inside = [path] if is_scene(path) else sorted(p for p in path.iterdir() if is_scene(p)) if path.is_dir() else []
        if not inside:
            raise InputError(path, "is no scene and holds none", "name folders with a transforms_train.json and ground truth")
        scenes += [Scene(one.absolute().name, one) for one in inside]
    if len({scene.name for scene in scenes}) < len(scenes):
        raise InputError(paths[0], "two scenes have one name", "rename a folder")
    return scenes


def is_scene(path: Path) -> bool:
    """Whether the folder holds a rendered dataset: cameras, and a description with lights."""
    return (path / "transforms_train.json").is_file() and (path / "meta.json").is_file()


def embedded() -> list[Scene]:
    """The demonstration's dataset: 64x64, a glazed figure on a copper ring."""
    return [Scene("demo", DEMO_DATA)]


def own(folder: Path, say: Callable[[str], None]) -> list[Scene]:
    """A low-gloss and a glossy scene, rendered into `folder` by Cycles the first time. Raises IrgsppError where that fails."""
    scenes = []
    for kind in OWN:
        target = folder / kind
        if not is_scene(target):
            say(f"rendering the scene {kind} by Cycles, once (about a minute)")
            _render(kind, folder, target)
        scenes.append(Scene(kind, target))
    return scenes


def _render(kind: str, folder: Path, target: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    partial, blend = folder / f"{kind}.part", folder / f"{kind}.blend"
    shutil.rmtree(partial, ignore_errors=True)  # of an interrupted start
    _call("scenes/demo_scene.py", kind, blend)
    _call("render_dataset.py", blend, "-o", partial, *SIZE)
    partial.rename(target)


def _call(script: str, *arguments: object) -> None:
    done = subprocess.run([sys.executable, SCRIPTS / script, *map(str, arguments)], capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        raise IrgsppError(f"{script} ended with status {done.returncode}: {lines[-1] if lines else 'no message'}")
