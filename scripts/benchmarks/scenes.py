# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of a benchmark: those named on the command line, or small ones rendered by Cycles."""

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
KINDS = ("low-gloss", "glossy")  # scenes that are rendered
SIZE = ("--resolution", "128", "--train", "48", "--test", "8", "--samples", "96", "--light-height", "64")


def find_scenes(paths: Sequence[Path]) -> list[Scene]:
    """Return the scenes of a list of folders, each a scene or a folder of scenes.

    Args:
        paths: folders.

    Raises:
        InputError: where a folder is neither, or two scenes have one name.
    """
    scenes = []
    for path in paths:
        inside = [path] if is_scene(path) else sorted(p for p in path.iterdir() if is_scene(p)) if path.is_dir() else []
        if not inside:
            raise InputError(
                path, "is neither a scene nor a folder of scenes", "name folders with a transforms_train.json and ground truth"
            )
        scenes += [Scene(one.absolute().name, one) for one in inside]
    if len({scene.name for scene in scenes}) < len(scenes):
        raise InputError(paths[0], "two scenes have the same name", "rename a folder")
    return scenes


def is_scene(path: Path) -> bool:
    """Return True where a folder holds a rendered dataset: cameras, and a description with lights."""
    return (path / "transforms_train.json").is_file() and (path / "meta.json").is_file()


def demo_scenes() -> list[Scene]:
    """Return the demonstration's dataset: 64x64, a glazed figure on a copper ring."""
    return [Scene("demo", DEMO_DATA)]


def rendered_scenes(folder: Path, say: Callable[[str], None]) -> list[Scene]:
    """Return a low-gloss and a glossy scene, which Cycles renders the first time.

    Args:
        folder: folder of the scenes.
        say: called with a line for the user.

    Raises:
        IrgsppError: where Blender fails.
    """
    scenes = []
    for kind in KINDS:
        target = folder / kind
        if not is_scene(target):
            say(f"rendering the scene {kind} by Cycles, once (about a minute)")
            _render(kind, folder, target)
        scenes.append(Scene(kind, target))
    return scenes


def _render(kind: str, folder: Path, target: Path) -> None:
    """Render a scene into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    partial = folder / f"{kind}.part"
    shutil.rmtree(partial, ignore_errors=True)  # left by an interrupted call
    _call("render_dataset.py", "--scene", kind, "-o", partial, *SIZE)
    partial.rename(target)


def _call(script: str, *arguments: object) -> None:
    """Run a script of this folder."""
    done = subprocess.run([sys.executable, SCRIPTS / script, *map(str, arguments)], capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        raise IrgsppError(f"{script} ended with status {done.returncode}: {lines[-1] if lines else 'no message'}")
