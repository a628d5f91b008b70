# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstruction, the result of a stage: Gaussians and environment map, with their relation to the dataset's frame."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
import torch

from ..errors import InputError
from ..io.atomic import atomic_file, write_atomic
from ..io.exr import read_exr_rgb, rgb_channels, write_exr
from ..io.npz import read_arrays
from ..settings.schema import Brdf
from .dataset import Bound
from .gaussians import Gaussians, load_surfels, save_gaussians
from .gbuffer import SurfaceSamples


@dataclass(frozen=True, eq=False)
class Reflections:
    """Materials and light that the reflections in the radiance of a reconstruction with split-sum were fitted with.

    Attributes:
        material: (5, N) albedo, roughness, metallic in 0..1 of each surfel.
        environment: (H, W, 3) float32 linear radiance, lat-long.
    """

    material: torch.Tensor
    environment: torch.Tensor

    def save(self, path: Path) -> None:
        """Write an .npz atomically."""
        with atomic_file(path) as partial:
            np.savez(partial, material=self.material.detach().cpu().numpy(), environment=self.environment.detach().cpu().numpy())

    @classmethod
    def load(cls, path: Path, count: int) -> Reflections:
        """Read the .npz that `save` wrote.

        Args:
            path: the .npz.
            count: number of surfels of the reconstruction.

        Raises:
            InputError: if the file is missing or broken, or belongs to other surfels.
        """
        material, environment = read_arrays(path, "material", "environment")
        if material.dtype.kind != "f" or environment.dtype.kind != "f":
            raise InputError(path, f"holds arrays of {material.dtype} and {environment.dtype} instead of floats")
        material, environment = material.astype(np.float32), environment.astype(np.float32)
        if material.shape != (5, count) or environment.ndim != 3 or environment.shape[-1] != 3 or not environment.size:
            shapes = f"holds arrays of shapes {material.shape} and {environment.shape}"
            raise InputError(path, f"{shapes} instead of the materials of {count} surfels and a light")
        if not ((material >= 0) & (material <= 1)).all() or not (np.isfinite(environment) & (environment >= 0)).all():
            raise InputError(path, "holds materials outside 0..1, or a light that is negative or not finite")
        return cls(torch.from_numpy(material), torch.from_numpy(environment))


