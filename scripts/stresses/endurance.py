# SPDX-License-Identifier: GPL-3.0-or-later
"""Long training, absurd learning rates, float64 training, and repeated jobs: results stay sound, or one clear message ends the training."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from irgspp.core.errors import IrgsppError
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.kernels.reference.rasterize import rasterize_reference
from irgspp.core.pipeline import DEMO_DATA, reconstruct
from irgspp.core.run_folder import read_run
from irgspp.core.scene.dataset import Dataset
from irgspp.core.scene.gaussians import Gaussians
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import FirstStageSettings, preset
from irgspp.core.stages.common.optimizer import Rate
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import GLOSSY, LOW_GLOSS, METAL, MaterialClass

from .case import Measured, group
from .threads import threads_set_to
from .training import TINY, cameras, chequered, photographs, trainer, values

case = group("endurance")


def drift(steps: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Train the same scene with the float32 kernels and with the float64 reference: 48 surfels, 12x12 pixels, Adam.

    Returns:
        Losses of both, (steps,) each.
    """
    dataset = photographs(cameras(8, 12))
    start = initial_gaussians(dataset, 48, np.random.default_rng(0))
    return _descent(dataset, start, torch.float32, steps), _descent(dataset, start, torch.float64, steps)


def _descent(dataset: Dataset, start: Gaussians, dtype: torch.dtype, steps: int) -> torch.Tensor:
    """Return the losses of a training in a precision, (steps,)."""
    leaves = {name: value.to(dtype).clone().requires_grad_() for name, value in start.tensors().items() if name != "material"}
    rates = {"position": 1e-3, "quaternion": 5e-4, "log_scale": 6e-3, "opacity": 5e-2, "sh": 1e-2}
    adam = torch.optim.Adam([{"params": [leaves[name]], "lr": rate} for name, rate in rates.items()], eps=1e-15)
    nothing, losses = torch.zeros(0, start.count, dtype=dtype), []
    for step in range(steps):
        view = dataset.train[step % len(dataset.train)]
        assert view.alpha is not None
        inputs, target = (
            (*leaves.values(), nothing, view.camera, 1.5),
            torch.from_numpy(view.colour * view.alpha[..., None]).permute(2, 0, 1),
        )
        sums = rasterize(*inputs)[0] if dtype == torch.float32 else rasterize_reference(*inputs)
        image = encode_srgb(sums[:3] / sums[-1:].clamp_min(1e-4)) * sums[-1:]
        loss = (image - target.to(dtype)).square().mean() + 0.1 * (sums[-1] - torch.from_numpy(view.alpha).to(dtype)).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
        losses.append(loss.item())
    return torch.tensor(losses, dtype=torch.float64)


@case(
    "float32 against float64, 100 steps",
    "The loss of a training with the float32 kernels stays within 1e-4 of the same one in float64, relative, for 100 steps of Adam.",
)
def short_drift(measured: Measured) -> None:
    """Check the drift within 100 steps."""
    single, double = drift(100)
    apart = (single - double).abs() / double
    measured.finite("losses", [single, double])
    measured.note(f"after 10 steps {float(apart[:10].max()):.1e}")
    measured.at_most("largest drift", float(apart.max()), 1e-4)


@case(
    "float32 against float64, 1000 steps",
    """1000 steps: surfels cross their neighbours' thresholds at other steps, so that both reach the same end by different paths. The mean
    loss of the last 100 steps is the same to 5 %; the drift is reported.""",
    quick=False,
)
def long_drift(measured: Measured) -> None:
    """Check the end of 1000 steps."""
    single, double = drift(1000)
    apart = (single - double).abs() / double
    for steps in (10, 100, 300, 1000):
        measured.note(f"after {steps} steps {float(apart[:steps].max()):.1e}")
    measured.at_most("end apart", abs(float(single[-100:].mean() / double[-100:].mean()) - 1), 0.05)
    measured.at_most("end against start", float(single[-100:].mean() / single[:10].mean()), 0.5)


