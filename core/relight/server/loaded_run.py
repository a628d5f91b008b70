# SPDX-License-Identifier: GPL-3.0-or-later
"""A run kept in memory for images on demand: what does not change from one to the next is computed once."""

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
from ...machine.devices import best
from ...scene.camera import Camera
from ...scene.camera_files import load_run_cameras
from ...scene.environment_files import repaired
from ...scene.environment_map import EnvironmentMap
from ...scene.mesh_ply import load_mesh_ply
from ...scene.reconstruction import Reconstruction
from ..backends import Backend
from ..gaussian_query import GaussianQuery
from ..mesh_query import MeshQuery
from ..prepared_light import PreparedLight, prepare
from ..primary_hits import PrimaryHits
from ..relighter import RAYS, Relighter, RelightSettings
from ..secondary_query import Hits, SurfaceQuery

QUICK = 8  # samples of a first image
SMALL = 1 / 4  # its size
LIGHT_ROWS = 256  # of the map that lights the object; backdrops are sharper
SMALLEST = 96  # pixels; shorter sides are not reduced

Value = TypeVar("Value")


@dataclass(frozen=True)
class LightSource:
    """An .npy of texels, turned and scaled as in `LightMap`; in the run's frame. A file's name stands for what it holds."""

    file: Path
    turn: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    strength: float = 1.0

    def upright(self) -> tuple[LightSource, float]:
        """The same before it was turned about +Z, and by how many degrees it was; 0 where it was turned otherwise as well.

        So a light that is only turned about +Z is prepared once, and its image never depends on what was shown before.
        """
        turn = np.array(self.turn).reshape(3, 3)
        if abs(turn[2, 2] - 1) > 1e-9:
            return self, 0.0
        return replace(self, turn=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)), math.degrees(math.atan2(turn[0, 1], turn[0, 0]))


@dataclass(frozen=True, eq=False)
class Request:
    """An image that is wanted.

    Attributes:
        camera: in the run's frame. light: None is the recovered one. backdrop: show the light behind the object as well.
        samples, denoise, indirect, albedo_scale: see `RelightSettings`. backend: "mesh" or "gaussian".
        progressive: images of lower quality first.
    """

    camera: Camera
    light: LightSource | None = None
    backdrop: bool = False
    samples: str | int = 32
    denoise: bool = True
    indirect: bool = True
    backend: Backend = "mesh"
    albedo_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    progressive: bool = True

    def settings(self, samples: str | int) -> RelightSettings:
        """Those of the relighter."""
        denoise = "demodulated" if self.denoise else "off"
        return RelightSettings(samples=samples, denoise=denoise, indirect=self.indirect, albedo_scale=self.albedo_scale)

    def passes(self) -> list[tuple[Camera, str | int]]:
        """Cameras and samples of the images to make, the last as it is wanted."""
        wanted: list[tuple[Camera, str | int]] = [(self.camera, self.samples)]
        many = not isinstance(self.samples, int) or self.samples > QUICK
        width, height = self.camera.width, self.camera.height
        if self.progressive and many:
            wanted.insert(0, (self.camera, QUICK))
        if self.progressive and min(width, height) >= SMALLEST:
            small = self.camera.resized(math.ceil(width * SMALL), math.ceil(height * SMALL))
            wanted.insert(0, (small, min(self.samples, QUICK) if isinstance(self.samples, int) else QUICK))
        return wanted


