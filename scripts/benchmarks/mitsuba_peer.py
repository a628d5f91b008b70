# SPDX-License-Identifier: GPL-3.0-or-later
"""Client of Mitsuba 3, which runs in a process of its own because its compiler and numba's do not work well in one process."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from irgspp.core.errors import IrgsppError
from irgspp.core.machine.thread_pool import thread_count
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.mesh_ply import load_mesh_ply
from irgspp.core.scene.textures import load_textures
from irgspp.core.shading.specular_albedo import TABLE, diffuse_fraction

VARIANTS = ("llvm_ad_rgb", "scalar_rgb")  # the first that works is used; the second has neither our BRDF nor gradients
BOUNCES = 12  # as Cycles
PROBE = "import mitsuba as mi; mi.set_variant('{}'); mi.render(mi.load_dict(mi.cornell_box()), spp=1).numpy(); print(mi.__version__)"


class Crashed(IrgsppError):
    """Error: a signal ended the process that Mitsuba ran in."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Image of a renderer and the time it took with the scene loaded.

    Attributes:
        samples: samples per pixel.
        seconds: wall clock.
        cpu_seconds: CPU time of all threads.
        rgba: (H, W, 4) linear premultiplied.
        denoised: True where it is denoised.
    """

    samples: int
    seconds: float
    cpu_seconds: float
    rgba: np.ndarray
    denoised: bool = False


@dataclass(frozen=True, eq=False)
class Shots:
    """Images of one view under one light.

    Attributes:
        frames: a frame for each number of samples.
        converged: (H, W, 4) linear premultiplied, or None.
        layers: material layers by name, (H, W, 3) or (H, W).
    """

    frames: list[Frame]
    converged: np.ndarray | None
    layers: dict[str, np.ndarray]


def missing() -> str:
    """Return the reason why Mitsuba can't be used; "" where it can."""
    if importlib.util.find_spec("mitsuba") is None:
        return "Mitsuba is not installed (the extra `peers`)"
    try:
        variant()
    except IrgsppError as error:
        return str(error)
    return ""


@cache
def variant() -> tuple[str, str]:
    """Return the variant that works here, and Mitsuba's version.

    Raises:
        IrgsppError: where no variant works.
    """
    last_line = ""
    for name in VARIANTS:
        probe = subprocess.run([sys.executable, "-c", PROBE.format(name)], capture_output=True, text=True, errors="replace")
        if probe.returncode == 0:
            return name, probe.stdout.strip()
        last_line = (probe.stderr.strip().splitlines() or [f"status {probe.returncode}"])[-1]
    raise IrgsppError(f"Mitsuba does not work here: {last_line}")


def described() -> str:
    """Return version and variant of Mitsuba for the report."""
    name, version = variant()
    return f"{version}, {name}" + ("" if name == VARIANTS[0] else ", which knows no BRDF but its own (principled), and no gradients")


def textured(run: Path) -> dict[str, np.ndarray]:
    """Return the exported asset of a run: vertices, normals (V, 3), uvs (V, 2), faces (F, 3), and textures as texture_<name>."""
    mesh = load_mesh_ply(run / "mesh.ply")
    textures = {f"texture_{name}": texture for name, texture in load_textures(run / "textures").items()}
    return {"vertices": mesh.vertices, "normals": mesh.normals, "uvs": mesh.uvs, "faces": mesh.faces, **textures}


def welded(run: Path) -> dict[str, np.ndarray]:
    """Return the mesh of a run with one vertex for all vertices at the same position, which the charts of its UVs had split."""
    mesh = load_mesh_ply(run / "mesh.ply")
    _, first, same = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    return {"vertices": mesh.vertices[first], "normals": mesh.normals[first], "faces": same.reshape(-1)[mesh.faces]}


def images(
    asset: Mapping[str, np.ndarray],
    views: Mapping[str, Camera],
    lights: Mapping[str, np.ndarray],
    counts: Sequence[int],
    converged: int = 0,
    brdf: str = "ours",
    bounces: int = BOUNCES,
    layers: int = 0,
) -> dict[tuple[str, str], Shots]:
    """Render every view under every light by Mitsuba.

    Args:
        asset: `textured`, or `welded` with vertex_albedo (V, 3), vertex_roughness and vertex_metallic (V,).
        views: cameras by name.
        lights: linear lat-long maps (H, W, 3) by name.
        counts: samples per pixel of the frames.
        converged: samples per pixel of the converged image; 0 for none.
        brdf: "ours" or "principled".
        bounces: bounces of indirect light.
        layers: samples per pixel of the material layers; 0 for none.

    Returns:
        Images by (view, light).
    """
    request = {
        "views": {name: {**vars(camera), "to_world": camera.to_world.tolist()} for name, camera in views.items()},
        "lights": list(lights),
        "counts": list(counts),
        "converged": converged,
        "brdf": brdf if variant()[0] == VARIANTS[0] else "principled",
        "bounces": bounces,
        "layers": layers,
    }
    arrays = {**asset, **{f"light_{name}": light for name, light in lights.items()}}
    answer, found = run_child("mitsuba_views", request, arrays)

    def shots(stem: str) -> Shots:
        """Collect the images of one view and light."""
        times = {n: answer["seconds"][f"{stem}_{n}"] for n in counts}
        frames = [Frame(n, times[n][0], times[n][1], found[f"{stem}_{n}"]) for n in counts]
        return Shots(frames, found.get(f"{stem}_converged"), {name: found[f"{stem}_{name}"] for name in answer["layers"]})

    return {(view, light): shots(f"{view}_{light}") for view in views for light in lights}


def run_child(module: str, request: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Run a module of this package in a process of its own.

    Args:
        module: name of the module.
        request: content of its request.json, besides variant and threads.
        arrays: content of its arrays.npz, of any shapes (...,).

    Returns:
        Its answer.json, and the arrays it wrote by name.

    Raises:
        Crashed: where a signal ended the process.
        IrgsppError: where it ended with an error.
    """
    with tempfile.TemporaryDirectory(prefix="irgspp-mitsuba-") as name:
        folder = Path(name)
        about = {"variant": variant()[0], "threads": thread_count(), **request}
        (folder / "request.json").write_text(json.dumps(about), encoding="utf-8")
        np.savez(folder / "arrays.npz", **arrays, body=_body())
        command = [sys.executable, "-m", f"{__package__}.{module}", str(folder)]
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
        child = subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace")
        if child.returncode < 0:
            raise Crashed(f"{module} was ended by signal {-child.returncode}")
        if child.returncode:
            last_line = (child.stderr.strip().splitlines() or ["no message"])[-1]
            raise IrgsppError(f"{module} ended with status {child.returncode}: {last_line}")
        answer = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
        return answer, {path.stem: np.load(path) for path in folder.glob("*.npy")}


@cache
def _body() -> np.ndarray:
    """Return the fraction that the specular lobe leaves to the diffuse one, over roughness (rows) and n.v (columns)."""
    grid = torch.linspace(0, 1, TABLE)
    rows, columns = torch.meshgrid(grid, grid, indexing="ij")
    return diffuse_fraction(columns.flatten(), rows.flatten()).view(TABLE, TABLE).numpy()
