# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture size of a job: by the pixels of the full-size photographs that show the object, within memory, disk space and time budget."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..scene.dataset import Dataset
from ..settings.schema import Settings
from ..settings.sizes import texels_along, with_texture_size
from .cpu_memory import check_texture_memory, free_memory, resident_memory, texture_memory
from .disk_space import check_texture_disk_space, estimate_disk_space, free_disk_space
from .job_time import USUAL_TEXTURE, larger_texture_seconds, may_take_detail

SMALLEST = 512  # texels along a side below which no shortage lowers the choice: the draft preset's
USABLE = 0.7  # fraction of the free memory and disk space that a job of a chosen size may plan with, since other programs need some, too
TIME_FRACTION = 0.2  # of a time budget that textures above the usual size may take, so that the fits keep most of it


@dataclass(frozen=True)
class TextureSize:
    """Texture size with its reason.

    Attributes:
        size: texels along a side, of a UDIM tile where there are several.
        why: reason, in one line.
    """

    size: int
    why: str

    def line(self) -> str:
        """Return the choice as one line for the user."""
        return f"textures of {self.size} texels: {self.why}"


def check_textures(run: Path, settings: Settings) -> None:
    """Check what is known before the photographs are read: that large textures fit into memory, and all on the disk.

    Whether there is memory for smaller ones is a part of whether there is memory for the job.

    Args:
        run: run folder, which need not exist yet.
        settings: of the job.

    Raises:
        InputError: if they do not.
    """
    if settings.surface.texels > USUAL_TEXTURE:
        check_texture_memory(settings.surface.texels, 0)
    check_texture_disk_space(run, settings.surface)


def choose_texture_size(settings: Settings, data: Dataset, run: Path) -> TextureSize:
    """Choose the texture size of a job.

    Args:
        settings: of the job; a `surface.texture` that is set is taken.
        data: the photographs.
        run: run folder, which need not exist yet; its disk counts.
    """
    wanted = size_by_pixels(settings, data)
    if settings.surface.texture is not None:
        return wanted
    size, why = wanted.size, wanted.why
    while size > SMALLEST and (lack := _lack(with_texture_size(settings, size), data, run)):
        why, size = f"{wanted.why}, but {size} would take too much {lack}", size // 2
    return TextureSize(size, why)


def size_by_pixels(settings: Settings, data: Dataset) -> TextureSize:
    """Return the texture size that suits the photographs, whatever memory, disk space and time there are.

    Args:
        settings: of the job; a `surface.texture` that is set is taken.
        data: the photographs at any resolution.
    """
    surface = settings.surface
    if surface.texture is not None:
        return TextureSize(surface.texture, "as set")
    if surface.albedo_detail == "off":
        return TextureSize(surface.texture_least, "without detail of the full-size photographs")
    if not may_take_detail(settings, data):
        return TextureSize(surface.texture_least, "the photographs are not larger than data.resolution and not finer than the Gaussians")
    pixels = data.outline_pixels * data.reduction**2
    about = f"about {pixels:,.0f} pixels of a full-size photograph show the object"
    return TextureSize(texels_along(surface, pixels), about)


def _lack(settings: Settings, data: Dataset, run: Path) -> str:
    """Return what the textures of a job would take too much of; empty where they fit."""
    if texture_memory(settings.surface.texels, data.pixels(), data.full_size_pixels) - resident_memory() > USABLE * free_memory().size:
        return "memory"
    if estimate_disk_space(settings, data.pixels(distorted=True)) > USABLE * free_disk_space(run):
        return "disk space"
    if settings.time is not None and larger_texture_seconds(settings) > TIME_FRACTION * settings.time:
        return "of the time budget"
    return ""
