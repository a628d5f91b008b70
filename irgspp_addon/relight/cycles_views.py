# SPDX-License-Identifier: GPL-3.0-or-later
"""Reference views of a run by Cycles, for comparison: `launch.py irgspp_addon.relight.cycles_views REQUEST.json ANSWER.json`.

The request is {"run": folder, "source": "textures" | "attributes", "views": {name: camera}, "lights": {name: .exr}, "passes":
[{"samples": n, "denoise": bool}], "out": folder}; a camera is {"width", "height", "fx", "fy", "cx", "cy", "to_world"} in the run's frame.
Images are out/<view>_<light>_<number of the pass>.exr, linear premultiplied RGBA; the answer is {name of the image: [seconds, CPU
seconds]}. The scene stays loaded, and a warm-up image precedes those of each view and light, so that the seconds measure rendering alone.
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

from ...core.machine.thread_pool import thread_count
from ...core.scene.camera import Camera
from ..exit_status import exit_status
from ..importer.cameras import look_through, set_camera
from ..importer.scene_builder import import_run
from ..world.light_to_world import world_from_map

WARM = 1  # samples per pixel of the warm-up image


def render(request: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Render the requested views, and return the seconds and CPU seconds of each image by its name."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene, seconds = bpy.context.scene, {}
    imported = import_run(Path(request["run"]), request["source"], pack=False)
    imported.root.matrix_world = Matrix()
    camera = bpy.data.objects.new("view", bpy.data.cameras.new("view"))
    scene.collection.objects.link(camera)
    _set_up(scene)
    for view, record in request["views"].items():
        set_camera(camera, Camera(**{**record, "to_world": np.array(record["to_world"])}))
        look_through(scene, camera)
        for light, file in request["lights"].items():
            scene.world = world_from_map(Path(file), light)
            _render_image(scene, WARM, False, Path(request["out"]) / "warm.exr")
            for number, settings in enumerate(request["passes"]):
                name = f"{view}_{light}_{number}"
                seconds[name] = _render_image(scene, settings["samples"], settings["denoise"], Path(request["out"]) / f"{name}.exr")
    return seconds


def _set_up(scene: bpy.types.Scene) -> None:
    scene.render.engine, scene.render.film_transparent = "CYCLES", True
    scene.render.use_persistent_data = True
    scene.render.threads_mode, scene.render.threads = "FIXED", thread_count()
    scene.cycles.device, scene.cycles.use_adaptive_sampling = "CPU", False
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"


def _render_image(scene: bpy.types.Scene, samples: int, denoise: bool, target: Path) -> tuple[float, float]:
    """Render one image and return its seconds and CPU seconds."""
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.denoiser = samples, denoise, "OPENIMAGEDENOISE"
    scene.render.filepath = str(target.resolve())
    began, cpu = time.perf_counter(), time.process_time()
    bpy.ops.render.render(write_still=True)
    return time.perf_counter() - began, time.process_time() - cpu


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    request, answer = sys.argv[1:] if argv is None else argv
    return exit_status(lambda: _answer(Path(request), Path(answer)))


def _answer(request: Path, answer: Path) -> None:
    """Render the images that a file asks for, and write their seconds into another one."""
    seconds = render(json.loads(request.read_text(encoding="utf-8")))
    answer.write_text(json.dumps(seconds), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
