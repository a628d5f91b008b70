# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of the tab "IRGS++" in the 3D View's sidebar, from photographs to a relit object, and of masks in the Image Editor's."""

from . import dataset, engine, jobs, mask, reconstruct, relight, result

CLASSES = (*engine.CLASSES, *dataset.CLASSES, *reconstruct.CLASSES, *result.CLASSES, *relight.CLASSES, *jobs.CLASSES, *mask.CLASSES)
