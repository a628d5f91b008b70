# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a run folder as a .blend, in a separate process with `bpy`: `launch.py irgspp_addon.importer.write_blend RUN OUT.blend`."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import bpy

from ...core.errors import IrgsppError
from ...core.io.atomic import atomic_file
from .scene_builder import SOURCES, import_run, show_as_photographed


def write_blend(run: Path, target: Path, source: str = "textures", pack: bool = True) -> None:
    """Replace the open file by the run's scene and save it atomically.

    Args:
        run: run folder.
        target: .blend file to write.
        source: source of the material's values, "textures" or "attributes".
        pack: True to pack textures and light into the .blend.

    Raises:
        InputError: if the folder is not a finished run.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    imported = import_run(run, source, pack)
    show_as_photographed(bpy.context.scene, imported)
    for image in bpy.data.images:
        image.filepath = _relative(image.filepath, target.resolve().parent)
    with atomic_file(target.resolve()) as partial:
        bpy.ops.wm.save_as_mainfile(filepath=str(partial), compress=True, relative_remap=False)


def _relative(path: str, folder: Path) -> str:
    """Return a path relative to the .blend in Blender's form, so that both can be moved together."""
    try:
        return "//" + os.path.relpath(bpy.path.abspath(path), folder).replace(os.sep, "/")
    except ValueError:  # another drive of Windows
        return path


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(prog="irgspp.irgspp_addon.importer.write_blend", description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("target", type=Path)
    parser.add_argument("--material", choices=SOURCES, default="textures")
    parser.add_argument("--no-pack", action="store_true", help="link textures and light instead of packing them")
    args = parser.parse_args(argv)
    try:
        write_blend(args.run, args.target, args.material, not args.no_pack)
    except IrgsppError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
