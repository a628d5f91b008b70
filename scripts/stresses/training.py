# SPDX-License-Identifier: GPL-3.0-or-later
"""Training where nothing can be learnt, for very long, at absurd rates, and in float64: it holds, or it stops with one clear line."""

from __future__ import annotations

import hashlib
import json
import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from irgspp.core.colour import encode_srgb
from irgspp.core.config import ReflectiveSettings, preset
from irgspp.core.datasets.camera import Camera, look_at
from irgspp.core.datasets.dataset import Bound, Dataset, View
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.kernels.reference import rasterize_reference
from irgspp.core.overrides import with_overrides
from irgspp.core.pipeline import DEMO_DATA, reconstruct
from irgspp.core.run_folder import read_run
from irgspp.core.scene.gaussians import Gaussians
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.stages.hull import initial_gaussians
from irgspp.core.stages.kind import COATED, LOW_GLOSS, METAL, Kind
from irgspp.core.stages.optimizer import Rate
from irgspp.core.stages.reflective import train
from irgspp.core.stages.render import render_view
from irgspp.core.stages.trainer import Trainer
from PIL import Image

from .case import Measured, group
from .gaussians import thread_setting

case = group("training")
TINY = with_overrides(preset("draft"), ["reflective.gaussians=200", "reflective.light_height=8", "reflective.iterations=40"])
COUNT = 200  # Gaussians
Painter = Callable[[np.ndarray], np.ndarray]


def cameras(count: int, size: int, distance: float = 4.0) -> list[Camera]:
    """On a spiral around the origin."""
    z, angle = np.linspace(-0.8, 0.8, count) if count > 1 else np.array([0.3]), np.arange(count) * 2.399963
    r = np.sqrt(1 - z**2)
    places = distance * np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)
    return [Camera(size, size, 1.3 * size, 1.3 * size, size / 2, size / 2, look_at(place)) for place in places]


def checks(points: np.ndarray) -> np.ndarray:
    """(..., 3) encoded colours of a chequered ball."""
    odd = (np.floor(2.5 * points + 0.1).astype(int).sum(-1) % 2 == 0)[..., None]
    return np.where(odd, [0.9, 0.6, 0.2], [0.15, 0.3, 0.5])


def flat(value: float) -> Painter:
    """One grey for every place."""
    return lambda points: np.full((*points.shape[:-1], 3), value)


def half_clipped(points: np.ndarray) -> np.ndarray:
    """Saturated on one side, black on the other."""
    return np.where(points[..., :1] > 0, np.ones(3), np.zeros(3))


def photographs(views: list[Camera], paint: Painter = checks, masked: bool = True) -> Dataset:
    """A unit ball of these colours; its surroundings look like a far wall painted alike."""
    pictures = []
    for i, camera in enumerate(views):
        rays = camera.rays().astype(np.float64)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        b = rays @ camera.centre
        inside = b * b - camera.centre @ camera.centre + 1
        far = np.where(inside > 0, -b - np.sqrt(np.maximum(inside, 0)), 8.0)
        colour = paint(camera.centre + far[..., None] * rays).astype(np.float32)
        alpha = (inside > 0).astype(np.float32) if masked else None
        pictures.append(View(f"{i}", camera, Path(f"{i}.png"), colour, alpha))
    return Dataset(Path("ball"), "transforms", pictures, [], Bound((0.0, 0.0, 0.0), 1.5), np.eye(4))


def trainer(dataset: Dataset, kind: Kind, settings: ReflectiveSettings = TINY.reflective) -> Trainer:
    """On the hull or at random, one view in four held back."""
    start = initial_gaussians(dataset, settings.gaussians, np.random.default_rng(0))
    return Trainer(dataset, settings, start, kind, 0, 4 if len(dataset.train) >= 4 else 0)


def values(trained: Trainer) -> list[torch.Tensor]:
    """All that is learnt."""
    return [*trained.optimizer.leaves.values(), *trained.optimizer.others.values()]


