# SPDX-License-Identifier: GPL-3.0-or-later
"""The built-in scenes by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import bpy

from .bowl_scene import build_bowl_scene
from .demo_scene import build_demo_scene
from .print_scene import build_print_scene
from .relief_scene import build_relief_scene
from .thin_scene import build_thin_scene
from .vase_scene import build_vase_scene

SCENES: dict[str, Callable[[], list[bpy.types.Object]]] = {
    "demo": build_demo_scene,
    "low-gloss": partial(build_demo_scene, "low-gloss"),
    "glossy": partial(build_demo_scene, "glossy"),
    "bowl": build_bowl_scene,
    "relief": build_relief_scene,
    "print": build_print_scene,
    "thin": build_thin_scene,
    "vase": build_vase_scene,
    "glazed-vase": partial(build_vase_scene, "mixed"),
}