@case(
    "20,000 iterations",
    """On a tiny scene, low-gloss with masks, low-gloss without, and metal: every loss and value finite, the last 1000
    no worse than 1000 to 2000.""",
    quick=False,
)
def very_long(measured: Measured) -> None:
    """Check 20,000 iterations."""
    for kind, masked in ((LOW_GLOSS, True), (LOW_GLOSS, False), (METAL, True)):
        settings = replace(TINY.first, iterations=20_000, gaussians=100 if masked else 400)
        fitted = trainer(photographs(cameras(9, 16), chequered, masked), kind, settings)
        with threads_set_to(1):  # so little work is faster on one thread
            losses = np.array([fitted.step() for _ in range(20_000)])
        name = f"{kind.name}{'' if masked else ' without masks'}"
        measured.holds(f"{name}: every loss finite", bool(np.isfinite(losses).all()))
        measured.finite(f"{name}: values", values(fitted))
        measured.at_most(f"{name}: last 1000 against the second", losses[-1000:].mean() / losses[1000:2000].mean(), 1.0)


@case(
    "learning rates times 10 and 100",
    """150 iterations at these rates, then 300 at the normal ones, for all material classes: training stops with one clear line, as where
    most surfels are lost and none may grow back, or all is finite and held-back views reach the normal training's PSNR to 2 dB.""",
    quick=False,
)
def fast_learning(measured: Measured) -> None:
    """Check high learning rates."""
    dataset, settings = photographs(cameras(12, 24)), replace(TINY.first, iterations=450)
    for kind in (LOW_GLOSS, GLOSSY, METAL):
        undisturbed = _psnr_after_fast_start(dataset, kind, settings, 1.0)
        for factor in (10.0, 100.0):
            try:
                psnr = _psnr_after_fast_start(dataset, kind, settings, factor)
            except IrgsppError as error:
                measured.note(f"{kind.name} x{factor:g}: {error}")
                measured.holds("one line", "\n" not in str(error))
                continue
            measured.at_least(f"{kind.name} x{factor:g}: dB", psnr, undisturbed - 2)


def _psnr_after_fast_start(dataset: Dataset, kind: MaterialClass, settings: FirstStageSettings, factor: float) -> float:
    """Return PSNR of held-back views after 150 iterations at rates times `factor` and 300 at the normal ones."""
    fitted = trainer(dataset, kind, settings)
    normal = fitted.optimizer.rates
    fitted.optimizer.rates = {name: Rate(factor * rate.start, rate.final) for name, rate in normal.items()}
    for _ in range(150):
        fitted.step()
    fitted.optimizer.rates = normal
    for _ in range(300):
        fitted.step()
    if not all(bool(v.isfinite().all()) for v in values(fitted)):
        raise ValueError("values are not finite, and nothing stopped it")
    return fitted.test() or 0.0


@case(
    "whole jobs with the same seed",
    """The demonstration's photographs through all stages, small: the same bits of Gaussians, light, mesh and textures when repeated. On
    one thread instead of two, sums are added in another order; training amplifies that like any rounding error (see float32 against
    float64), so that the quality is the same but not the bits: test views to 0.3 dB; the change of light and materials is reported.""",
    quick=False,
)
def whole_jobs(measured: Measured) -> None:
    """Check repeated jobs."""
    changes = ["materials=low-gloss", "first.iterations=120", "first.gaussians=2000", "second.points=400", "second.rows=8"]
    changes += ["second.iterations=30", "second.pool=8000", "second.radiance_iterations=20"]
    settings = with_overrides(preset("draft"), [*changes, "surface.voxels=48", "surface.triangles=2000", "surface.texture=128"])
    with tempfile.TemporaryDirectory() as folder:
        runs = []
        for name, threads in (("first", 2), ("again", 2), ("single", 1)):
            with threads_set_to(threads):
                runs.append(reconstruct(DEMO_DATA, Path(folder) / name, settings))
        for file in ("gaussians.ply", "environment.exr", "mesh.ply", "textures/albedo.png"):
            measured.holds(f"{file}: same bits when repeated", (runs[0] / file).read_bytes() == (runs[1] / file).read_bytes())
        psnr = [read_run(run)["training"]["test_radiance_psnr"] for run in (runs[0], runs[2])]
        measured.at_most("dB apart on one thread", abs(psnr[0] - psnr[1]), 0.3)
        one, other = (Reconstruction.load(run) for run in (runs[0], runs[2]))
        light = (one.environment - other.environment).abs().mean() / one.environment.mean()
        means = [r.gaussians.materials().mean(1) for r in (one, other)]
        apart = (means[0] - means[1]).abs().max()
        measured.note(f"light apart by {float(light):.1%} in the mean, a material's mean by {float(apart):.2g}")
