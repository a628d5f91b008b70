# SPDX-License-Identifier: GPL-3.0-or-later
"""Every setting of the main job and the presets; `Annotated[..., Range]` and `Literal` say what is allowed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, NamedTuple

from ..errors import InputError


class Range(NamedTuple):
    """Smallest and largest allowed value of a setting, both included, and what it must be a multiple of (0: of nothing)."""

    low: float
    high: float = float("inf")
    multiple: int = 0


@dataclass(frozen=True)
class DataSettings:
    """How photographs are read."""

    resolution: Annotated[int, Range(16, 16384)] = 640  # longest side in pixels; larger images are reduced
    masks: bool = True  # use alpha channels and mask files
    holdout: Annotated[int, Range(2)] = 8  # every n-th view is a test view where the dataset names no test split
    split: Literal["auto", "holdout", "published"] = "auto"  # test views: the files', every n-th, the paper's
    centre: tuple[float, float, float] | None = None  # object bound in the dataset's own frame; None = estimated
    radius: Annotated[float | None, Range(1e-6)] = None


@dataclass(frozen=True)
class FirstStageSettings:
    """First stage."""

    iterations: Annotated[int, Range(1, 10_000_000)] = 1500
    gaussians: Annotated[int, Range(16, 10_000_000)] = 40_000  # of the start; with masks there are never more
    normal_weight: Annotated[float, Range(0)] = 0.2  # agreement of splatted normals with those of the depth
    mask_weight: Annotated[float, Range(0)] = 0.5
    sh_growth: Annotated[float, Range(0, 1)] = 0.6  # share of the schedule after which all SH degrees are in use
    light_height: Annotated[int, Range(4, 512)] = 64  # rows of the light map
    light_smoothness: Annotated[float, Range(0)] = 1e-3
    trial_iterations: Annotated[int, Range(1)] = 250  # of each fit that decides between low-gloss and glossy
    trial_gaussians: Annotated[int, Range(16)] = 8_000
    trial_resolution: Annotated[int, Range(16)] = 100  # pixels along the longest side
    trial_margin: Annotated[float, Range(0)] = 0.5  # dB by which a more reflecting kind must explain held-back views better


@dataclass(frozen=True)
class SecondStageSettings:
    """Second stage: light and materials told apart, with shadows and what the object reflects onto itself."""

    points: Annotated[int, Range(100, 1_000_000)] = 2500  # of the surface, which the light is found from
    views: Annotated[int, Range(3, 1000)] = 8  # photographs of each point, at most
    rows: Annotated[int, Range(4, 32, 2)] = 16  # of the light while it is told from the albedo
    light_height: Annotated[int, Range(4, 512)] = 64  # rows of the light map that comes out
    indirect: bool = True  # what the object reflects onto itself; it always casts shadows
    iterations: Annotated[int, Range(0, 1_000_000)] = 300  # of the refinement pixel by pixel
    pixels: Annotated[int, Range(1, 1_000_000)] = 256  # shaded in each
    samples: Annotated[int, Range(3, 65536)] = 128  # of light at each pixel
    sampling: Literal["mis", "stratified"] = "mis"  # how they are drawn; plain strata of the hemisphere are for comparison
    radiance_iterations: Annotated[int, Range(0, 1_000_000)] = 150  # that fit the radiance to the normals again
    mesh_normals: Annotated[float, Range(0, 1)] = 0.5  # how far disks are turned to the mesh, whose normals are smoother, beforehand
    pool: Annotated[int, Range(1000)] = 100_000  # pixels that are kept at hand
    normal_rate: Annotated[float, Range(0)] = 5e-4  # how fast disks turn, except a metal's; 0 = not at all
    albedo_smoothness: Annotated[float, Range(0)] = 0.02  # among neighbours of like albedo
    roughness_smoothness: Annotated[float, Range(0)] = 0.05
    metallic_smoothness: Annotated[float, Range(0)] = 0.05
    light_smoothness: Annotated[float, Range(0)] = 5e-4
    white_balance: Annotated[float, Range(0)] = 0.0  # how much coloured light is mistrusted: gloss shows its colour, so not at all


@dataclass(frozen=True)
class SurfaceSettings:
    """From rendered depth to a mesh with textures."""

    voxels: Annotated[int, Range(16, 2048)] = 192  # along the longest side of the object
    smoothing: Annotated[int, Range(0, 1000)] = 10  # smoothing passes before decimation
    normal_averages: Annotated[int, Range(0, 100)] = 5  # how often vertex normals are averaged with their neighbours
    fragment: Annotated[float, Range(0, 1)] = 0.03  # components with less than this share of the largest one's area are dropped
    detail: Annotated[float, Range(0, 1)] = 1.0  # how much of the views' normals, where they stand out of their noise, is kept
    triangles: Annotated[int, Range(100, 100_000_000)] = 40_000  # budget after decimation
    texture: Annotated[int, Range(16, 16384)] = 1024  # texels along a side


@dataclass(frozen=True)
class ExportSettings:
    """What the Blender material reads."""

    material: Literal["textures", "attributes"] = "textures"


Choice = Literal["auto", "on", "off"]


@dataclass(frozen=True)
class SkipSettings:
    """What a scene may not need, rule by rule: "auto" decides by what is found on the scene; run.json has it for a reconstruction's."""

    background: Choice = "auto"  # pixels where no photograph shows the object, while its shape is found
    trials: Choice = "auto"  # the rest of a trial of a kind of material that has fallen behind
    cache_hits: Choice = "auto"  # what frozen geometry leaves the same in each step of the refinement: the disks of a pixel, their layout
    reuse_visibility: Choice = "auto"  # in relighting: rays towards the light where others of the same patch met nothing
    cache_rays: Choice = "auto"  # in relighting: what rays met and how pixels are filtered, for the next light on an unmoved camera


