# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "IRGS++" of the 3D View's sidebar, from photographs to a relit object."""
