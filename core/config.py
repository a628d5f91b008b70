# SPDX-License-Identifier: GPL-3.0-or-later
"""Every setting of the main job, in one place, and the presets."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class DataSettings:
    """How photographs are read."""

    resolution: int = 800  # longest side in pixels; larger pictures are reduced
    masks: bool = True  # use alpha channels and mask files
    holdout: int = 8  # every n-th view is a test view where the dataset names no test split
    centre: tuple[float, float, float] | None = None  # object bound in the dataset's own frame; None = estimated
    radius: float | None = None


@dataclass(frozen=True)
class ReflectiveSettings:
    """First stage."""

    iterations: int = 1200
    gaussians: int = 40_000


@dataclass(frozen=True)
class SurfaceSettings:
    """From rendered depth to a mesh with textures."""

    voxels: int = 192  # along the longest side of the object
    smoothing: int = 10  # smoothing passes before decimation
    triangles: int = 40_000  # budget after decimation
    texture: int = 1024  # texels along a side


@dataclass(frozen=True)
class ExportSettings:
    """What the Blender material reads."""

    material: str = "textures"  # "textures" | "attributes"


@dataclass(frozen=True)
class Settings:
    """All settings of one job; `preset` names the starting point."""

    preset: str = "balanced"
    seed: int = 0
    device: str = "auto"  # "auto" | "cpu" | "cuda"
    materials: str = "auto"  # "auto" | "low-gloss" | "glossy"
    data: DataSettings = field(default_factory=DataSettings)
    reflective: ReflectiveSettings = field(default_factory=ReflectiveSettings)
    surface: SurfaceSettings = field(default_factory=SurfaceSettings)
    export: ExportSettings = field(default_factory=ExportSettings)