def finite_training(measured: Measured, what: str, dataset: Dataset, steps: int = 25) -> None:
    """Steps of what may be metal and of what may not, each density control included, leave finite values and losses."""
    settings = replace(TINY.reflective, iterations=steps)
    for kind in (LOW_GLOSS, METAL):
        fitted = trainer(dataset, kind, settings)
        losses = torch.tensor([fitted.step() for _ in range(steps)])
        measured.finite(f"{what}, {kind.name}", [losses, *values(fitted)])


@case(
    "white, black, saturated pictures",
    """With and without masks, low-gloss and metal: losses, Gaussians and light stay finite; a white and a black object's colour is met
    to 0.05 after 60 iterations, and the light told apart from it is finite.""",
)
def flat_pictures(measured: Measured) -> None:
    views = cameras(9, 16)
    for name, paint in (("white", flat(1.0)), ("black", flat(0.0)), ("saturated", half_clipped)):
        for masked in (True, False):
            finite_training(measured, f"{name}{' masked' if masked else ''}", photographs(views, paint, masked))
        if name == "saturated":
            continue
        dataset = photographs(views, paint)
        result, _ = train(dataset, replace(TINY, materials="low-gloss", reflective=replace(TINY.reflective, iterations=60)))
        measured.finite(f"{name}: first stage", [*result.gaussians.tensors().values(), result.environment])
        seen, target = render_view(result, views[0]), dataset.train[0]
        inside = seen.alpha > 0.9
        error = np.median(np.abs(encode_srgb(seen.radiance[inside]) - target.colour[inside]))
        measured.at_most(f"{name}: off by", float(error), 0.05)


@case(
    "pictures of one pixel, a single view",
    """The first stage on pictures of 1x1, 2x2 and 3x3 pixels, and on one view alone, ends with finite values or one clear line; at the
    door both are refused with one line (exit status 2).""",
)
def smallest(measured: Measured) -> None:
    for size in (1, 2, 3):
        for masked in (True, False):
            _held_or_told(measured, f"{size}x{size}{' masked' if masked else ''}", photographs(cameras(9, size), flat(0.6), masked))
    for masked in (True, False):
        finite_training(measured, f"one view{' masked' if masked else ''}", photographs(cameras(1, 16), checks, masked))
    with tempfile.TemporaryDirectory() as folder:
        for name, count, size in (("one view", 1, 32), ("one pixel", 9, 1)):
            refused = _refusal(write(Path(folder) / name.replace(" ", "_"), cameras(count, size)))
            measured.note(f"{name}: {refused}")
            measured.holds(f"{name} is refused in one line", bool(refused) and "\n" not in refused)


def _held_or_told(measured: Measured, what: str, dataset: Dataset) -> None:
    try:
        finite_training(measured, what, dataset)
    except IrgsppError as error:
        measured.note(f"{what}: {error}")
        measured.holds(f"{what}: told in one line", bool(str(error)) and "\n" not in str(error))


