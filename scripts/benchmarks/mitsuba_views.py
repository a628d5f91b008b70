# SPDX-License-Identifier: GPL-3.0-or-later
"""Views of an object rendered by Mitsuba in a process of its own: `python -m benchmarks.mitsuba_views FOLDER`; see mitsuba_peer.py.

FOLDER/request.json says what to render, FOLDER/arrays.npz has the mesh, its materials, the lights as light_<name>, and the table `body`.
Images are <view>_<light>_<samples>.npy, (H, W, 4) linear premultiplied, and <view>_<light>_converged.npy; FOLDER/answer.json has the
seconds and CPU seconds of each. The scene is loaded and its kernels are compiled before the clock starts.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportArgumentType=false
# (Mitsuba is optional, and its types depend on the variant)

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import mitsuba as mi
import numpy as np

from .mitsuba_child import read_request

AT_ONCE = 256  # samples per pixel of one call; more need much memory
WARM, TIMED, CONVERGED = 0, 1, 1000  # seeds


def main(folder: Path) -> None:
    """Answer the request in a folder."""
    request, arrays = read_request(folder)
    from . import mitsuba_scene  # needs a variant

    seconds: dict[str, tuple[float, float]] = {}
    material = mitsuba_scene.material(arrays, request["brdf"])
    for name in request["lights"]:
        scene = mitsuba_scene.lit(mitsuba_scene.mesh_shape(arrays, material), arrays[f"light_{name}"], request["bounces"])
        for view, camera in request["views"].items():
            sensor, stem = mitsuba_scene.sensor(camera), f"{view}_{name}"
            seconds |= _timed(scene, sensor, request["counts"], folder / stem)
            if request["converged"]:
                np.save(folder / f"{stem}_converged.npy", _render(scene, sensor, request["converged"], CONVERGED))
            if request["layers"]:
                _save_layers(scene, sensor, request["layers"], folder / stem)
    layers = list(mitsuba_scene.LAYERS) if request["layers"] else []
    (folder / "answer.json").write_text(json.dumps({"seconds": seconds, "layers": layers}), encoding="utf-8")


def _timed(scene: mi.Scene, sensor: mi.Sensor, counts: list[int], stem: Path) -> dict[str, tuple[float, float]]:
    """Render and save an image for each number of samples; return wall clock and CPU seconds by the images' names."""
    seconds = {}
    for samples in counts:
        _render(scene, sensor, min(samples, AT_ONCE), WARM)
        began, cpu = time.perf_counter(), time.process_time()
        image = _render(scene, sensor, samples, TIMED)
        seconds[f"{stem.name}_{samples}"] = (time.perf_counter() - began, time.process_time() - cpu)
        np.save(stem.with_name(f"{stem.name}_{samples}.npy"), image)
    return seconds


def _render(scene: mi.Scene, sensor: mi.Sensor, samples: int, seed: int) -> np.ndarray:
    """Render an image (H, W, 4) in parts of at most AT_ONCE samples."""
    parts = [min(AT_ONCE, samples - done) for done in range(0, samples, AT_ONCE)]
    images = [np.array(mi.render(scene, sensor=sensor, spp=part, seed=seed + i)) * (part / samples) for i, part in enumerate(parts)]
    return np.sum(images, 0, dtype=np.float32)


def _save_layers(scene: mi.Scene, sensor: mi.Sensor, samples: int, stem: Path) -> None:
    """Save the material layers, divided by coverage, and alpha."""
    from . import mitsuba_scene

    for name, layer in mitsuba_scene.layers(scene, sensor, samples).items():
        np.save(stem.with_name(f"{stem.name}_{name}.npy"), layer)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
