# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels: the tab "IRGS++" of the 3D View's sidebar, masks in the Image Editor's, and the render engine's in the Render tab."""

from . import asset, cameras, engine, export, headline, jobs, mask, photographs, reconstruct, relight, render_properties, result

SIDEBAR = (
    *headline.CLASSES,
    *engine.CLASSES,
    *photographs.CLASSES,
    *cameras.CLASSES,
    *reconstruct.CLASSES,
    *result.CLASSES,
    *relight.CLASSES,
    *export.CLASSES,
    *asset.CLASSES,
    *jobs.CLASSES,
)
CLASSES = (*SIDEBAR, *mask.CLASSES, *render_properties.CLASSES)
