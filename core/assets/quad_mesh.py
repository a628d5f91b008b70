# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh of a run remeshed to quads by Blender's QuadriFlow, in a separate Blender process."""

from __future__ import annotations

import tempfile
from pathlib import Path

from ..errors import InputError
from ..machine.blender_process import check_written, run_in_blender
from ..progress.protocol import Progress
from ..scene.edited_mesh import EditedMesh, load_edited_mesh

FEWEST = 100  # quads


def quad_mesh(run: Path, quads: int, progress: Progress) -> EditedMesh:
    """Remesh the mesh of a run to quads, with UVs whose seams follow their edges.

    Args:
        run: folder of the finished run.
        quads: approximate number of them, at least `FEWEST`.
        progress: receives the phase, and is asked whether to stop.

    Raises:
        InputError: when the number is too small, or QuadriFlow finds no quads.
        Cancelled: when the user stops the work.
        NoBlender: when no Blender is found.
        IrgsppError: when Blender fails.
    """
    if quads < FEWEST:
        raise InputError("--quads", f"{quads} is too few", f"use {FEWEST} or more")
    progress.phase("quads", 0)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "quads.ply"
        words = [str((run / "mesh.ply").resolve()), str(path), str(quads)]
        status, line = run_in_blender("irgspp_addon.importer.quad_remesh", words, lambda: progress.cancelled)
        check_written(status, line, run / "mesh.ply", path)
        return load_edited_mesh(path)
