# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory layout of a job: checked against the device's free memory before the job starts."""

from __future__ import annotations

from dataclasses import dataclass

from ...machine.cpu_memory import MOST_RAYS, rays_that_fit
from ...machine.devices import ChosenDevice
from ...machine.gpu_memory import plan
from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...settings.schema import Settings


@dataclass(frozen=True)
class MemoryLayout:
    """Memory layout of one job.

    Attributes:
        resident: the training images stay on the device during the first stage; else each is copied there for its step.
        rays: secondary rays traced at a time on the CPU.
    """

    resident: bool
    rays: int


def fit_into_memory(data: Dataset, settings: Settings, chosen: ChosenDevice, progress: Progress) -> MemoryLayout:
    """Return the fastest layout that fits into the free memory of the chosen device.

    Args:
        data: images as they were loaded.
        settings: settings of the job.
        chosen: device to compute on, with its free memory.
        progress: receives a message where fewer rays than usual are traced at a time.

    Raises:
        InputError: the job does not fit in any layout.
    """
    if chosen.device.type != "cpu":
        width, height = (max(getattr(view.camera, side) for view in data.train) for side in ("width", "height"))
        return MemoryLayout(plan(settings, len(data.train), width, height, chosen.free).targets, MOST_RAYS)
    rays = rays_that_fit(settings, data.pixels())
    if rays < MOST_RAYS:
        progress.message(f"memory is short: {rays} rays are traced at a time instead of {MOST_RAYS}, which takes longer")
    return MemoryLayout(True, rays)
