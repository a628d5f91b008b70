# SPDX-License-Identifier: GPL-3.0-or-later
"""Schema of all settings and presets; `Annotated[..., Range]` and `Literal` state the allowed values."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, NamedTuple

from ..errors import InputError


class Range(NamedTuple):
    """Range of a setting: smallest and largest allowed value, both included, and the number it must be a multiple of (0: any)."""

    low: float
    high: float = float("inf")
    multiple: int = 0


MOST_TEXELS = 16384  # along a side of a texture, of all tiles together
Choice = Literal["auto", "on", "off"]
Brdf = Literal["principled", "irgs"]  # reflectance model that materials belong to, see `core/shading/brdf.py`


@dataclass(frozen=True)
class CaptureSettings:
    """Capture: bare photographs to cameras, masks and exposures."""

    features: Annotated[int, Range(200, 16384)] = 2000  # longest side of an image in which features are searched, pixels
    frames: Annotated[int, Range(3, 2000)] = 80  # sharp frames taken of each video, at most
    matching: Literal["auto", "exhaustive", "sequential"] = "auto"  # pairs of photographs; auto: above 30 photographs the similar ones
    masks: bool = True  # cut the object out where one stands apart; off: use the photographs whole, and no masks
    resolution: Annotated[int, Range(64, 4096)] = 640  # longest side of an image in which the object is cut out, pixels
    turntable: Choice = "auto"  # the object turns before a fixed camera; auto: where a background with texture stays at its pixels
    marker: Annotated[float | None, Range(1e-6)] = None  # side of the black square of an ArUco or AprilTag marker, metres
    scale: Annotated[float | None, Range(1e-9)] = None  # factor of all lengths, which are metres then; set by `capture --distance`
    # A person's sphere about the object, in the frame and units of the dataset that is written without one; both or neither.
    centre: tuple[float, float, float] | None = None  # None: the object is found by itself
    radius: Annotated[float | None, Range(1e-6)] = None


@dataclass(frozen=True)
class DataSettings:
    """Reading of the dataset."""

    resolution: Annotated[int, Range(16, 16384)] = 640  # longest side of an image, pixels; larger images are reduced
    masks: bool = True  # use alpha channels and mask files
    # Distance by which the edges of mask files may be wrong, in longest sides of an image; None: 0.003 for captures, 0 else.
    mask_error: Annotated[float | None, Range(0, 0.05)] = None
    exposure: Choice = "auto"  # divide photographs by exposure gains; auto: where unused points then agree better
    # camera: it moves with the camera, as a flash does, or the lights of a turntable; auto: where the masked photographs look like that
    light: Literal["auto", "still", "camera"] = "auto"
    holdout: Annotated[int, Range(2)] = 8  # every n-th view is a test view where the dataset names no test split
    split: Literal["auto", "holdout", "published"] = "auto"  # test views: the dataset's own, every n-th, or the published benchmark's
    centre: tuple[float, float, float] | None = None  # centre of the object's bounding sphere, dataset units; None: estimated
    radius: Annotated[float | None, Range(1e-6)] = None  # radius of the object's bounding sphere, dataset units; None: estimated


@dataclass(frozen=True)
class FirstStageSettings:
    """First stage: fit 2D Gaussians, their radiance, and initial materials and light to the images."""

    iterations: Annotated[int, Range(1, 10_000_000)] = 1500  # of the optimiser, one view each; twice as many for an object of metal
    gaussians: Annotated[int, Range(16, 10_000_000)] = 120_000  # number at the start, at most; with masks also the largest number
    gaussians_per_pixel: Annotated[float, Range(0)] = 3.75  # of these, for each pixel of the object by its masks; 0: always `gaussians`
    unmasked_gaussians: Annotated[int, Range(16, 10_000_000)] = 40_000  # of these, without masks; with 0 per pixel always `gaussians`
    subpixels: Annotated[int, Range(1, 8)] = 2  # rays along each side of a pixel of all fits to images, at most (skip.subpixels)
    single_rays: Annotated[float, Range(0, 1)] = 0.4  # first part of the schedule, with one ray per pixel, which takes half the time
    stereo: Choice = "auto"  # start on the points of dense stereo; auto: where photographs agree better at their depth
    start_trials: bool = True  # with masks: trial fits decide between starts, and on metal and edges; off: start on stereo's points
    stereo_margin: Annotated[float, Range(0)] = 0.0  # without masks: dB of PSNR on held-back views by which a trial fit must be better
    normal_weight: Annotated[float, Range(0)] = 0.2  # loss weight: splatted normals agree with normals of the depth
    distortion_weight: Annotated[float, Range(0)] = 0.0  # loss weight: depth distortion (2DGS), per squared scene radius
    anchor_weight: Annotated[float, Range(0)] = 0.1  # loss weight: depth agrees with stereo's where photographs agree better there
    metal_regions: Choice = "auto"  # where points lie in layers, start as metal or a ball of it; auto: by trial fits, and by colours
    # First part of the schedule, in which normals at edges may disagree; 0: as published; None: 0 or 0.6 by trial fits.
    open_edges: Annotated[float | None, Range(0, 1)] = None
    densification: Choice = "auto"  # density control clones and splits; auto: without masks; on: with masks from half of the Gaussians
    # First part of the schedule, after which rays that reflections mirror are traced on the object itself; None: 0.4 for metal; 1:
    # never, as where the light turns.
    inter_reflections: Annotated[float | None, Range(0, 1)] = None
    mask_weight: Annotated[float, Range(0)] = 0.5  # loss weight: alpha agrees with the mask
    sh_growth: Annotated[float, Range(0, 1)] = 0.6  # fraction of the schedule after which all SH degrees (3) are in use
    light_height: Annotated[int, Range(4, 512)] = 64  # rows of the environment map
    light_smoothness: Annotated[float, Range(0)] = 1e-3  # loss weight: differences between neighbouring texels of the light
    trial_iterations: Annotated[int, Range(1)] = 250  # of each trial fit that decides between low-gloss and glossy
    trial_gaussians: Annotated[int, Range(16)] = 8_000  # of each trial fit
    trial_resolution: Annotated[int, Range(16)] = 100  # longest side of an image in a trial fit, pixels
    trial_margin: Annotated[float, Range(0)] = 0.5  # dB of PSNR on held-back views by which low-gloss or metal must be better than glossy


@dataclass(frozen=True)
class SecondStageSettings:
    """Second stage: solve the rendering equation for light and materials, with shadows and interreflections."""

    # closed: in steps of closed form on fixed geometry; joint: the paper's optimisation of everything at once; closed+joint: both.
    solver: Literal["closed", "joint", "closed+joint"] = "closed"
    joint_iterations: Annotated[int, Range(1, 1_000_000)] = 10_000  # of the joint optimisation, one view each
    # Of the joint optimisation: factor of the published learning rates of position, scale, rotation and opacity; 0: fixed, as in IRGS.
    geometry_rate: Annotated[float, Range(0)] = 0.01
    distortion_weight: Annotated[float, Range(0)] = 0.0  # of the joint optimisation: loss weight as that of the first stage
    # Of the joint optimisation; irgs: a baseline with IRGS' BRDF, without metal, from its constant materials and light.
    brdf: Brdf = "principled"
    points: Annotated[int, Range(100, 1_000_000)] = 2500  # surface points from which light and materials are solved
    views: Annotated[int, Range(3, 1000)] = 8  # images sampled per point, at most
    rows: Annotated[int, Range(4, 32, 2)] = 12  # rows of the environment map in that solve, before texels are split
    light_height: Annotated[int, Range(4, 512)] = 64  # rows of the resulting environment map
    indirect: bool = True  # trace interreflections of the object
    shadows: bool = True  # trace the object's shadows; off, and indirect off: no 2DGRT in training, for comparison
    surroundings: bool = True  # trace the table and other near surfaces of a capture, which shadow and light the object
    iterations: Annotated[int, Range(0, 1_000_000)] = 300  # of the refinement per pixel
    pixels: Annotated[int, Range(1, 1_000_000)] = 256  # shaded in each iteration of the refinement
    samples: Annotated[int, Range(3, 65536)] = 128  # light samples per shaded pixel
    sampling: Literal["mis", "stratified"] = "mis"  # of these: multiple importance sampling, or strata of the hemisphere for comparison
    radiance_iterations: Annotated[int, Range(0, 1_000_000)] = 150  # of the fit of the radiance to the aligned normals at the end
    mesh_normals: Annotated[float, Range(0, 1)] = 0.5  # fraction by which surfels are first aligned with the mesh's smoother normals
    shading_normals: Annotated[float, Range(0, 1)] = 1.0  # fraction by which surfels then follow normals that explain the shading
    normal_iterations: Annotated[int, Range(0, 1_000_000)] = 150  # of the fit of surfels to the surface's normals, except a metal's
    pool: Annotated[int, Range(1000)] = 100_000  # pixels kept in memory, from which iterations draw
    normal_rate: Annotated[float, Range(0)] = 5e-4  # learning rate of surfels' rotations, except a metal's; 0: fixed
    albedo_smoothness: Annotated[float, Range(0)] = 1.0  # loss weight: differences between neighbours of similar albedo
    roughness_smoothness: Annotated[float, Range(0)] = 0.05  # loss weight, likewise
    metallic_smoothness: Annotated[float, Range(0)] = 0.05  # loss weight, likewise
    light_smoothness: Annotated[float, Range(0)] = 5e-4  # loss weight: differences between neighbouring texels of the light
    white_balance: Annotated[float, Range(0)] = 0.0  # loss weight: tint of the mean light; 0, since highlights show the light's colour


@dataclass(frozen=True)
class SurfaceSettings:
    """Surface extraction: from rendered depth to a textured mesh."""

    voxels: Annotated[int, Range(16, 2048)] = 384  # grid cells along the longest side of the object, at most
    voxel_pixels: Annotated[float, Range(0)] = 0.6  # side of a cell in pixels of the photographs; 0: always `voxels`
    smoothing: Annotated[int, Range(0, 1000)] = 10  # smoothing passes before decimation
    normal_averages: Annotated[int, Range(0, 100)] = 5  # passes that average vertex normals with their neighbours
    fragment: Annotated[float, Range(0, 1)] = 0.03  # components below this fraction of the largest one's area are removed
    detail: Annotated[float, Range(0, 1)] = 1.0  # fraction of the usual weight of the views' normals in the normal map
    albedo_detail: Choice = "auto"  # albedo from full-size photographs; auto: where they are finer and held-back ones agree better
    triangles: Annotated[int, Range(100, 100_000_000)] = 100_000  # largest number after decimation
    triangles_per_pixel: Annotated[float, Range(0)] = 2.5  # of these, for each pixel of the object by its masks; 0: always `triangles`
    unmasked_triangles: Annotated[int, Range(100, 100_000_000)] = 40_000  # of these, without masks; with 0 per pixel always `triangles`
    # Texels along a side of each texture; None: by the pixels of the full-size photographs that show the object, within the two below.
    texture: Annotated[int | None, Range(16, MOST_TEXELS)] = None
    texture_least: Annotated[int, Range(16, MOST_TEXELS)] = 1024  # also where the photographs are no larger than the working resolution
    texture_most: Annotated[int, Range(16, MOST_TEXELS)] = 4096
    # UDIM tiles along a side, of which each texture then has `texture` texels; no chart crosses the border of a tile.
    udim_tiles: Annotated[int, Range(1, 4)] = 1
    texture_bits: Literal[8, 16] = 8  # of each value of albedo, roughness, metallic and normal

    @property
    def tile_texels(self) -> int:
        """Texels along a side of each tile of a texture; the least number where none is chosen yet."""
        return self.texture_least if self.texture is None else self.texture

    @property
    def texels(self) -> int:
        """Texels along a side of each texture, of all tiles together."""
        return self.udim_tiles * self.tile_texels


@dataclass(frozen=True)
class ExportSettings:
    """Export to Blender."""

    material: Literal["textures", "attributes"] = "textures"  # source of the material's values in scene.blend


@dataclass(frozen=True)
class SkipSettings:
    """Skip rules: work that a scene may not need. "auto" decides by measurements on the scene, which run.json records."""

    background: Choice = "auto"  # first stage: pixels that show the object in no image
    trials: Choice = "auto"  # first stage: the rest of a trial fit whose material class has fallen behind
    subpixels: Choice = "auto"  # all fits to images: rays beyond one per pixel, where surfels are larger than pixels
    cache_hits: Choice = "auto"  # refinement: compute each pixel's surfels and their layout once, since geometry is frozen
    reuse_visibility: Choice = "auto"  # relighting: shadow rays where others of the same patch met nothing
    cache_rays: Choice = "auto"  # relighting: keep ray hits and the pixel filter for the next light while the camera stays


@dataclass(frozen=True)
class Settings:
    """All settings of one job."""

    preset: Literal["draft", "balanced", "high", "paper"] = "balanced"  # preset that the settings started from
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0  # of every random number generator
    device: Literal["auto", "cpu", "cuda", "warp-cpu"] = "auto"  # warp-cpu is for tests: the GPU's kernels on the CPU, slowly
    materials: Literal["auto", "low-gloss", "glossy"] = "auto"  # material class of the object; auto: decided by trial fits
    pace: Annotated[float, Range(1e-4, 100)] = 1.0  # factor of all schedules: 0.05 shows the paper preset on a CPU
    time: Annotated[float | None, Range(1)] = None  # time budget, seconds: scales the schedules down, or up as far as that helps
    capture: CaptureSettings = field(default_factory=CaptureSettings)
    data: DataSettings = field(default_factory=DataSettings)
    first: FirstStageSettings = field(default_factory=FirstStageSettings)
    second: SecondStageSettings = field(default_factory=SecondStageSettings)
    surface: SurfaceSettings = field(default_factory=SurfaceSettings)
    export: ExportSettings = field(default_factory=ExportSettings)
    skip: SkipSettings = field(default_factory=SkipSettings)


PRESETS: dict[str, Settings] = {
    "draft": Settings(  # a quick look
        preset="draft",
        data=replace(DataSettings(), resolution=320),
        # Trial fits as short as these tell material classes apart, but neither starts nor small parts of metal.
        first=replace(
            FirstStageSettings(), iterations=400, gaussians=20_000, start_trials=False, trial_iterations=120, trial_gaussians=5_000
        ),
        second=replace(
            SecondStageSettings(), points=1000, rows=8, iterations=25, pool=20_000, radiance_iterations=30, normal_iterations=30
        ),
        surface=replace(SurfaceSettings(), voxels=128, triangles=20_000, texture_least=512, texture_most=1024),
    ),
    "balanced": Settings(),
    "high": Settings(  # detail of large photographs, for a job over night
        preset="high",
        data=replace(DataSettings(), resolution=1600),
        first=replace(FirstStageSettings(), iterations=3000, gaussians=200_000, unmasked_gaussians=200_000),
        second=replace(
            SecondStageSettings(), points=5000, rows=16, iterations=600, pool=200_000, radiance_iterations=300, normal_iterations=300
        ),
        surface=replace(SurfaceSettings(), triangles=150_000, unmasked_triangles=150_000, texture_least=4096, texture_most=8192),
    ),
    "paper": Settings(  # the published schedule, for a GPU
        preset="paper",
        data=replace(DataSettings(), resolution=800),
        first=replace(
            FirstStageSettings(),
            iterations=50_000,
            gaussians=100_000,
            gaussians_per_pixel=0.0,
            subpixels=1,
            anchor_weight=0.0,
            metal_regions="off",
            open_edges=0.0,
            densification="on",
            inter_reflections=0.4,
        ),
        # 2^18 rays per iteration, as many per pixel as in high-quality relighting
        second=replace(
            SecondStageSettings(),
            solver="joint",
            points=6000,
            views=12,
            rows=24,
            light_height=128,
            iterations=10_000,
            pixels=512,
            samples=512,
            pool=400_000,
        ),
        surface=replace(SurfaceSettings(), voxels=512, voxel_pixels=0.0, triangles=200_000, triangles_per_pixel=0.0, texture=2048),
    ),
}


def paced(settings: Settings) -> Settings:
    """Return settings whose schedules are scaled by `pace`, at least one iteration each; those of 0 iterations stay so."""
    scaled = lambda count: max(1, round(settings.pace * count)) if count else 0  # noqa: E731
    second = settings.second
    return replace(
        settings,
        first=replace(settings.first, iterations=scaled(settings.first.iterations)),
        second=replace(
            second,
            iterations=scaled(second.iterations),
            joint_iterations=scaled(second.joint_iterations),
            radiance_iterations=scaled(second.radiance_iterations),
        ),
    )


def preset(name: str) -> Settings:
    """Return the settings of a preset; raise InputError for an unknown name."""
    if name not in PRESETS:
        raise InputError(f"preset {name}", "unknown preset", f"use {', '.join(PRESETS)}")
    return PRESETS[name]
