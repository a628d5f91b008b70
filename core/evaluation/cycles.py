# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison with Cycles: the exported mesh, materials and light rendered by Blender's path tracer."""

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
from ..relight.prepared_light import prepare_light
from ..relight.relighter import Relighter
from ..scene.camera import Camera
from .metrics import on_black, psnr

SAMPLES = 256  # per pixel, by Cycles in a comparison, denoised


@dataclass(frozen=True)
class CyclesPass:
    """Samples per pixel of an image, and whether OpenImageDenoise denoises it."""

    samples: int
    denoise: bool


@dataclass(frozen=True, eq=False)
class CyclesImage:
    """Image rendered by Cycles, with its rendering time.

    Attributes:
        rgba: (H, W, 4) linear, premultiplied.
        seconds: of rendering, with the scene loaded.
        cpu_seconds: the same, summed over all threads.
    """

    rgba: np.ndarray
    seconds: float
    cpu_seconds: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two images of one view under one light, encoded on black.

    Attributes:
        view: its name.
        light: its name.
        ours: (H, W, 3), our image of the Gaussians.
        theirs: (H, W, 3), Cycles' image of the exported mesh.
    """

    view: str
    light: str
    ours: np.ndarray
    theirs: np.ndarray

    @property
    def metrics(self) -> dict[str, float]:
        """Mean absolute difference of encoded values where either image shows something, and PSNR over the whole image."""
        seen = (self.ours.max(-1) > 0) | (self.theirs.max(-1) > 0)
        difference = np.abs(self.ours - self.theirs)[seen]
        return {"cycles_difference": float(difference.mean()) if seen.any() else 0.0, "cycles_psnr": psnr(self.ours, self.theirs)}


def compare(
    relighter: Relighter, run: Path, cameras: Mapping[str, Camera], lights: Mapping[str, np.ndarray], progress: Progress
) -> list[Comparison]:
    """Render every view under every light by our relighter and by Cycles, with all bounces of light, as an artist will see it.

    Args:
        relighter: of the run.
        run: folder of the finished run.
        cameras: by name of the view, in the world frame of the run.
        lights: by name, lat-long maps (H, W, 3), linear.
        progress: reporter; asked whether to stop.

    Raises:
        NoBlender: when no Blender is found.
        Cancelled: when the user stops the work.
        IrgsppError: when Blender fails.
    """
    progress.phase("cycles", len(cameras) * len(lights))
    rendered = cycles_images(run, cameras, lights, [CyclesPass(SAMPLES, True)], progress)
    prepared, comparisons = {name: prepare_light(light) for name, light in lights.items()}, []
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
    """Render views of a finished run by Cycles, with all bounces of light, in a separate Blender process.

    Args:
        run: folder of the finished run.
        cameras: by name of the view, in the world frame of the run.
        lights: by name, lat-long maps (H, W, 3), linear.
        passes: each is rendered of every view and light.
        progress: asked whether to stop.
        source: what the material reads, "textures" or "attributes".

    Returns:
        By view and light, an image (H, W, 4) for each pass.

    Raises:
        NoBlender: when no Blender is found.
        Cancelled: when the user stops the work.
        IrgsppError: when Blender fails.
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
        status, last_line = run_in_blender("irgspp_addon.relight.cycles_views", paths, lambda: progress.cancelled)
        if status:
            raise IrgsppError(f"{run}: Cycles did not render it: Blender ended with status {status}: {last_line}")
        seconds = json.loads((folder / "answer.json").read_text(encoding="utf-8"))

        def image_of(view: str, light: str, number: int) -> CyclesImage:
            stem = f"{view}_{light}_{number}"
            channels = read_exr(folder / f"{stem}.exr")
            return CyclesImage(np.stack([channels[c] for c in "RGBA"], -1), *seconds[stem])

        return {(view, light): [image_of(view, light, i) for i in range(len(passes))] for view in cameras for light in lights}
