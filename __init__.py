# SPDX-License-Identifier: GPL-3.0-or-later
"""IRGS++ for Blender: photographs in, a relightable Blender object out.

    import irgspp
    dataset = irgspp.load_dataset(folder)
    irgspp.reconstruct(folder, run_folder, irgspp.Settings())

This folder is both the Python package and the Blender extension; importing it loads neither bpy nor torch.
"""

from importlib import import_module
from typing import Any

# What scripts use, and where it is; loaded when it is asked for.
_FACE = {
    "Settings": ".core.settings.schema",
    "preset": ".core.settings.schema",
    "load_dataset": ".core.datasets.load",
    "reconstruct": ".core.pipeline",
    "evaluate": ".core.evaluation.report",
    "export": ".core.assets.export",
}


def __getattr__(name: str) -> Any:
    if name not in _FACE:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(_FACE[name], __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_FACE})


def register() -> None:
    """Called by Blender when the extension is enabled."""
    from .panels import registration

    registration.register()


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
    from .panels import registration

    registration.unregister()
