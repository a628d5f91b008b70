# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernel cache: the CPU kernels of a usual job are compiled beforehand, so that the first job on a machine does not wait for them."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from .kernels.cpu.jit import cache_folder, compiled_by
from .machine.compilation import compilations_reported
from .pipeline import DEMO_DATA, DEMO_OVERRIDES, reconstruct
from .progress.protocol import Progress, Silent
from .settings.overrides import with_overrides
from .settings.schema import Settings

# A job that calls all kernels and does hardly any work. A glossy object needs more of them than another.
LITTLE_WORK = (
    *("device=cpu", "materials=glossy", "pace=0.01", "first.gaussians=2000", "first.trial_iterations=2", "first.trial_gaussians=500"),
    *("second.points=300", "second.rows=6", "second.normal_iterations=3", "second.pool=5000"),
    *("surface.voxels=48", "surface.triangles=2000", "surface.texture=128", "surface.albedo_detail=on"),
)
ABOUT = 300  # kernels and their helpers that are compiled; a count for the progress bar


class _Quiet(Silent):
    """Progress of the job, which is not shown; it can be cancelled where `shown` is."""

    def __init__(self, shown: Progress) -> None:
        self._shown = shown

    @property
    def cancelled(self) -> bool:  # type: ignore[override]  # an attribute of Silent
        """True once the user stops the command."""
        return self._shown.cancelled


def fill_kernel_cache(progress: Progress) -> int:
    """Compile the CPU kernels that the cache lacks, and return their number with that of their helpers.

    A small job on the demo dataset is run in a temporary folder. A mark in the cache says that this has been done for this version.

    Args:
        progress: receives the phase "compile kernels", and may cancel.

    Raises:
        Cancelled: the user stopped the work; what has been compiled is kept.
        OSError: a folder can't be written.
    """
    done, compiled = Path(os.environ["NUMBA_CACHE_DIR"]) / _mark(), 0
    if done.exists():
        return 0
    progress.phase("compile kernels", ABOUT)

    def count() -> None:
        nonlocal compiled
        compiled += 1
        progress.step(min(compiled, ABOUT))

    settings = with_overrides(Settings(), [*DEMO_OVERRIDES, *LITTLE_WORK])
    with tempfile.TemporaryDirectory(prefix="irgspp-") as folder, compilations_reported(count):
        reconstruct(DEMO_DATA, Path(folder) / "run", settings, progress=_Quiet(progress))
    progress.step(ABOUT)
    done.touch()
    return compiled


def _mark() -> str:
    """Return the name of the mark: other sources, another compiler and another processor have other kernels."""
    return f"filled-{cache_folder().name}-{compiled_by()}"
