# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh that the textures of a finished run are baked onto."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError


@dataclass(frozen=True)
class BakeTarget:
    """Mesh to bake onto, and optional textures.

    Attributes:
        triangles: largest number of triangles of a new mesh that is extracted from the Gaussians; None for none.
        edited: PLY in the run's world frame that replaces the mesh; None for none.
        quads: approximate number of quads that the run's mesh is remeshed to; None for none.
        height: True to bake the height of the surface as it is fused above the mesh.
    """

    triangles: int | None = None
    edited: Path | None = None
    quads: int | None = None
    height: bool = False

    @property
    def keeps_mesh(self) -> bool:
        """True where the run's mesh stays."""
        return self.triangles is None and self.edited is None and self.quads is None

    def check(self) -> None:
        """Raise InputError where more than one mesh is asked for."""
        meshes = {"--triangles": self.triangles, "--mesh": self.edited, "--quads": self.quads}
        given = [name for name, value in meshes.items() if value is not None]
        if len(given) > 1:
            raise InputError(given[0], f"can't be combined with {given[1]}", "give one of them")
