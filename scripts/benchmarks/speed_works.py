# SPDX-License-Identifier: GPL-3.0-or-later
"""Works that `scripts/speed_history.py` times: the project's own, and reference loops of numpy that a commit cannot change."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import irgspp
import numpy as np
import torch
from irgspp.core.datasets.demo import DEMO_DATA
from irgspp.core.kernels.rasterize import COLOUR, rasterize
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound, Dataset, View
from irgspp.core.scene.gaussians import MATERIAL, Gaussians
from irgspp.core.settings.schema import FirstStageSettings
from irgspp.core.stages.first.material_class import MATERIAL_CLASSES, MaterialClass
from irgspp.core.stages.first.trainer import Trainer

from .workloads import MAJOR, MINOR, OURS, TRACE, scatter, torus

Work = Callable[[], object]
SURFELS, PIXELS, VIEWS, RAYS = 20_000, 200, 4, 65_536
ELEMENTS = 1 << 21  # of the reference loops
STEPS = 10  # of the first stage in one call


def references() -> dict[str, Work]:
    """Return the reference loops by name: arithmetic, memory traffic, and branches with scattered reads."""
    random = np.random.default_rng(0)
    values, other = random.random(ELEMENTS, np.float32), np.empty(ELEMENTS, np.float32)
    large = np.zeros(16 * ELEMENTS, np.float32)
    return {
        "exponential": lambda: np.exp(values, out=other),
        "copy": lambda: np.copyto(large[: 8 * ELEMENTS], large[8 * ELEMENTS :]),
        "sort": lambda: np.sort(values),
    }


def works() -> dict[str, Work]:
    """Return the project's works by name: steps of the first stage of each material class, secondary rays, and the demo's whole job."""
    surfels, rays = _torus_surfels(), scatter(SURFELS, RAYS)
    dataset = _photographed(surfels)
    steps = {f"first stage, {m.name}": _steps(dataset, surfels, m) for m in MATERIAL_CLASSES if m.name != "metal"}
    return steps | {"secondary rays": lambda: rays.forward(TRACE[OURS][0]), "demo, whole job": _demo}


def _torus_surfels() -> Gaussians:
    """Return the surfels of a torus."""
    shapes = ((3,), (4,), (2,), (), (16, 3))
    arrays = torus(SURFELS, 0, 0)[: len(shapes)]
    parameters = [torch.from_numpy(a).view(*shape, SURFELS) for a, shape in zip(arrays, shapes, strict=True)]
    return Gaussians(*parameters, torch.logit(torch.tensor(MATERIAL))[:, None].repeat(1, SURFELS))


def _photographed(g: Gaussians) -> Dataset:
    """Return a dataset of VIEWS images of surfels with masks."""
    views = []
    for number in range(VIEWS):
        turn = 2 * np.pi * number / VIEWS
        eye = 4 * np.array([0.8 * np.cos(turn), 0.8 * np.sin(turn), 0.6])
        camera = Camera(PIXELS, PIXELS, 1.3 * PIXELS, 1.3 * PIXELS, PIXELS / 2, PIXELS / 2, look_at(eye))
        parameters = g.position, g.quaternion, g.log_scale, g.opacity, g.sh
        image, _ = rasterize(*parameters, g.position.new_zeros(0, g.count), camera, MAJOR + MINOR)
        colour, alpha = image[COLOUR].clamp(0, 1).permute(1, 2, 0).contiguous().numpy(), image[-1].contiguous().numpy()
        views.append(View(str(number), camera, Path(str(number)), colour, alpha))
    return Dataset(Path("torus"), "synthetic", views, [], Bound((0.0, 0.0, 0.0), MAJOR + MINOR), np.eye(4))


def _steps(dataset: Dataset, surfels: Gaussians, material_class: MaterialClass) -> Work:
    """Return STEPS steps of a first stage at the highest SH degree and with all rays per pixel, before its density control begins."""
    settings = FirstStageSettings(sh_growth=0.0, single_rays=0.0, gaussians=SURFELS, iterations=1_000_000)
    trainer = Trainer(dataset, settings, surfels, material_class, 0, 0)
    return lambda: [trainer.step() for _ in range(STEPS)]


def _demo() -> None:
    """Reconstruct the demo dataset with the draft preset."""
    with tempfile.TemporaryDirectory() as folder:
        irgspp.reconstruct(DEMO_DATA, Path(folder) / "run", irgspp.preset("draft"))