@dataclass
class Reconstruction:
    """Object as 2D Gaussians under a distant light.

    Attributes:
        gaussians: the surfels.
        environment: (H, W, 3) float32 linear radiance, lat-long.
        bound: bounding sphere of the object.
        to_world: (4, 4) similarity from the dataset's own frame to the world.
        has_split_sum: True if SH hold the diffuse radiance and deferred split-sum adds the reflections; False if they hold all radiance.
        background: (H, W, 3) linear lat-long image behind the object, or None where the photographs were masked.
        reflections: materials and light of the reflections in the radiance, where they differ from the surfels' and from `environment`.
        confidence: (3, N) float32 of each surfel's albedo, roughness and metallic, in 0..1: how well the photographs bear them out, see
            `core/stages/second/refinement/material_confidence.py`; None where it was not measured.
        brdf: reflectance model that the materials belong to: they were fitted with it, and are relit with it.
        relief: how much of the fine variation of radiance is relief and not paint, 0..1, median over the surface; None where it is unknown.
    """

    gaussians: Gaussians
    environment: torch.Tensor
    bound: Bound
    to_world: np.ndarray
    has_split_sum: bool = False
    background: torch.Tensor | None = None
    reflections: Reflections | None = None
    confidence: torch.Tensor | None = None
    brdf: Brdf = "principled"
    relief: float | None = None

    def environment_map(self) -> np.ndarray:
        """Return the light as a numpy array (H, W, 3) float32."""
        return self.environment.detach().cpu().numpy()

    def to(self, device: torch.device | str) -> Reconstruction:
        """Return the reconstruction on a device."""
        own = self.reflections
        reflections = None if own is None else Reflections(own.material.to(device), own.environment.to(device))
        background = None if self.background is None else self.background.to(device)
        confidence = None if self.confidence is None else self.confidence.to(device)
        moved = {"background": background, "reflections": reflections, "confidence": confidence}
        return replace(self, gaussians=self.gaussians.to(device), environment=self.environment.to(device), **moved)

    def surface_samples(self) -> SurfaceSamples:
        """Return the surfels as surface points with materials."""
        return self.gaussians.samples()

    def mirrored(self) -> Reflections | None:
        """Return the materials and light of the reflections that are added to the SH; None if the SH hold all radiance."""
        if not self.has_split_sum:
            return None
        return self.reflections or Reflections(self.gaussians.materials().detach(), self.environment)

    def relabelled(self, material: torch.Tensor, environment: torch.Tensor) -> Reconstruction:
        """Return the same geometry and radiance with other materials, of unknown confidence, and another light.

        Args:
            material: (5, N) logits of albedo, roughness, metallic.
            environment: (H, W, 3) linear radiance, lat-long.
        """
        gaussians = replace(self.gaussians, material=material)
        return replace(self, gaussians=gaussians, environment=environment, reflections=self.mirrored(), confidence=None)

    def save(self, folder: Path) -> None:
        """Write gaussians.ply, environment.exr, reconstruction.json, and background.exr and reflections.npz where needed, each atomically.

        The folder is created if it does not exist.
        """
        folder.mkdir(parents=True, exist_ok=True)
        save_gaussians(self.gaussians, folder / "gaussians.ply", self.confidence)
        write_exr(folder / "environment.exr", rgb_channels(self.environment_map()))
        if self.background is not None:
            write_exr(folder / "background.exr", rgb_channels(self.background.detach().cpu().numpy()))
        if self.reflections is not None:
            self.reflections.save(folder / "reflections.npz")
        frame = {"bound": asdict(self.bound), "to_world": self.to_world.tolist()}
        about = {
            **frame,
            "glossy": self.has_split_sum,
            "background": self.background is not None,
            "reflections": self.reflections is not None,
            "brdf": self.brdf,
            "relief": self.relief,
        }
        write_atomic(folder / "reconstruction.json", json.dumps(about, indent=1).encode())

    @classmethod
    def load(cls, folder: Path) -> Reconstruction:
        """Read the reconstruction of a run folder.

        Raises:
            InputError: if a file is missing or broken.
        """
        path = folder / "reconstruction.json"
        try:
            about = json.loads(path.read_text("utf-8"))
            x, y, z = (float(c) for c in about["bound"]["centre"])
            floor = about["bound"].get("floor")  # runs of earlier versions have none
            bound = Bound((x, y, z), float(about["bound"]["radius"]), None if floor is None else float(floor))
            to_world, has_split_sum = np.array(about["to_world"], float).reshape(4, 4), bool(about["glossy"])
            has_background, has_reflections = bool(about["background"]), bool(about["reflections"])
            brdf = about.get("brdf", "principled")  # runs of earlier versions have no other
            relief = None if about.get("relief") is None else float(about["relief"])  # theirs is unknown
            if relief is not None and not 0 <= relief <= 1:
                raise ValueError(f"its relief is {relief}, must be 0 to 1")
        except FileNotFoundError as error:
            raise InputError(path, "no such file", "give the folder of a finished run") from error
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise InputError(path, f"not readable ({error})") from error
        if brdf not in get_args(Brdf):
            known = ", ".join(get_args(Brdf))
            raise InputError(path, f"its materials belong to the BRDF {brdf!r}, known are {known}", "open it with the version that made it")
        background = torch.from_numpy(read_exr_rgb(folder / "background.exr")) if has_background else None
        environment = torch.from_numpy(read_exr_rgb(folder / "environment.exr"))
        gaussians, confidence = load_surfels(folder / "gaussians.ply")
        reflections = Reflections.load(folder / "reflections.npz", gaussians.count) if has_reflections else None
        return cls(gaussians, environment, bound, to_world, has_split_sum, background, reflections, confidence, brdf, relief)
