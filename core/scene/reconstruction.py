# SPDX-License-Identifier: GPL-3.0-or-later
"""What a stage hands on: Gaussians, light, and how they relate to the dataset."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

from ..errors import InputError
from ..io.atomic import atomic_file, write_atomic
from ..io.exr import read_exr_rgb, rgb_channels, write_exr
from ..io.npz import read_arrays
from .dataset import Bound
from .gaussians import Gaussians, load_gaussians, save_gaussians
from .gbuffer import SurfaceSamples


@dataclass(frozen=True, eq=False)
class Reflections:
    """What the radiance of a glossy reconstruction reflects: the materials and the light that it was fitted with.

    Attributes:
        material: (5, N) albedo, roughness, metallic in 0..1 of each disk.
        environment: (H, W, 3) float32 linear radiance, lat-long.
    """

    material: torch.Tensor
    environment: torch.Tensor

    def save(self, path: Path) -> None:
        """Write an .npz in one step."""
        with atomic_file(path) as partial:
            np.savez(partial, material=self.material.detach().cpu().numpy(), environment=self.environment.detach().cpu().numpy())

    @classmethod
    def load(cls, path: Path, count: int) -> Reflections:
        """Read them for so many surfels. Raises InputError where the file is missing, broken or of other surfels."""
        material, environment = read_arrays(path, "material", "environment")
        if material.dtype.kind != "f" or environment.dtype.kind != "f":
            raise InputError(path, f"holds {material.dtype} and {environment.dtype} instead of numbers")
        material, environment = material.astype(np.float32), environment.astype(np.float32)
        if material.shape != (5, count) or environment.ndim != 3 or environment.shape[-1] != 3 or not environment.size:
            raise InputError(path, f"holds no materials of {count} surfels and a light, but {material.shape} and {environment.shape}")
        if not ((material >= 0) & (material <= 1)).all() or not (np.isfinite(environment) & (environment >= 0)).all():
            raise InputError(path, "holds materials outside 0..1, or a light that is negative or not finite")
        return cls(torch.from_numpy(material), torch.from_numpy(environment))


@dataclass
class Reconstruction:
    """An object as 2D Gaussians under a distant light.

    Attributes:
        gaussians: the surfels.
        environment: (H, W, 3) float32 linear radiance, lat-long.
        bound: sphere around the object.
        to_world: (4, 4) similarity from the dataset's own frame to ours.
        glossy: True where the SH hold the diffuse radiance and the deferred split-sum adds the reflections; False where they hold it all.
        background: (H, W, 3) linear lat-long image behind everything, or None where the photographs were masked.
        reflections: what the radiance reflects where that is not the surfels' materials and the light themselves.
    """

    gaussians: Gaussians
    environment: torch.Tensor
    bound: Bound
    to_world: np.ndarray
    glossy: bool = False
    background: torch.Tensor | None = None
    reflections: Reflections | None = None

    def environment_map(self) -> np.ndarray:
        """The light as (H, W, 3) float32 numpy."""
        return self.environment.detach().cpu().numpy()

    def to(self, device: torch.device | str) -> Reconstruction:
        """The same on a device."""
        kept = self.reflections
        reflections = None if kept is None else Reflections(kept.material.to(device), kept.environment.to(device))
        background = None if self.background is None else self.background.to(device)
        on_device = (self.gaussians.to(device), self.environment.to(device))
        return replace(self, gaussians=on_device[0], environment=on_device[1], background=background, reflections=reflections)

    def surface_samples(self) -> SurfaceSamples:
        """The surfels as surface points with materials."""
        return self.gaussians.samples()

    def mirrored(self) -> Reflections | None:
        """What is added to the SH as reflection; None where they hold all radiance."""
        if not self.glossy:
            return None
        return self.reflections or Reflections(self.gaussians.materials().detach(), self.environment)

    def relabelled(self, material: torch.Tensor, environment: torch.Tensor) -> Reconstruction:
        """The same geometry and radiance with other materials (5, N), logits, and under another light (H, W, 3)."""
        gaussians = replace(self.gaussians, material=material)
        return replace(self, gaussians=gaussians, environment=environment, reflections=self.mirrored())

    def save(self, folder: Path) -> None:
        """Write gaussians.ply, environment.exr, reconstruction.json, and background.exr and reflections.npz where needed; each in one step.

        The folder is made where there is none.
        """
        folder.mkdir(parents=True, exist_ok=True)
        save_gaussians(self.gaussians, folder / "gaussians.ply")
        write_exr(folder / "environment.exr", rgb_channels(self.environment_map()))
        if self.background is not None:
            write_exr(folder / "background.exr", rgb_channels(self.background.detach().cpu().numpy()))
        if self.reflections is not None:
            self.reflections.save(folder / "reflections.npz")
        frame = {"bound": asdict(self.bound), "to_world": self.to_world.tolist()}
        about = {**frame, "glossy": self.glossy, "background": self.background is not None, "reflections": self.reflections is not None}
        write_atomic(folder / "reconstruction.json", json.dumps(about, indent=1).encode())

    @classmethod
    def load(cls, folder: Path) -> Reconstruction:
        """Read a run folder. Raises InputError where a file is missing or broken."""
        path = folder / "reconstruction.json"
        try:
            about = json.loads(path.read_text("utf-8"))
            x, y, z = (float(c) for c in about["bound"]["centre"])
            bound = Bound((x, y, z), float(about["bound"]["radius"]))
            to_world, glossy = np.array(about["to_world"], float).reshape(4, 4), bool(about["glossy"])
            has_background, has_reflections = bool(about["background"]), bool(about["reflections"])
        except FileNotFoundError as error:
            raise InputError(path, "there is no such file", "is this a finished run folder?") from error
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise InputError(path, f"not readable ({error})") from error
        background = torch.from_numpy(read_exr_rgb(folder / "background.exr")) if has_background else None
        environment = torch.from_numpy(read_exr_rgb(folder / "environment.exr"))
        gaussians = load_gaussians(folder / "gaussians.ply")
        reflections = Reflections.load(folder / "reflections.npz", gaussians.count) if has_reflections else None
        return cls(gaussians, environment, bound, to_world, glossy, background, reflections)
