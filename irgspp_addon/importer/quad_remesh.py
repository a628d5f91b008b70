# SPDX-License-Identifier: GPL-3.0-or-later
"""Remesh a run's mesh to quads, in a separate process with `bpy`: `launch.py ... RUN/mesh.ply OUT.ply QUADS`."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import IrgsppError
from ..exit_status import exit_status
from .asset_parts import normals_from
from .edited_mesh import write_mesh
from .run_mesh import textured_mesh

LEAST = 0.5  # of the number asked for: fewer don't follow the shape, as where open borders run through it
FIX = "try another number, or bake --triangles first"
CHART_ANGLE = math.radians(66)  # largest angle between the faces of a chart; Blender's default
CHART_MARGIN = 0.004  # between charts, of the texture: 4 of 1024 texels


def remesh(source: Path, target: Path, quads: int) -> None:
    """Replace the open file by the mesh, remesh it by QuadriFlow (Huang et al. 2018), unwrap it, and write it as a PLY.

    Smart UV Project cuts along the edges of quads; an unwrapping of triangles would cut some along their diagonals.

    Args:
        source: mesh.ply of the run.
        target: PLY to write, in the same frame.
        quads: approximate number of quads.

    Raises:
        InputError: if the file is no mesh of a run.
        IrgsppError: if QuadriFlow finds no quads.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    full = textured_mesh(source, "full", np.eye(4))
    thing = bpy.data.objects.new("quads", full.copy())
    bpy.context.scene.collection.objects.link(thing)
    bpy.context.view_layer.objects.active = thing
    thing.select_set(True)
    try:
        bpy.ops.object.quadriflow_remesh(mode="FACES", target_faces=quads, seed=0)
    except RuntimeError as error:
        raise IrgsppError(f"QuadriFlow finds no quads ({' '.join(str(error).split())}); {FIX}") from error
    mesh, (made, faces) = thing.data, counted(thing.data)
    if made < faces or made < LEAST * quads:
        raise IrgsppError(f"QuadriFlow makes {made:,} quads of {faces:,} faces where {quads:,} are asked for; {FIX}")
    _unwrap()
    mesh.shade_smooth()
    mesh.normals_split_custom_set_from_vertices(normals_from(full, mesh))
    write_mesh(target, mesh, np.eye(4), thing.name)


def counted(mesh: bpy.types.Mesh) -> tuple[int, int]:
    """Return the numbers of quads and of faces."""
    corners = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_total", corners)
    return int((corners == 4).sum()), len(corners)


def _unwrap() -> None:
    """Unwrap the active object into one square without overlap."""
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(angle_limit=CHART_ANGLE, island_margin=CHART_MARGIN, margin_method="FRACTION", scale_to_bounds=False)
    bpy.ops.object.mode_set(mode="OBJECT")


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(prog="irgspp.irgspp_addon.importer.quad_remesh", description=__doc__)
    parser.add_argument("source", type=Path)
    parser.add_argument("target", type=Path)
    parser.add_argument("quads", type=int)
    args = parser.parse_args(argv)
    return exit_status(lambda: remesh(args.source, args.target, args.quads))


if __name__ == "__main__":
    sys.exit(main())
