# SPDX-License-Identifier: GPL-3.0-or-later
"""Training on degenerate photographs: results stay finite, or training stops with one clear message."""

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
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.rendering.gbuffer import render_gbuffer
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound, Dataset, View
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import FirstStageSettings, preset
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import LOW_GLOSS, METAL, MaterialClass
from irgspp.core.stages.first.train import train
from irgspp.core.stages.first.trainer import Trainer
from PIL import Image

from .case import Measured, group
from .threads import threads_set_to

case = group("training")
TINY = with_overrides(preset("draft"), ["first.gaussians=200", "first.light_height=8", "first.iterations=40"])
COUNT = 200  # Gaussians
ColourFunction = Callable[[np.ndarray], np.ndarray]


def cameras(count: int, size: int, distance: float = 4.0) -> list[Camera]:
    """Return cameras on a spiral around the origin.

    Args:
        count: number of cameras.
        size: pixels along a side.
        distance: distance from the origin.
    """
    z, angle = np.linspace(-0.8, 0.8, count) if count > 1 else np.array([0.3]), np.arange(count) * 2.399963
    r = np.sqrt(1 - z**2)
    places = distance * np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)
    return [Camera(size, size, 1.3 * size, 1.3 * size, size / 2, size / 2, look_at(place)) for place in places]


def chequered(points: np.ndarray) -> np.ndarray:
    """Return the encoded colours of a chequered ball.

    Args:
        points: (..., 3).

    Returns:
        (..., 3).
    """
    odd = (np.floor(2.5 * points + 0.1).astype(int).sum(-1) % 2 == 0)[..., None]
    return np.where(odd, [0.9, 0.6, 0.2], [0.15, 0.3, 0.5])


def uniform(value: float) -> ColourFunction:
    """Return a function that gives one grey to every point."""
    return lambda points: np.full((*points.shape[:-1], 3), value)


def saturated(points: np.ndarray) -> np.ndarray:
    """Return colours that are saturated on one side and black on the other.

    Args:
        points: (..., 3).

    Returns:
        (..., 3).
    """
    return np.where(points[..., :1] > 0, np.ones(3), np.zeros(3))


def photographs(views: list[Camera], colour_at: ColourFunction = chequered, masked: bool = True) -> Dataset:
    """Return a dataset of a unit ball, whose surroundings look like a far wall of the same colours.

    Args:
        views: cameras.
        colour_at: encoded colours (..., 3) of points (..., 3).
        masked: True for views with alpha.
    """
    images = []
    for i, camera in enumerate(views):
        rays = camera.rays().astype(np.float64)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        b = rays @ camera.centre
        inside = b * b - camera.centre @ camera.centre + 1
        far = np.where(inside > 0, -b - np.sqrt(np.maximum(inside, 0)), 8.0)
        colour = colour_at(camera.centre + far[..., None] * rays).astype(np.float32)
        alpha = (inside > 0).astype(np.float32) if masked else None
        images.append(View(f"{i}", camera, Path(f"{i}.png"), colour, alpha))
    return Dataset(Path("ball"), "transforms", images, [], Bound((0.0, 0.0, 0.0), 1.5), np.eye(4))


def trainer(dataset: Dataset, kind: MaterialClass, settings: FirstStageSettings = TINY.first) -> Trainer:
    """Return a trainer that starts on the visual hull or at random, with one view in four held back.

    Args:
        dataset: photographs.
        kind: material class.
        settings: settings of the first stage.
    """
    start = initial_gaussians(dataset, settings.gaussians, np.random.default_rng(0))
    return Trainer(dataset, settings, start, kind, 0, 4 if len(dataset.train) >= 4 else 0)


def values(trained: Trainer) -> list[torch.Tensor]:
    """Return all parameters of a trainer."""
    return [*trained.optimizer.leaves.values(), *trained.optimizer.others.values()]


def check_training(measured: Measured, what: str, dataset: Dataset, steps: int = 16) -> None:
    """Check that training as a metal and as low-gloss, with density control, leaves finite parameters and losses.

    Args:
        measured: result of the case.
        what: name of the dataset.
        dataset: photographs.
        steps: number of iterations.
    """
    settings = replace(TINY.first, iterations=steps)
    for kind in (LOW_GLOSS, METAL):
        fitted = trainer(dataset, kind, settings)
        losses = torch.tensor([fitted.step() for _ in range(steps)])
        measured.finite(f"{what}, {kind.name}", [losses, *values(fitted)])


