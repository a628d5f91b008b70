# SPDX-License-Identifier: GPL-3.0-or-later
"""Run kept in memory for rendering on request: everything that stays the same from image to image is computed once."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch

from ...errors import InputError
from ...rendering.trusted_device import trusted_device
from ...scene.camera import Camera
from ...scene.camera_files import load_run_cameras
from ...scene.environment_files import repair_environment
from ...scene.environment_map import EnvironmentMap
from ...scene.lamps import Lamp
from ...scene.reconstruction import Reconstruction
from ..backends import Backend, load_mesh_query
from ..gaussian_query import GaussianQuery
from ..ground_shadow import Plane, over_shadow, plane_surface, shadow_alpha
from ..prepared_light import PreparedLight, prepare_light
from ..primary_hits import PrimaryHits
from ..relight_settings import RelightSettings
from ..relighter import RAYS, Relighter
from ..secondary_query import Hits, SurfaceQuery

PREVIEW_SAMPLES = 8  # samples per pixel of the first images
PREVIEW_SCALE = 1 / 4  # size of the first image relative to the requested one
LIGHT_ROWS = 256  # rows of the map that lights the object; backdrops use the full resolution
MIN_PREVIEW_SIZE = 96  # pixels; images with a shorter side have no reduced first image

Value = TypeVar("Value")


@dataclass(frozen=True)
class LightSource:
    """Light map in a file, rotated and scaled as in `EnvironmentMap`, in the run's frame.

    Attributes:
        file: .npy of texels (H, W, 3); the content of a file name never changes.
        turn: (9,) row-major rotation; direction d sees the texel of turn @ d.
        strength: factor of the radiance, >= 0.
    """

    file: Path
    turn: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    strength: float = 1.0

    def upright(self) -> tuple[LightSource, float]:
        """Return the light without its rotation about +Z, and that rotation in degrees.

        The rotation is 0, and the light unchanged, where it is rotated about another axis as well.

        A light that only rotates about +Z is therefore prepared once, and its image never depends on images rendered before.
        """
        turn = np.array(self.turn).reshape(3, 3)
        if abs(turn[2, 2] - 1) > 1e-9:
            return self, 0.0
        return replace(self, turn=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)), math.degrees(math.atan2(turn[0, 1], turn[0, 0]))


@dataclass(frozen=True, eq=False)
class Request:
    """Request for an image.

    Attributes:
        camera: camera in the run's frame.
        light: light source; None is the recovered light.
        lamps: lamps that light the object as well, in the run's frame.
        backdrop: show the light behind the object as well.
        samples: see `RelightSettings`.
        denoise: apply the denoiser.
        indirect: see `RelightSettings`.
        backend: "mesh" or "gaussian".
        albedo_scale: see `RelightSettings`.
        ground: plane that receives the object's shadow, see `Plane`; None: none.
        progressive: render images of lower quality first.
    """

    camera: Camera
    light: LightSource | None = None
    lamps: tuple[Lamp, ...] = ()
    backdrop: bool = False
    samples: str | int = 32
    denoise: bool = True
    indirect: bool = True
    backend: Backend = "mesh"
    albedo_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    progressive: bool = True
    ground: Plane | None = None

    def settings(self, samples: str | int) -> RelightSettings:
        """Return the settings of the relighter for a number of samples."""
        denoise = "demodulated" if self.denoise else "off"
        return RelightSettings(samples=samples, denoise=denoise, indirect=self.indirect, albedo_scale=self.albedo_scale)

    def passes(self) -> list[tuple[Camera, str | int]]:
        """Return cameras and samples of the images to render; the last is the requested one."""
        passes: list[tuple[Camera, str | int]] = [(self.camera, self.samples)]
        above_preview = not isinstance(self.samples, int) or self.samples > PREVIEW_SAMPLES
        width, height = self.camera.width, self.camera.height
        if self.progressive and above_preview:
            passes.insert(0, (self.camera, PREVIEW_SAMPLES))
        if self.progressive and min(width, height) >= MIN_PREVIEW_SIZE:
            small = self.camera.resized(math.ceil(width * PREVIEW_SCALE), math.ceil(height * PREVIEW_SCALE))
            passes.insert(0, (small, min(self.samples, PREVIEW_SAMPLES) if isinstance(self.samples, int) else PREVIEW_SAMPLES))
        return passes


class LRUCache:
    """Cache of the values used last, by key.

    Args:
        count: largest number of values.
    """

    def __init__(self, count: int) -> None:
        self._values: OrderedDict[Hashable, object] = OrderedDict()
        self._count = count

    def get(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return the value of a key, created if it is not in the cache.

        Args:
            key: the key.
            make: creates the value.
        """
        if key not in self._values:
            value = make()  # may raise, then nothing is cached
            self._values[key] = value
            while len(self._values) > self._count:
                self._values.popitem(last=False)
        self._values.move_to_end(key)
        return self._values[key]  # type: ignore[return-value]


