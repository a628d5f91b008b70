# SPDX-License-Identifier: GPL-3.0-or-later
"""Links to folders that survive a move: of a project with its .blend file, and of a run folder alone.

Datablocks and settings name their folders by absolute paths. Each save notes the folder of the .blend file; where a file is opened from
another folder, paths are read relative to it.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent  # pyright: ignore[reportMissingImports]

from ..image_path import path_in_file
from ..properties import set_quietly
from .mask_image import MASK
from .ownership import KEY, rename_owner
from .run_root import DATASET, RUN
from .texture_images import has_file

IDENTITY = "irgspp_run_identity"  # custom property of a run's empty: hash of files that no later step changes
IDENTIFYING = ("reconstruction.json", "environment.exr")
LINKED = ("FILE", "TILED")  # sources of images whose paths name files


def note_place(file: str) -> None:
    """Note the folder of the .blend file in the local scenes' settings.

    Args:
        file: path of the file that is being saved; empty for the startup file.
    """
    if not file:
        return
    folder = str(Path(bpy.path.abspath(file)).parent.resolve())
    for scene in bpy.data.scenes:
        if scene.library is None and scene.irgspp.saved_in != folder:
            scene.irgspp.saved_in = folder


def follow_move() -> None:
    """Correct all links where the open .blend file was saved in another folder."""
    if not bpy.data.filepath:
        return
    now = Path(bpy.data.filepath).parent.resolve()
    for before in {scene.irgspp.saved_in for scene in bpy.data.scenes if scene.library is None}:
        if before and Path(before) != now:
            _correct_owners(Path(before), now)
            _correct_images(Path(before), now)
            for scene in bpy.data.scenes:
                _correct_settings(scene, Path(before), now)


def moved(path: Path, before: Path, now: Path) -> Path:
    """Return the place of a file or folder after a project was moved; the same path where it has not moved with it.

    Args:
        path: absolute path before.
        before: folder of the .blend file before.
        now: folder of the .blend file now.
    """
    try:
        candidate = Path(os.path.normpath(now / os.path.relpath(path, before)))
    except ValueError:  # another drive of Windows
        return path
    return candidate if candidate.exists() and (path.is_relative_to(before) or not path.exists()) else path


def _correct_owners(before: Path, now: Path) -> None:
    roots = [thing for thing in bpy.data.objects if thing.library is None and (RUN in thing or DATASET in thing)]
    for folder in {Path(block[KEY].rpartition("#")[0]) for block in roots if KEY in block}:
        place = moved(folder, before, now)
        if place != folder:
            _rename(folder, place)


def _rename(folder: Path, place: Path) -> None:
    rename_owner(folder, place)
    for thing in bpy.data.objects:
        for name in (RUN, DATASET):
            if thing.library is None and thing.get(name) == str(folder):
                thing[name] = str(place)


def _correct_images(before: Path, now: Path) -> None:
    """Correct the paths of images such as photographs behind cameras, and of the masks that are painted."""
    for image in bpy.data.images:
        if image.library is not None:
            continue
        if MASK in image:
            image[MASK] = str(moved(Path(image[MASK]), before, now))
        if image.source in LINKED and image.filepath.startswith("//"):
            _follow_file(image, before)
        elif image.source in LINKED and image.filepath:
            place = str(moved(Path(image.filepath), before, now))
            if place == image.filepath:
                continue
            if image.packed_file is not None:
                image.filepath_raw = place  # without reading the file, since the .blend holds the pixels
            else:
                image.filepath = place


def _follow_file(image: bpy.types.Image, before: Path) -> None:
    """Correct the relative path of an image that stayed where it was, while the .blend file was moved alone."""
    file = before / image.filepath[2:]
    if not has_file(Path(bpy.path.abspath(image.filepath))) and has_file(file):
        image.filepath_raw = path_in_file(file)
        if image.packed_file is None:
            image.reload()


def _correct_settings(scene: bpy.types.Scene, before: Path, now: Path) -> None:
    for name in ("dataset", "run"):
        value = getattr(scene.irgspp, name)
        if value and not value.startswith("//") and scene.library is None:
            place = moved(Path(value), before, now)
            if place != Path(value):
                set_quietly(scene.irgspp, name, str(place))


def adopt_moved_run(run: Path) -> None:
    """Make the run folder the owner of the datablocks of the same run that was imported from a place where it no longer is.

    Args:
        run: run folder that is about to be imported.
    """
    run = run.resolve()
    roots = [thing for thing in bpy.data.objects if RUN in thing and thing.library is None]
    if any(thing[RUN] == str(run) for thing in roots):
        return
    identity = run_identity(run)
    for root in roots:
        folder = Path(root[RUN])
        same = root[IDENTITY] == identity if IDENTITY in root else folder.name == run.name
        if same and identity and not (folder / IDENTIFYING[0]).exists():
            _rename(folder, run)
            return


def run_identity(run: Path) -> str:
    """Return a hash by which a run is recognised at another place; "" where its files can't be read."""
    digest = hashlib.sha256()
    try:
        for name in IDENTIFYING:
            digest.update((run / name).read_bytes())
    except OSError:
        return ""
    return digest.hexdigest()


@persistent
def _saving(file: Any = "", *_: Any) -> None:
    note_place(file or "")


@persistent
def _loaded(*_: Any) -> None:
    follow_move()


def register() -> None:
    """Add the handlers of saved and opened files."""
    bpy.app.handlers.save_pre.append(_saving)
    bpy.app.handlers.load_post.append(_loaded)


def unregister() -> None:
    """Remove them."""
    bpy.app.handlers.save_pre.remove(_saving)
    bpy.app.handlers.load_post.remove(_loaded)
