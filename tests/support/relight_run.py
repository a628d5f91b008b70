# SPDX-License-Identifier: GPL-3.0-or-later
"""The run of `sphere_run` with Gaussians, for relighting: `python relight_run.py FOLDER` in the engine's Python."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import torch
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.overrides import to_dict
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.first.initialization import surfels
from sphere_run import axis_light, materials, write_run


def write_relightable(folder: Path, count: int = 8000) -> None:
    """Write a run folder with mesh, cameras, Gaussians on the unit sphere, light and run.json."""
    write_run(folder, 32)
    z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * 2.39996322972865
    normal = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
    albedo, roughness, metallic = materials(normal)
    splats = surfels(normal, normal, albedo, np.full(count, 0.65 * np.sqrt(4 * np.pi / count)), 0.99)
    values = np.concatenate([albedo, roughness[:, None], metallic[:, None]], 1).T
    splats.material = torch.logit(torch.from_numpy(np.clip(values, 1e-4, 1 - 1e-4).astype(np.float32)))
    Reconstruction(splats, torch.from_numpy(axis_light(32)), Bound((0.0, 0.0, 0.0), 1.3), np.eye(4)).save(folder)
    record = {"status": "done", "error": None, "phases": {}, "settings": to_dict(Settings()), "seed": 0, "skipped": [], "training": {}}
    (folder / "run.json").write_text(json.dumps({**record, "versions": {}, "dataset": str(folder)}))


if __name__ == "__main__":
    write_relightable(Path(sys.argv[1]))
