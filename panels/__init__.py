# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of the tab "IRGS++" in the 3D View's sidebar, from photographs to a relit object."""

from . import dataset, engine, jobs, reconstruct, relight, result

CLASSES = (*engine.CLASSES, *dataset.CLASSES, *reconstruct.CLASSES, *result.CLASSES, *relight.CLASSES, *jobs.CLASSES)
