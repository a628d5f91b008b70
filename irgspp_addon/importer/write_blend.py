# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a run folder as a .blend, in a separate process with `bpy`: `launch.py irgspp_addon.importer.write_blend RUN OUT.blend`."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ...core.assets.options import UNTURNED
from ...core.io.atomic import atomic_file
from ...core.scene.mesh import standing
from ...core.scene.similarity import moved_points
from ..exit_status import exit_status
from .arrangement import show_cameras
from .asset_parts import add_hulls, add_levels
from .materials import SOURCES
from .mesh_origin import mesh_to_run
from .scene_builder import Imported, import_run, show_as_photographed, turn_light
from .texture_images import texture_path

VIEW_DISTANCE = 1.6  # of 3D Views from the object, as a multiple of its diagonal
CLIP = 1e-3, 1e3  # nearest and farthest distance that 3D Views show, as multiples of the diagonal


@dataclass(frozen=True)
class Extras:
    """Additions to the run's scene in a .blend, and its place.

    Attributes:
        parts: job of levels of detail and collision hulls, as `core.assets.production.asset_job` returns it; None without them.
        textures: folder of textures to link, which is moved together with the .blend; None to read the run's.
        final: place that the .blend is moved to afterwards, where links to other files start; None where it stays.
        transform: rows of a similarity (3, 3) that turns and scales the run before it is put on the object's foot.
    """

    parts: dict[str, Any] | None = None
    textures: Path | None = None
    final: Path | None = None
    transform: tuple[float, ...] = UNTURNED


def write_blend(run: Path, target: Path, source: str = "textures", pack: bool = True, extras: Extras | None = None) -> None:
    """Replace the open file by the run's scene and save it atomically.

    The object stands on its foot at the origin, with its cameras around it, which are hidden but for the scene's.

    Args:
        run: run folder.
        target: .blend file to write.
        source: source of the material's values, "textures" or "attributes".
        pack: True to pack textures and light into the .blend.
        extras: levels of detail, collision hulls, textures beside the .blend.

    Raises:
        InputError: if the folder is not a finished run.
    """
    extras = extras or Extras()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    imported = import_run(run, source, pack)
    stand(imported, np.array(extras.transform, float).reshape(3, 3))
    show_as_photographed(bpy.context.scene, imported)
    show_cameras(bpy.context.scene, False)
    if imported.cameras:
        imported.cameras[0].hide_viewport = False
    frame_in_views(imported.mesh)
    if extras.parts is not None:
        _add_parts(imported.mesh, extras.parts)
    for image in bpy.data.images:
        image.filepath = _relative(image.filepath, (extras.final or target).resolve().parent)
    if extras.textures is not None:
        _link_textures(imported.mesh, extras.textures)
    with atomic_file(target.resolve()) as partial:
        bpy.ops.wm.save_as_mainfile(filepath=str(partial), compress=True, relative_remap=False)


def stand(imported: Imported, transform: np.ndarray) -> None:
    """Turn and scale an imported run with its cameras and its light, and put the object's foot at the origin.

    Args:
        imported: run at the place of its first import.
        transform: (3, 3) similarity.
    """
    vertices = np.empty(3 * len(imported.mesh.data.vertices), np.float32)
    imported.mesh.data.vertices.foreach_get("co", vertices)
    in_run = moved_points(vertices.reshape(-1, 3).astype(float), np.array(mesh_to_run(imported.mesh)))
    imported.root.matrix_world = Matrix(standing(in_run, transform).tolist())
    turn_light(imported.world, imported.root)


def frame_in_views(thing: bpy.types.Object) -> None:
    """Let the 3D Views of all workspaces look at an object, in Material Preview.

    Args:
        thing: object of the scene.
    """
    bpy.context.view_layer.update()
    corners = np.array([[*corner, 1.0] for corner in thing.bound_box]) @ np.array(thing.matrix_world)[:3].T
    size = float(np.linalg.norm(np.ptp(corners, axis=0)))
    for space in (area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"):
        space.region_3d.view_location, space.region_3d.view_distance = corners.mean(0), VIEW_DISTANCE * size
        space.clip_start, space.clip_end = CLIP[0] * size, CLIP[1] * size
        space.shading.type = "MATERIAL"


def _add_parts(full: bpy.types.Object, parts: dict[str, Any]) -> None:
    """Add levels of detail, of which only the first is shown, and collision hulls, which are hidden."""
    name = parts["name"]
    levels = add_levels(full, parts["lods"], name) if parts["lods"] else []
    hulls = add_hulls(full, Path(parts["hulls"]), np.array(mesh_to_run(full).inverted())) if parts["hulls"] else []
    for thing in (*levels, *hulls):
        thing.hide_render = True
        thing.hide_set(True)


def _link_textures(full: bpy.types.Object, folder: Path) -> None:
    """Let the material read the textures of a folder beside the .blend, instead of packed ones."""
    for node in full.active_material.node_tree.nodes:
        if node.bl_idname == "ShaderNodeTexImage" and node.image is not None:
            if node.image.packed_file is not None:
                node.image.unpack(method="REMOVE")
            tiles = math.isqrt(len(node.image.tiles)) if node.image.source == "TILED" else 1
            node.image.filepath = f"//{folder.name}/{texture_path(folder, node.label, tiles).name}"


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
    parser.add_argument("--parts", type=Path, metavar="JOB.json", help="levels of detail and collision hulls")
    parser.add_argument("--textures", type=Path, metavar="FOLDER", help="link the textures of this folder beside the .blend")
    parser.add_argument("--final", type=Path, metavar="FILE", help="place that the .blend will be moved to")
    parser.add_argument("--transform", default=",".join(map(str, UNTURNED)), metavar="M,...", help="nine numbers, the rows of a similarity")
    args = parser.parse_args(argv)
    parts = json.loads(args.parts.read_text(encoding="utf-8")) if args.parts else None
    extras = Extras(parts, args.textures, args.final, tuple(map(float, args.transform.split(","))))
    return exit_status(lambda: write_blend(args.run, args.target, args.material, not args.no_pack, extras))


if __name__ == "__main__":
    sys.exit(main())
