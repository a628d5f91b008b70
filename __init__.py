# SPDX-License-Identifier: GPL-3.0-or-later
"""Inverse rendering with 2D Gaussians for Blender: photographs in, a relightable object out.

    import irgspp
    irgspp.capture(photographs, folder, irgspp.Settings().capture)
    dataset = irgspp.load_dataset(folder)
    irgspp.reconstruct(folder, run_folder, irgspp.Settings())

This folder is both the Python package and the Blender extension; importing it loads neither bpy nor torch.
"""

from importlib import import_module
from typing import Any

# Public interface of the package for scripts: name -> module, imported at first use.
_PUBLIC = {
    "Settings": ".core.settings.schema",
    "preset": ".core.settings.schema",
    "load_dataset": ".core.datasets.load",
    "capture": ".core.capture.capture",
    "reconstruct": ".core.pipeline",
    "evaluate": ".core.evaluation.report",
    "export": ".core.assets.export",
}


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(_PUBLIC[name], __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})


def register() -> None:
    """Register the extension; called by Blender when it is enabled."""
    from .panels import registration

    registration.register()


def unregister() -> None:
    """Unregister the extension; called by Blender when it is disabled."""
    from .panels import registration

    registration.unregister()