class Latest:
    """The values used last, a few of them, by key."""

    def __init__(self, count: int) -> None:
        self._values: OrderedDict[Hashable, object] = OrderedDict()
        self._count = count

    def get(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """The value of a key, made where it is not there."""
        if key not in self._values:
            value = make()  # may raise, then nothing is kept
            self._values[key] = value
            while len(self._values) > self._count:
                self._values.popitem(last=False)
        self._values.move_to_end(key)
        return self._values[key]  # type: ignore[return-value]


class LoadedRun:
    """A loaded run.

    Args:
        run: its folder. tick: called before every chunk of rays with the share of the image that is done; it may raise to stop.
    """

    def __init__(self, run: Path, tick: Callable[[float], None] = lambda share: None) -> None:
        self._run, self._tick = run, tick
        self._device = best()
        self.reconstruction = Reconstruction.load(run).to(self._device)
        file = run / "mesh.ply"
        self._mesh = MeshQuery(load_mesh_ply(file), self.reconstruction.bound.radius, self._device) if file.is_file() else None
        self._gaussians: GaussianQuery | None = None
        self._maps, self._lights, self._surfaces, self._relighters = Latest(2), Latest(3), Latest(6), Latest(4)

    def image(self, request: Request, camera: Camera, samples: str | int) -> np.ndarray:
        """(H, W, 4) float32 linear premultiplied. Raises InputError where the light can't be read or the mesh is missing."""
        settings = request.settings(samples)
        light = self._light(request.light)
        relighter = self._relighters.get((request.backend, settings), lambda: self._relighter(request.backend, settings))
        surface = self._surface(relighter, request, camera)
        counted = relighter.query
        assert isinstance(counted, Counted)
        counted.begin(2 * math.ceil(len(surface.index) / max(1, RAYS // sum(relighter.counts))))
        image = relighter.relit(surface, light).numpy()
        if request.backdrop and request.light is not None:
            image = self._with_backdrop(image, camera, request.light)
        return image

    def warm_up(self) -> None:
        """One small image, so that the first that is asked for finds every kernel compiled."""
        cameras = load_run_cameras(self._run / "cameras.json")
        if cameras:
            first = cameras[0].camera
            scale = 64 / max(first.width, first.height)
            camera = first.resized(max(1, round(first.width * scale)), max(1, round(first.height * scale)))
            self.image(Request(camera, backend="mesh" if self._mesh else "gaussian"), camera, QUICK)

    def _relighter(self, backend: Backend, settings: RelightSettings) -> Relighter:
        return Relighter(self.reconstruction, Counted(self._query(backend), self._tick), settings, self._mesh)

    def _query(self, backend: Backend) -> SurfaceQuery:
        if backend == "gaussian":
            self._gaussians = self._gaussians or GaussianQuery(self.reconstruction)
            return self._gaussians
        if self._mesh is None:
            raise InputError(self._run / "mesh.ply", "is missing, which tracing on the mesh needs", "trace on the Gaussians")
        return self._mesh

    def _surface(self, relighter: Relighter, request: Request, camera: Camera) -> PrimaryHits:
        """Kept for the same view: it does not depend on light and samples."""
        lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.to_world.tobytes())
        return self._surfaces.get((*lens, request.backend, request.albedo_scale), lambda: relighter.surface(camera))

    def _light(self, source: LightSource | None) -> PreparedLight:
        if source is None:
            return self._lights.get(None, lambda: prepare(self.reconstruction.environment_map(), self._device))
        upright, degrees = source.upright()
        return self._lights.get(upright, lambda: prepare(self._map(upright).image(LIGHT_ROWS), self._device)).turned(degrees)

    def _map(self, source: LightSource) -> EnvironmentMap:
        texels = self._maps.get(source.file, lambda: _read_map(source.file))
        return EnvironmentMap(texels, np.array(source.turn).reshape(3, 3), source.strength)

    def _with_backdrop(self, image: np.ndarray, camera: Camera, source: LightSource) -> np.ndarray:
        """The light itself where the object lets it through; opaque."""
        behind = self._map(source).radiance(camera.rays())
        colour = image[..., :3] + (1 - image[..., 3:]) * behind
        return np.concatenate([colour, np.ones_like(image[..., 3:])], -1).astype(np.float32)


class Counted:
    """A `SurfaceQuery` that tells how many of the expected questions were asked; that may stop the work."""

    def __init__(self, query: SurfaceQuery, tick: Callable[[float], None]) -> None:
        self._query, self._tick, self._asked, self._expected = query, tick, 0, 1

    def begin(self, expected: int) -> None:
        """An image begins for which so many questions are expected."""
        self._asked, self._expected = 0, max(1, expected)

    def origins(self, surface: PrimaryHits) -> torch.Tensor:
        """See `SurfaceQuery`."""
        return self._query.origins(surface)

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """See `SurfaceQuery`."""
        self._count()
        return self._query.hits(origin, direction)

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """See `SurfaceQuery`."""
        self._count()
        return self._query.hidden(origin, direction)

    def _count(self) -> None:
        self._tick(min(1.0, self._asked / self._expected))
        self._asked += 1


def _read_map(file: Path) -> np.ndarray:
    """(H, W, 3) of an .npy; values that are no light are repaired, but black stays black."""
    try:
        light = np.load(file, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(file, f"the light map can't be read ({error})") from error
    if light.ndim != 3 or light.shape[-1] != 3 or not light.size or light.dtype.kind != "f":
        raise InputError(file, f"holds no light map (H, W, 3) but {light.dtype} {light.shape}")
    light = light.astype(np.float32)
    return light if not light.any() else repaired(light, file)[0]