@case(
    "white, black, saturated images",
    """With and without masks, low-gloss and metal: losses, Gaussians and light stay finite; the colour of a white and a black object is
    within 0.05 after 60 iterations, and the light separated from it is finite.""",
)
def flat_images(measured: Measured) -> None:
    """Check images of one colour."""
    views = cameras(9, 16)
    for name, colour_at in (("white", uniform(1.0)), ("black", uniform(0.0)), ("saturated", saturated)):
        for masked in (True, False):
            check_training(measured, f"{name}{' masked' if masked else ''}", photographs(views, colour_at, masked))
        if name == "saturated":
            continue
        dataset = photographs(views, colour_at)
        result, _ = train(dataset, replace(TINY, materials="low-gloss", first=replace(TINY.first, iterations=60)))
        measured.finite(f"{name}: first stage", [*result.gaussians.tensors().values(), result.environment])
        seen, target = render_gbuffer(result, views[0]), dataset.train[0]
        inside = seen.alpha > 0.9
        error = np.median(np.abs(encode_srgb(seen.radiance[inside]) - target.colour[inside]))
        measured.at_most(f"{name}: off by", float(error), 0.05)


@case(
    "images of one pixel, a single view",
    """The first stage on images of 1x1, 2x2 and 3x3 pixels, and on one view alone, ends with finite values or one clear line; as a
    dataset both are refused with one line (exit status 2).""",
)
def smallest(measured: Measured) -> None:
    """Check the smallest datasets."""
    for size in (1, 2, 3):
        for masked in (True, False):
            _check_training_or_error(
                measured, f"{size}x{size}{' masked' if masked else ''}", photographs(cameras(9, size), uniform(0.6), masked)
            )
    for masked in (True, False):
        check_training(measured, f"one view{' masked' if masked else ''}", photographs(cameras(1, 16), chequered, masked))
    with tempfile.TemporaryDirectory() as folder:
        for name, count, size in (("one view", 1, 32), ("one pixel", 9, 1)):
            refused = _error_of(write(Path(folder) / name.replace(" ", "_"), cameras(count, size)))
            measured.note(f"{name}: {refused}")
            measured.holds(f"{name} is refused in one line", bool(refused) and "\n" not in refused)


def _check_training_or_error(measured: Measured, what: str, dataset: Dataset) -> None:
    """Check that training leaves finite values, or stops with one line."""
    try:
        check_training(measured, what, dataset)
    except IrgsppError as error:
        measured.note(f"{what}: {error}")
        measured.holds(f"{what}: one line", bool(str(error)) and "\n" not in str(error))


def write(folder: Path, views: list[Camera]) -> Path:
    """Write photographs of the ball as files with a transforms.json.

    Args:
        folder: folder to make.
        views: cameras.

    Returns:
        The folder.
    """
    folder.mkdir()
    for view in photographs(views).train:
        assert view.alpha is not None
        rgba = np.concatenate([view.colour, view.alpha[..., None]], -1)
        Image.fromarray(np.round(255 * rgba).astype(np.uint8)).save(folder / f"{view.name}.png")
    frames = [{"file_path": f"{i}.png", "transform_matrix": c.to_world.tolist()} for i, c in enumerate(views)]
    angle = 2 * math.atan(0.5 / 1.3)
    (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": angle, "frames": frames}))
    return folder


def _error_of(folder: Path) -> str:
    """Return the message that a dataset is refused with; "" where it is read."""
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
    """Check wrong poses."""
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
            seen = photographs(right, chequered, masked).train
            views = [replace(view, camera=camera) for view, camera in zip(seen, poses, strict=True)]
            _check_training_or_error(
                measured, f"{name}{' masked' if masked else ''}", replace(photographs(right, chequered, masked), train=views)
            )


@case(
    "same seed",
    """20 iterations of low-gloss, masked and not, and of metal: the same bits when repeated; on 1, 2 and 5 threads
    the loss of each iteration is within 1e-5 of the others.""",
)
def same_seed(measured: Measured) -> None:
    """Check repeated training."""
    apart = 0.0
    for kind, masked in ((LOW_GLOSS, True), (LOW_GLOSS, False), (METAL, True)):
        dataset, losses, bits = photographs(cameras(9, 16), chequered, masked), [], []
        for threads in (2, 2, 1, 5):
            with threads_set_to(threads):
                fitted = trainer(dataset, kind)
                losses.append(torch.tensor([fitted.step() for _ in range(20)], dtype=torch.float64))
            bits.append(digest(values(fitted)))
        measured.holds(f"{kind.name}: same bits when repeated", bits[0] == bits[1])
        apart = max(apart, *(float((other - losses[0]).abs().max()) for other in losses))
    measured.at_most("loss apart on other numbers of threads", apart, 1e-5)


def digest(tensors: list[torch.Tensor]) -> str:
    """Return a digest of every bit of tensors (...,)."""
    sums = hashlib.sha256()
    for tensor in tensors:
        sums.update(tensor.detach().contiguous().numpy().tobytes())
    return sums.hexdigest()