def write(folder: Path, views: list[Camera]) -> Path:
    """Photographs of the ball as files with a transforms.json."""
    folder.mkdir()
    for view in photographs(views).train:
        assert view.alpha is not None
        rgba = np.concatenate([view.colour, view.alpha[..., None]], -1)
        Image.fromarray(np.round(255 * rgba).astype(np.uint8)).save(folder / f"{view.name}.png")
    frames = [{"file_path": f"{i}.png", "transform_matrix": c.to_world.tolist()} for i, c in enumerate(views)]
    angle = 2 * math.atan(0.5 / 1.3)
    (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": angle, "frames": frames}))
    return folder


def _refusal(folder: Path) -> str:
    try:
        load_dataset(folder)
    except InputError as error:
        return str(error).replace(str(folder.parent), "").lstrip("/")
    return ""


@case(
    "cameras with wrong poses",
    "Poses swapped among photographs, turned away, upside down, all at one place, inside the object: finite values or one clear line.",
)
def wrong_poses(measured: Measured) -> None:
    right = cameras(9, 16)
    away = [replace(c, to_world=c.to_world @ np.diag([1.0, 1, -1, 1]) @ np.diag([-1.0, 1, 1, 1])) for c in right]
    kinds = {
        "swapped": [replace(c, to_world=right[(i * 4 + 3) % 9].to_world) for i, c in enumerate(right)],
        "turned away": away,
        "upside down": [replace(c, to_world=c.to_world @ np.diag([-1.0, -1, 1, 1])) for c in right],
        "at one place": [right[0]] * 9,
        "inside": cameras(9, 16, 0.2),
    }
    for name, poses in kinds.items():
        for masked in (True, False):
            seen = photographs(right, checks, masked).train
            views = [replace(view, camera=camera) for view, camera in zip(seen, poses, strict=True)]
            _held_or_told(measured, f"{name}{' masked' if masked else ''}", replace(photographs(right, checks, masked), train=views))


@case(
    "same seed",
    """20 iterations of low-gloss, masked and not, and of metal: done again the same bits; on 1, 2 and 5 threads
    the loss of each iteration is within 1e-5 of the others.""",
)
def same_seed(measured: Measured) -> None:
    apart = 0.0
    for kind, masked in ((LOW_GLOSS, True), (LOW_GLOSS, False), (METAL, True)):
        dataset, losses, bits = photographs(cameras(9, 16), checks, masked), [], []
        for threads in (2, 2, 1, 5):
            with thread_setting(threads):
                fitted = trainer(dataset, kind)
                losses.append(torch.tensor([fitted.step() for _ in range(20)], dtype=torch.float64))
            bits.append(digest(values(fitted)))
        measured.holds(f"{kind.name}: same bits when done again", bits[0] == bits[1])
        apart = max(apart, *(float((other - losses[0]).abs().max()) for other in losses))
    measured.at_most("loss apart on other numbers of threads", apart, 1e-5)


def digest(tensors: list[torch.Tensor]) -> str:
    """A fingerprint of every bit."""
    sums = hashlib.sha256()
    for tensor in tensors:
        sums.update(tensor.detach().contiguous().numpy().tobytes())
    return sums.hexdigest()


def drift(steps: int) -> tuple[torch.Tensor, torch.Tensor]:
    """(steps,) losses of the same training with the float32 kernels and with the float64 twin: 48 disks, 12x12 pixels, Adam."""
    dataset = photographs(cameras(8, 12))
    start = initial_gaussians(dataset, 48, np.random.default_rng(0))
    return _descent(dataset, start, torch.float32, steps), _descent(dataset, start, torch.float64, steps)


def _descent(dataset: Dataset, start: Gaussians, dtype: torch.dtype, steps: int) -> torch.Tensor:
    leaves = {name: value.to(dtype).clone().requires_grad_() for name, value in start.tensors().items() if name != "material"}
    rates = {"position": 1e-3, "quaternion": 5e-4, "log_scale": 6e-3, "opacity": 5e-2, "sh": 1e-2}
    adam = torch.optim.Adam([{"params": [leaves[name]], "lr": rate} for name, rate in rates.items()], eps=1e-15)
    nothing, losses = torch.zeros(0, start.count, dtype=dtype), []
    for step in range(steps):
        view = dataset.train[step % len(dataset.train)]
        assert view.alpha is not None
        inputs, seen = (*leaves.values(), nothing, view.camera, 1.5), torch.from_numpy(view.colour * view.alpha[..., None]).permute(2, 0, 1)
        sums = rasterize(*inputs)[0] if dtype == torch.float32 else rasterize_reference(*inputs)
        picture = encode_srgb(sums[:3] / sums[-1:].clamp_min(1e-4)) * sums[-1:]
        loss = (picture - seen.to(dtype)).square().mean() + 0.1 * (sums[-1] - torch.from_numpy(view.alpha).to(dtype)).square().mean()
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
    single, double = drift(100)
    apart = (single - double).abs() / double
    measured.finite("losses", [single, double])
    measured.note(f"after 10 steps {float(apart[:10].max()):.1e}")
    measured.at_most("largest drift", float(apart.max()), 1e-4)


@case(
    "float32 against float64, 1000 steps",
    """1000 steps: disks cross their neighbours' thresholds at other steps, so that both take other ways to the same end. The loss of the
    last 100 steps is the same in the mean to 5 %, the drift is told.""",
    quick=False,
)
def long_drift(measured: Measured) -> None:
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
    for kind, masked in ((LOW_GLOSS, True), (LOW_GLOSS, False), (METAL, True)):
        settings = replace(TINY.reflective, iterations=20_000, gaussians=100 if masked else 400)
        fitted = trainer(photographs(cameras(9, 16), checks, masked), kind, settings)
        with thread_setting(1):  # so little work is done sooner by one
            losses = np.array([fitted.step() for _ in range(20_000)])
        name = f"{kind.name}{'' if masked else ' without masks'}"
        measured.holds(f"{name}: every loss finite", bool(np.isfinite(losses).all()))
        measured.finite(f"{name}: values", values(fitted))
        measured.at_most(f"{name}: last 1000 against the second", losses[-1000:].mean() / losses[1000:2000].mean(), 1.0)


@case(
    "learning rates times 10 and 100",
    """150 iterations at these rates, then 300 at the proper ones, for all kinds: it stops with one clear line, as where most disks are
    lost and none may grow back, or all is finite and views held back are met to 2 dB of what they are without the accident.""",
    quick=False,
)
def fast_learning(measured: Measured) -> None:
    dataset, settings = photographs(cameras(12, 24)), replace(TINY.reflective, iterations=450)
    for kind in (LOW_GLOSS, COATED, METAL):
        calm = _accident(dataset, kind, settings, 1.0)
        for factor in (10.0, 100.0):
            try:
                psnr = _accident(dataset, kind, settings, factor)
            except IrgsppError as error:
                measured.note(f"{kind.name} x{factor:g}: {error}")
                measured.holds("told in one line", "\n" not in str(error))
                continue
            measured.at_least(f"{kind.name} x{factor:g}: dB", psnr, calm - 2)


def _accident(dataset: Dataset, kind: Kind, settings: ReflectiveSettings, factor: float) -> float:
    """PSNR of held-back views after 150 iterations at rates times `factor` and 300 at the proper ones."""
    fitted = trainer(dataset, kind, settings)
    proper = fitted.optimizer.rates
    fitted.optimizer.rates = {name: Rate(factor * rate.start, rate.final) for name, rate in proper.items()}
    for _ in range(150):
        fitted.step()
    fitted.optimizer.rates = proper
    for _ in range(300):
        fitted.step()
    if not all(bool(v.isfinite().all()) for v in values(fitted)):
        raise ValueError("values are not finite, and nothing stopped it")
    return fitted.test() or 0.0


@case(
    "whole jobs with the same seed",
    """The demonstration's photographs through all stages, small: the same bits of Gaussians, light, mesh and textures when done again. On
    one thread instead of two sums are added in another order; training grows that as it grows any rounding error (see float32 against
    float64), so that the same quality comes out, by another way: test views to 0.3 dB; how far light and materials are is told.""",
    quick=False,
)
def whole_jobs(measured: Measured) -> None:
    changes = ["materials=low-gloss", "reflective.iterations=120", "reflective.gaussians=2000", "transport.points=400", "transport.rows=8"]
    changes += ["transport.iterations=30", "transport.pool=8000", "transport.radiance_iterations=20"]
    settings = with_overrides(preset("draft"), [*changes, "surface.voxels=48", "surface.triangles=2000", "surface.texture=128"])
    with tempfile.TemporaryDirectory() as folder:
        runs = []
        for name, threads in (("first", 2), ("again", 2), ("single", 1)):
            with thread_setting(threads):
                runs.append(reconstruct(DEMO_DATA, Path(folder) / name, settings))
        for file in ("gaussians.ply", "environment.exr", "mesh.ply", "textures/albedo.png"):
            measured.holds(f"{file}: same bits when done again", (runs[0] / file).read_bytes() == (runs[1] / file).read_bytes())
        psnr = [read_run(run)["training"]["test_radiance_psnr"] for run in (runs[0], runs[2])]
        measured.at_most("dB apart on one thread", abs(psnr[0] - psnr[1]), 0.3)
        one, other = (Reconstruction.load(run) for run in (runs[0], runs[2]))
        light = (one.environment - other.environment).abs().mean() / one.environment.mean()
        means = [r.gaussians.materials().mean(1) for r in (one, other)]
        apart = (means[0] - means[1]).abs().max()
        measured.note(f"light apart by {float(light):.1%} in the mean, a material's mean by {float(apart):.2g}")
