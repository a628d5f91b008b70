# SPDX-License-Identifier: GPL-3.0-or-later
"""Check of a run's asset for defects that production tools refuse or show: geometry, UVs and textures, as lines of text and JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..io.atomic import write_atomic
from ..scene.mesh import Mesh
from ..scene.mesh_ply import load_mesh_ply
from ..scene.textures import CHANNELS, OPTIONAL, load_textures
from .mesh_defects import Geometry, geometry_of
from .uv_defects import UvLayout, uv_layout_of

UNEVEN = 2.0  # the texel density of 90 % of the surface may differ from the median by this factor


@dataclass(frozen=True)
class Check:
    """Outcome of one check.

    Attributes:
        name: what is checked.
        defects: number of defects; 0 where the asset passes.
        found: what was found, in words.
    """

    name: str
    defects: int
    found: str


def check_asset(run: Path, output: Path | None = None) -> dict[str, Any]:
    """Check the mesh and the textures of a run, and write `asset.json`.

    Args:
        run: folder of the finished run.
        output: folder of the report; `run/evaluation` where it is None.

    Returns:
        Content of the JSON: "run", "defects" (their number), "checks" (name, defects and found of each), "geometry" and "uvs" (see
        `Geometry` and `UvLayout`), "textures" (texels along a side by name).

    Raises:
        InputError: when the run has no readable mesh or textures, or the report can't be written.
    """
    mesh, textures = load_mesh_ply(run / "mesh.ply"), load_textures(run / "textures")
    if not len(mesh.faces):
        raise InputError(run / "mesh.ply", "has no faces", "run the reconstruction again")
    report = {"run": str(run.resolve()), **asset_report(mesh, textures)}
    folder = output or run / "evaluation"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_atomic(folder / "asset.json", json.dumps(report, indent=1).encode())
    except OSError as error:
        raise InputError(folder, f"the report can't be written there ({error.strerror})", "choose another folder") from error
    return report


def asset_report(mesh: Mesh, textures: dict[str, np.ndarray]) -> dict[str, Any]:
    """Check a mesh of at least one face and its textures; return all that `check_asset` does but "run"."""
    sizes = {name: max(texture.shape[:2]) for name, texture in textures.items()}
    geometry, layout = geometry_of(mesh), uv_layout_of(mesh, max(sizes.values(), default=1024))
    checks = [*_geometry_checks(geometry), *_uv_checks(layout, geometry), *_texture_checks(textures)]
    return {
        "defects": sum(check.defects for check in checks),
        "checks": [asdict(check) for check in checks],
        "geometry": asdict(geometry),
        "uvs": asdict(layout),
        "textures": sizes,
    }


def asset_lines(report: dict[str, Any]) -> str:
    """Return a line of text for each check of a report, and one for their sum."""
    rows = [f"{'ok' if check['defects'] == 0 else 'DEFECT':8s}{check['name']:22s}{check['found']}" for check in report["checks"]]
    return "\n".join([*rows, f"{report['defects']} defects" if report["defects"] != 1 else "1 defect"])


def _geometry_checks(g: Geometry) -> list[Check]:
    ends = f"{g.borders} open ends, {g.border_edges:,} edges" if g.borders else "watertight" if not g.border_edges else "no open ends"
    shares = ", ".join(f"{100 * x:.3g} %" for x in g.component_areas[:4])
    floating = f"{g.floaters} of them float, smaller than 1 % of the largest"
    return [
        Check("manifold edges", g.non_manifold_edges, f"{g.non_manifold_edges:,} edges of three or more faces"),
        Check("manifold vertices", g.non_manifold_vertices, f"{g.non_manifold_vertices:,} points where parts of the surface only touch"),
        Check("holes", g.holes, f"{g.holes:,} holes; {ends}"),
        Check("components", g.floaters, f"{len(g.component_areas):,} of {shares} of the area; {floating}"),
        Check("winding", g.flipped + g.inside_out, f"{g.flipped:,} faces against their neighbours, {g.inside_out} parts inside out"),
        Check("folded faces", g.folded, f"{g.folded:,} of {g.faces:,} faces turned away from their vertices' normals"),
        Check("zero-area faces", g.flat, f"{g.flat:,} faces without area or height"),
        Check("repeated faces", g.repeated_faces, f"{g.repeated_faces:,} faces on the points of another one"),
        Check("repeated vertices", g.doubled_vertices + g.near_vertices + g.unused_vertices, _vertices(g)),
    ]


def _vertices(g: Geometry) -> str:
    return f"{g.doubled_vertices:,} doubled, {g.near_vertices:,} nearly at one point, {g.unused_vertices:,} unused"


def _uv_checks(uvs: UvLayout, g: Geometry) -> list[Check]:
    low, median, high = uvs.density
    uneven = low * UNEVEN < median or high > UNEVEN * median or median == 0
    spread = f"90 % of the surface between {low / median:.2f} and {high / median:.2f} of it" if median else "the UVs have no area"
    overlap = int(np.ceil(uvs.overlap * g.faces)) if uvs.overlap else 0
    return [
        Check("UV overlap", overlap, f"{100 * uvs.overlap:.3g} % of the charts' area is covered twice; {uvs.charts:,} charts"),
        Check("UV range", uvs.outside, f"{uvs.outside:,} vertices outside the texture; {100 * uvs.covered:.0f} % of it is used"),
        Check("UV faces", uvs.unmapped + uvs.mirrored, f"{uvs.unmapped:,} faces without texels, {uvs.mirrored:,} mirrored"),
        Check("texel density", int(uneven), f"median {median:.4g} texels per unit, {median * g.diameter:.4g} per diameter; {spread}"),
    ]


def _texture_checks(textures: dict[str, np.ndarray]) -> list[Check]:
    needed = [name for name in CHANNELS if name not in OPTIONAL]
    missing = [name for name in needed if name not in textures]
    shapes = {texture.shape[:2] for texture in textures.values()}
    odd = len(shapes) > 1 or any(height != width for height, width in shapes)
    sizes = ", ".join(f"{name} {texture.shape[1]}x{texture.shape[0]}" for name, texture in textures.items())
    return [
        Check("textures", len(missing), f"missing: {', '.join(missing)}" if missing else f"all {len(textures)} there"),
        Check("texture sizes", int(odd), sizes or "none"),
    ]
