# SPDX-License-Identifier: GPL-3.0-or-later
"""Run folder after its first stage, and readers of its files."""

from __future__ import annotations

import functools
import json
import tempfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import IrgsppError
from irgspp.core.run_folder import RunFolder, read_run
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.core.scene.reconstruction import Reflections
from irgspp.core.scene.surface import Surface
from irgspp.core.settings.overrides import from_dict
from irgspp.core.stages.first.depth_anchors import DepthAnchors
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import GLOSSY
from irgspp.core.stages.first.material_class_selection import material_class_named
from irgspp.core.stages.first.trainer import Trainer
from irgspp.core.stereo.depth_map import DepthMap

from .tiny import settings, write_dataset


def flat_map(camera: Camera) -> DepthMap:
    """Return a depth map that is 1 everywhere, as if three other views agreed."""
    shape = camera.height, camera.width
    depth, normal, cost = np.ones(shape, np.float32), np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    return DepthMap(camera, depth, normal, cost, np.full(shape, 3, np.uint8), (0,))


@functools.cache
def short_training() -> Trainer:
    """Return a trainer of few surfels after some steps."""
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        data = load_dataset(write_dataset(Path(name)), settings().data)
    first = replace(settings().first, light_height=8)
    start = initial_gaussians(data, 40, np.random.default_rng(0))
    anchors = DepthAnchors.of_maps([flat_map(view.camera) for view in data.train])
    trainer = Trainer(data, first, start, GLOSSY, 0, 0, anchors=anchors)
    for _ in range(3):
        trainer.step()
    return trainer


def write_run(folder: Path) -> None:
    """Write a run folder after its first stage: run.json, checkpoints, cameras."""
    run = RunFolder.open(folder / "run", settings(), "photos")
    run.record("first stage", 1.0, 1 << 20, finished=True)
    random = np.random.default_rng(0)
    surface = Surface(random.random((4, 3)), random.random((4, 3)), np.array([[0, 1, 2], [0, 2, 3]]), 0.1)
    run.save("geometry", surface.state())
    run.save("first_stage", short_training().state())
    reflections = Reflections(torch.full((5, 4), 0.5), torch.ones(2, 4, 3))
    reflections.save(run.path / "reflections.npz")
    run.close()
    matrix = np.eye(4).tolist()
    lens = {"width": 8, "height": 8, "fx": 9.0, "fy": 9.0, "cx": 4.0, "cy": 4.0, "to_world": matrix, "picture": "a.png"}
    (folder / "run" / "cameras.json").write_text(json.dumps([{"name": "a", "split": "train", **lens}]))


def read_state(folder: Path, file: Path) -> object:
    """Read run.json as `--resume`, `evaluate` and `batch` do.

    Args:
        folder: folder of the run folder.
        file: broken file.
    """
    state = read_run(folder / "run")
    from_dict(state["settings"], file)
    run = RunFolder.open(folder / "run", settings(), "photos", resume=True)
    try:
        return run.finished("first stage"), run.spent
    finally:
        run.close()


def read_checkpoint(folder: Path, file: Path) -> object:
    """Read a checkpoint as a resumed job does.

    Args:
        folder: folder of the run folder.
        file: broken file.
    """
    run = RunFolder(folder / "run", {}, None)  # pyright: ignore[reportArgumentType]
    if file.stem == "geometry":
        return run.load("geometry", Surface.restored)
    state = run.load("first_stage")
    material_class_named(state.get("kind", ""), short_training().dataset)
    short_training().restore(state)
    with suppress(IrgsppError):  # diverging values give an error in one line
        short_training().step()
    return state


def read_layer(folder: Path, file: Path) -> object:
    """Read the other files of a run folder.

    Args:
        folder: folder of the run folder, unused.
        file: broken file.
    """
    return Reflections.load(file, 4) if file.suffix == ".npz" else load_run_cameras(file)
