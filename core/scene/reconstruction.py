# SPDX-License-Identifier: GPL-3.0-or-later
"""What a stage hands on: Gaussians, light, and how they relate to the dataset."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from ..datasets.dataset import Bound
from ..errors import InputError
from .buffers import SurfaceSamples
from .exr import read_exr_rgb, rgb_channels, write_exr
from .gaussians import Gaussians, load_gaussians, save_gaussians


@dataclass
class Reconstruction:
    """An object as 2D Gaussians under a distant light.

    Attributes:
        gaussians: the disks.
        environment: (H, W, 3) float32 linear radiance, lat-long.
        bound: sphere around the object.
        to_world: (4, 4) similarity from the dataset's own frame to ours.
        glossy: True where the SH hold the diffuse radiance and the deferred split-sum adds the reflections; False where they hold it all.
        background: (H, W, 3) linear lat-long picture behind everything, or None where the photographs were masked.
    """

    gaussians: Gaussians
    environment: torch.Tensor
    bound: Bound
    to_world: np.ndarray
    glossy: bool = False
    background: torch.Tensor | None = None

    def environment_map(self) -> np.ndarray:
        """The light as (H, W, 3) float32 numpy."""
        return self.environment.detach().numpy()

    def surface_samples(self) -> SurfaceSamples:
        """The disks as surface points with materials."""
        return self.gaussians.samples()

    def save(self, folder: Path) -> None:
        """Write gaussians.ply, environment.exr, reconstruction.json, and background.exr where there is one; each in one step."""
        save_gaussians(self.gaussians, folder / "gaussians.ply")
        write_exr(folder / "environment.exr", rgb_channels(self.environment_map()))
        if self.background is not None:
            write_exr(folder / "background.exr", rgb_channels(self.background.detach().numpy()))
        frame = {"bound": asdict(self.bound), "to_world": self.to_world.tolist()}
        about = {**frame, "glossy": self.glossy, "background": self.background is not None}
        partial = folder / "reconstruction.json.part"
        partial.write_text(json.dumps(about, indent=1))
        os.replace(partial, folder / "reconstruction.json")

    @classmethod
    def load(cls, folder: Path) -> Reconstruction:
        """Read a run folder. Raises InputError where a file is missing or broken."""
        path = folder / "reconstruction.json"
        try:
            about = json.loads(path.read_text())
            x, y, z = (float(c) for c in about["bound"]["centre"])
            bound = Bound((x, y, z), float(about["bound"]["radius"]))
            to_world, glossy, has_background = np.array(about["to_world"], float).reshape(4, 4), bool(about["glossy"]), about["background"]
        except FileNotFoundError as error:
            raise InputError(path, "there is no such file", "is this a finished run folder?") from error
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise InputError(path, f"not readable ({error})") from error
        background = torch.from_numpy(read_exr_rgb(folder / "background.exr")) if has_background else None
        environment = torch.from_numpy(read_exr_rgb(folder / "environment.exr"))
        return cls(load_gaussians(folder / "gaussians.ply"), environment, bound, to_world, glossy, background)