class LoadedRun:
    """Run with its Gaussians, mesh, prepared lights, surfaces and relighters in memory.

    Args:
        run: run folder.
        tick: called before every batch of rays with the finished fraction of the image in 0..1; it may raise to stop the image.
    """

    def __init__(self, run: Path, tick: Callable[[float], None] = lambda fraction: None) -> None:
        self._run, self._tick = run, tick
        self._device = trusted_device().device
        self.reconstruction = Reconstruction.load(run).to(self._device)
        self._mesh = load_mesh_query(run, self.reconstruction.bound.radius, self._device)
        self._gaussians: GaussianQuery | None = None
        self._grounds = LRUCache(3)  # with the surface that each is beside, so that its id stays its own
        self._maps, self._lights, self._surfaces, self._relighters = LRUCache(2), LRUCache(3), LRUCache(6), LRUCache(4)

    def image(self, request: Request, camera: Camera, samples: str | int) -> np.ndarray:
        """Render one pass of a request.

        Args:
            request: the request.
            camera: camera of the pass.
            samples: samples per pixel of the pass.

        Returns:
            (H, W, 4) float32 linear premultiplied.

        Raises:
            InputError: when the light can't be read or the mesh is missing.
        """
        settings, light = request.settings(samples), self._light(request.light)
        relighter = self._relighters.get((request.backend, settings), lambda: self._relighter(request.backend, settings))
        surface = self._surface(relighter, request, camera)
        query = relighter.query
        assert isinstance(query, ProgressQuery)
        ground = self._ground(surface, request) if request.ground is not None else None
        points = len(surface.index) + (0 if ground is None else len(ground.index))
        query.begin((2 + 2 * len(request.lamps)) * math.ceil(points / max(1, RAYS // sum(relighter.counts))))
        image = relighter.relit(surface, light, request.lamps).numpy()
        if ground is not None:
            image = over_shadow(image, shadow_alpha(relighter, ground, light, request.lamps).numpy())
        if request.backdrop and request.light is not None:
            image = self._with_backdrop(image, camera, request.light)
        return image

    def warm_up(self) -> None:
        """Render one small image, so that all kernels are compiled before the first request."""
        cameras = load_run_cameras(self._run / "cameras.json")
        if cameras:
            camera = cameras[0].camera.with_longest_side(64)
            self.image(Request(camera, backend="mesh" if self._mesh else "gaussian"), camera, PREVIEW_SAMPLES)

    def _relighter(self, backend: Backend, settings: RelightSettings) -> Relighter:
        """Create a relighter that reports its progress."""
        return Relighter(self.reconstruction, ProgressQuery(self._query(backend), self._tick), settings, self._mesh)

    def _query(self, backend: Backend) -> SurfaceQuery:
        """Return the scene for secondary rays, loaded on first use."""
        if backend == "gaussian":
            self._gaussians = self._gaussians or GaussianQuery(self.reconstruction)
            return self._gaussians
        if self._mesh is None:
            raise InputError(self._run / "mesh.ply", "is missing, but tracing on the mesh needs it", "trace on the Gaussians")
        return self._mesh

    def _surface(self, relighter: Relighter, request: Request, camera: Camera) -> PrimaryHits:
        """Return the surface of a view, cached: it does not depend on light and samples."""
        lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.to_world.tobytes())
        return self._surfaces.get((*lens, request.backend, request.albedo_scale), lambda: relighter.surface(camera))

    def _ground(self, surface: PrimaryHits, request: Request) -> PrimaryHits:
        """Return the plane beside a view's surface, cached with it."""
        assert request.ground is not None
        plane, bound = request.ground, self.reconstruction.bound
        return self._grounds.get(
            (id(surface), plane), lambda: (surface, plane_surface(plane, surface.camera, surface.coverage, bound.centre, bound.radius))
        )[1]

    def _light(self, source: LightSource | None) -> PreparedLight:
        """Return a prepared light, cached."""
        if source is None:
            return self._lights.get(None, lambda: prepare_light(self.reconstruction.environment_map(), self._device))
        upright, degrees = source.upright()
        return self._lights.get(upright, lambda: prepare_light(self._map(upright).image(LIGHT_ROWS), self._device)).turned(degrees)

    def _map(self, source: LightSource) -> EnvironmentMap:
        """Return a light as an environment map with cached texels."""
        texels = self._maps.get(source.file, lambda: _read_map(source.file))
        return EnvironmentMap(texels, np.array(source.turn).reshape(3, 3), source.strength)

    def _with_backdrop(self, image: np.ndarray, camera: Camera, source: LightSource) -> np.ndarray:
        """Composite an image (H, W, 4) over the light behind the object; the result is opaque."""
        behind = self._map(source).radiance(camera.rays())
        colour = image[..., :3] + (1 - image[..., 3:]) * behind
        return np.concatenate([colour, np.ones_like(image[..., 3:])], -1).astype(np.float32)


class ProgressQuery:
    """Wrapper of a `SurfaceQuery` that reports the fraction of the expected calls, by a callback that may raise to stop the work.

    Args:
        query: the wrapped query.
        tick: called with the fraction in 0..1 before each call.
    """

    def __init__(self, query: SurfaceQuery, tick: Callable[[float], None]) -> None:
        self._query, self._tick, self._calls, self._expected = query, tick, 0, 1

    def begin(self, expected: int) -> None:
        """Start an image for which a number of calls is expected."""
        self._calls, self._expected = 0, max(1, expected)

    def origins(self, surface: PrimaryHits) -> torch.Tensor:
        """Return ray origins (P, 3) above a surface, see `SurfaceQuery`."""
        return self._query.origins(surface)

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """Return the hits of rays, see `SurfaceQuery`.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.
        """
        self._count()
        return self._query.hits(origin, direction)

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor, reach: torch.Tensor | None = None) -> torch.Tensor:
        """Return the occlusion (R,) of rays, see `SurfaceQuery`.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.
            reach: (R,) distances up to which occluders count, float32; None: all occluders.
        """
        self._count()
        return self._query.hidden(origin, direction, reach)

    def _count(self) -> None:
        """Report and count one call."""
        self._tick(min(1.0, self._calls / self._expected))
        self._calls += 1


def _read_map(file: Path) -> np.ndarray:
    """Read an .npy of texels (H, W, 3); invalid values are repaired, but a black map stays black."""
    try:
        light = np.load(file, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(file, f"the light map can't be read ({error})") from error
    if light.ndim != 3 or light.shape[-1] != 3 or not light.size or light.dtype.kind != "f":
        raise InputError(file, f"must hold a float light map (H, W, 3), found {light.dtype} {light.shape}")
    light = light.astype(np.float32)
    return light if not light.any() else repair_environment(light, file)[0]
