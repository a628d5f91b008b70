# SPDX-License-Identifier: GPL-3.0-or-later
"""The exported asset in Blender's path tracer: what Cycles makes of our mesh, materials and light."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import IrgsppError
from ..io.exr import read_exr, rgb_channels, write_exr
from ..machine.blender_process import run_in_blender
from ..progress.protocol import Progress
from ..relight.prepared_light import prepare
from ..relight.relighter import Relighter
from ..scene.camera import Camera
from .metrics import on_black, psnr

SAMPLES = 256  # of Cycles in a comparison, denoised


@dataclass(frozen=True)
class CyclesPass:
    """How often an image's pixels are sampled, and whether OpenImageDenoise goes over it."""

    samples: int
    denoise: bool


@dataclass(frozen=True, eq=False)
class CyclesImage:
    """(H, W, 4) linear premultiplied RGBA, and the seconds it took to render with the scene loaded; CPU seconds are of all threads."""

    rgba: np.ndarray
    seconds: float
    cpu_seconds: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """The same view under the same light, encoded on black (H, W, 3): our image of the Gaussians, and Cycles' of the exported mesh."""

    view: str
    light: str
    ours: np.ndarray
    theirs: np.ndarray

    @property
    def figures(self) -> dict[str, float]:
        """Mean absolute difference of encoded values where either shows something, and PSNR over the image."""
        seen = (self.ours.max(-1) > 0) | (self.theirs.max(-1) > 0)
        difference = np.abs(self.ours - self.theirs)[seen]
        return {"cycles_difference": float(difference.mean()) if seen.any() else 0.0, "cycles_psnr": psnr(self.ours, self.theirs)}


def compare(
    relighter: Relighter, run: Path, cameras: Mapping[str, Camera], lights: Mapping[str, np.ndarray], progress: Progress
) -> list[Comparison]:
    """Every view under every light by us and by Cycles, with all the light's bounces, as an artist will see it. See `cycles_pictures`."""
    progress.phase("cycles", len(cameras) * len(lights))
    rendered = cycles_images(run, cameras, lights, [CyclesPass(SAMPLES, True)], progress)
    prepared, comparisons = {name: prepare(light) for name, light in lights.items()}, []
    for view, camera in cameras.items():
        surface = relighter.surface(camera)
        for light in lights:
            ours = on_black(relighter.relit(surface, prepared[light]).numpy())
            comparisons.append(Comparison(view, light, ours, on_black(rendered[view, light][0].rgba)))
            progress.step(len(comparisons))
    return comparisons


def cycles_images(
    run: Path,
    cameras: Mapping[str, Camera],
    lights: Mapping[str, np.ndarray],
    passes: Sequence[CyclesPass],
    progress: Progress,
    source: str = "textures",
) -> dict[tuple[str, str], list[CyclesImage]]:
    """Render views of a finished run by Cycles, all bounces, in a Blender of its own.

    Args:
        cameras: by view, in the frame of the run. lights: by name, (H, W, 3) linear lat-long. passes: each made of every view and light.
        source: what the material reads, "textures" or "attributes".

    Returns:
        By view and light, an image for each pass. Raises NoBlender, Cancelled, or IrgsppError where Blender fails.
    """
    with tempfile.TemporaryDirectory(prefix="irgspp-cycles-") as name:
        folder = Path(name)
        for light, image in lights.items():
            write_exr(folder / f"{light}.exr", rgb_channels(image))
        request = {
            "run": str(run.resolve()),
            "source": source,
            "views": {view: {**vars(camera), "to_world": camera.to_world.tolist()} for view, camera in cameras.items()},
            "lights": {light: str(folder / f"{light}.exr") for light in lights},
            "passes": [vars(one) for one in passes],
            "out": str(folder),
        }
        (folder / "request.json").write_text(json.dumps(request), encoding="utf-8")
        paths = [str(folder / name) for name in ("request.json", "answer.json")]
        status, said = run_in_blender("irgspp_addon.relight.cycles_views", paths, lambda: progress.cancelled)
        if status:
            raise IrgsppError(f"{run}: Cycles did not render it: Blender ended with status {status}: {said}")
        seconds = json.loads((folder / "answer.json").read_text(encoding="utf-8"))

        def image_of(view: str, light: str, number: int) -> CyclesImage:
            stem = f"{view}_{light}_{number}"
            channels = read_exr(folder / f"{stem}.exr")
            return CyclesImage(np.stack([channels[c] for c in "RGBA"], -1), *seconds[stem])

        return {(view, light): [image_of(view, light, i) for i in range(len(passes))] for view in cameras for light in lights}