@dataclass(frozen=True)
class Settings:
    """All settings of one job; `preset` names the starting point."""

    preset: Literal["draft", "balanced", "paper"] = "balanced"
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    device: Literal["auto", "cpu", "cuda", "warp-cpu"] = "auto"  # the last is for tests: the GPU's kernels on the CPU, slowly
    materials: Literal["auto", "low-gloss", "glossy"] = "auto"
    time: Annotated[float | None, Range(1)] = None  # seconds the job may take; schedules are as short as that asks, or as long as helps
    data: DataSettings = field(default_factory=DataSettings)
    first: FirstStageSettings = field(default_factory=FirstStageSettings)
    second: SecondStageSettings = field(default_factory=SecondStageSettings)
    surface: SurfaceSettings = field(default_factory=SurfaceSettings)
    export: ExportSettings = field(default_factory=ExportSettings)
    skip: SkipSettings = field(default_factory=SkipSettings)


PRESETS: dict[str, Settings] = {
    "draft": Settings(  # a look
        preset="draft",
        data=replace(DataSettings(), resolution=320),
        first=replace(FirstStageSettings(), iterations=400, gaussians=30_000, trial_iterations=120, trial_gaussians=5_000),
        second=replace(SecondStageSettings(), points=1500),
        surface=replace(SurfaceSettings(), voxels=128, triangles=20_000, texture=512),
    ),
    "balanced": Settings(),
    "paper": Settings(  # the published schedule, for a GPU
        preset="paper",
        data=replace(DataSettings(), resolution=800),
        first=replace(FirstStageSettings(), iterations=50_000, gaussians=100_000),
        # 2^18 rays an iteration, as many from each pixel as in relighting of high quality
        second=replace(
            SecondStageSettings(),
            points=6000,
            views=12,
            rows=24,
            light_height=128,
            iterations=10_000,
            pixels=512,
            samples=512,
            pool=400_000,
        ),
        surface=replace(SurfaceSettings(), voxels=512, triangles=200_000, texture=2048),
    ),
}


def preset(name: str) -> Settings:
    """The settings of a preset. Raises InputError for an unknown name."""
    if name not in PRESETS:
        raise InputError(f"preset {name}", "there is none of that name", f"use {', '.join(PRESETS)}")
    return PRESETS[name]
