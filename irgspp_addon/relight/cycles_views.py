# SPDX-License-Identifier: GPL-3.0-or-later
"""Views of a run rendered by Cycles, to be set beside our own: `launch.py irgspp_addon.relight.cycles_views REQUEST.json ANSWER.json`.

The request: {"run": folder, "source": "textures" | "attributes", "views": {name: camera}, "lights": {name: .exr}, "passes": [{"samples": n,
"denoise": bool}], "out": folder}; a camera is {"width", "height", "fx", "fy", "cx", "cy", "to_world"} in the frame of the run. Images
are out/<view>_<light>_<number of the pass>.exr, linear premultiplied RGBA; the answer is {name of the image: [seconds, CPU seconds]}. The
scene stays loaded between images, and each is rendered after one like it, so that the seconds are of rendering alone.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ...core.errors import IrgsppError
from ...core.machine.thread_pool import thread_count
from ...core.scene.camera import Camera
from ..importer.cameras import look_through, set_camera
from ..importer.scene_builder import import_run
from ..world.light_to_world import world_from_map

WARM = 1  # samples of the image before the first


def render(request: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Render what is asked for; the seconds and the CPU seconds of each image by its name."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene, seconds = bpy.context.scene, {}
    imported = import_run(Path(request["run"]), request["source"], pack=False)
    imported.root.matrix_world = Matrix()
    placed = bpy.data.objects.new("view", bpy.data.cameras.new("view"))
    scene.collection.objects.link(placed)
    _set_up(scene)
    for view, record in request["views"].items():
        set_camera(placed, Camera(**{**record, "to_world": np.array(record["to_world"])}))
        look_through(scene, placed)
        for light, file in request["lights"].items():
            scene.world = world_from_map(Path(file), light)
            _shoot(scene, WARM, False, Path(request["out"]) / "warm.exr")
            for number, one in enumerate(request["passes"]):
                name = f"{view}_{light}_{number}"
                seconds[name] = _shoot(scene, one["samples"], one["denoise"], Path(request["out"]) / f"{name}.exr")
    return seconds


def _set_up(scene: bpy.types.Scene) -> None:
    scene.render.engine, scene.render.film_transparent = "CYCLES", True
    scene.render.use_persistent_data = True
    scene.render.threads_mode, scene.render.threads = "FIXED", thread_count()
    scene.cycles.device, scene.cycles.use_adaptive_sampling = "CPU", False
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"


def _shoot(scene: bpy.types.Scene, samples: int, denoise: bool, target: Path) -> tuple[float, float]:
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.denoiser = samples, denoise, "OPENIMAGEDENOISE"
    scene.render.filepath = str(target.resolve())
    began, cpu = time.perf_counter(), time.process_time()
    bpy.ops.render.render(write_still=True)
    return time.perf_counter() - began, time.process_time() - cpu


def main(argv: list[str] | None = None) -> int:
    request, answer = sys.argv[1:] if argv is None else argv
    try:
        seconds = render(json.loads(Path(request).read_text(encoding="utf-8")))
    except IrgsppError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    Path(answer).write_text(json.dumps(seconds), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
