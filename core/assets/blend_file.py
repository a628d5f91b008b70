# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene of a finished run as a .blend file, which a separate Blender process writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError
from ..machine.blender_process import check_written, run_in_blender
from ..progress.protocol import Progress


def write_blend(
    run: Path, target: Path, material: str, progress: Progress, additions: Sequence[str] = (), final: Path | None = None
) -> None:
    """Write the run as a .blend file in a separate Blender process.

    Args:
        run: folder of the finished run.
        target: .blend file to write.
        material: what the material reads, "textures" or "attributes".
        progress: asked whether to stop.
        additions: further arguments of `irgspp_addon.importer.write_blend`.
        final: place that the caller moves the file to, where its links to other files start; None where it stays.

    Raises:
        InputError: when the run has no mesh, or the file can't be written.
        Cancelled: when the user stops the work.
        NoBlender: when no Blender is found.
        IrgsppError: when Blender fails.
    """
    if not (run / "mesh.ply").is_file():
        raise InputError(run / "mesh.ply", "is missing", "finish the reconstruction first")
    arguments = [str(run.resolve()), str(target.resolve()), "--material", material, *additions]
    arguments += ["--final", str(final.resolve())] if final is not None else []
    status, last_line = run_in_blender("irgspp_addon.importer.write_blend", arguments, lambda: progress.cancelled)
    check_written(status, last_line, final or target, target)
