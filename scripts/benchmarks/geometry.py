# SPDX-License-Identifier: GPL-3.0-or-later
"""Section on geometry: angles between true normals and those of the Gaussians, of the mesh, and of relighting."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import torch
from irgspp.core.evaluation import metrics, visualisation
from irgspp.core.relight.backends import open_relighter
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.scene.mesh_ply import load_mesh_ply
from irgspp.core.scene.reconstruction import Reconstruction

from .bench import Bench, Scene
from .section import Block, Images, Measurement, Note, Table, Task
from .store import Results

NAME = "geometry"
TITLE = "Geometry"
ABOUT = (
    "Mean angle between estimated and true normals over the object's pixels of all test views, in degrees. Relighting shades with normals "
    "between those of Gaussians and mesh. Distances are point to plane, in scene units."
)
ONCE = False
PAPER = {"Gaussians": 3.980, "mesh": 4.260}  # IRGS++ on TensoIR's scenes
LIMIT = 20.0  # degrees at the end of the error images' colour scale


def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]:
    """Yield the measurement of a scene's normals, where their ground truth is known.

    Args:
        bench: options, scenes and reconstructions.
        scene: scene to measure.
    """
    assert scene is not None
    if scene.view_truth(scene.views[0]).normal is not None:
        yield Task("normals", partial(_normals, bench, scene), bench.evaluation_seconds, [bench.balanced()])


def _normals(bench: Bench, scene: Scene) -> Measurement:
    """Measure the normals' mean angular errors and the mesh's distances on the balanced run."""
    run = bench.run(scene, bench.balanced())
    reconstruction, mesh = Reconstruction.load(run.path), load_mesh_ply(run.path / "mesh.ply")
    query = MeshQuery(mesh, reconstruction.bound.radius)
    relighter = open_relighter(run.path, reconstruction, "mesh", RelightSettings())
    shaded, bare, shown = [], [], {}
    for number, view in enumerate(scene.views):
        truth = scene.view_truth(view)
        assert truth.normal is not None
        surface = relighter.surface(view.camera)
        lit = np.zeros((truth.normal[..., 0].size, 3), np.float32)
        lit[surface.index.numpy()] = surface.normal.numpy()
        of_mesh = mesh_normals(query, view.camera)
        angle = metrics.normal_angles(of_mesh, truth.normal)
        bare.append(angle[truth.object].mean())
        shaded.append(metrics.normal_angles(lit.reshape(truth.normal.shape), truth.normal)[truth.object].mean())
        if number == 0:
            shown = _images(truth.normal, of_mesh, angle * truth.object, truth.object)
    figures = bench.evaluation(scene, run.path)["figures"]
    names = ("mesh_chamfer", "mesh_accuracy", "mesh_completeness", "mesh_stray", "mesh_triangles")
    angles = {"gaussian_degrees": figures["normal_mae"], "mesh_degrees": float(np.mean(bare)), "shaded_degrees": float(np.mean(shaded))}
    return Measurement(angles | {n: figures[n] for n in names if n in figures}, {"views": len(bare)}, shown)


def mesh_normals(query: MeshQuery, camera) -> np.ndarray:
    """Return the mesh's unit normals where a camera sees it.

    Args:
        query: ray tracer of the mesh.
        camera: camera of H x W pixels.

    Returns:
        (H, W, 3) float32, 0 where no surface is hit.
    """
    direction = torch.nn.functional.normalize(torch.from_numpy(camera.rays().reshape(-1, 3)).float(), dim=1)
    hits = query.hits(torch.from_numpy(camera.centre).float().expand_as(direction), direction)
    normal = np.zeros((len(direction), 3), np.float32)
    normal[hits.ray.numpy()] = hits.normal.numpy()
    return normal.reshape(camera.height, camera.width, 3)


def _images(true: np.ndarray, ours: np.ndarray, angle: np.ndarray, inside: np.ndarray) -> dict[str, np.ndarray]:
    """Return encoded images of true normals, the mesh's and their error."""
    alpha = inside.astype(np.float32)
    shown = {
        "true": visualisation.normal(true, alpha),
        "mesh": visualisation.normal(ours, alpha),
        "error": visualisation.heat(angle, LIMIT),
    }
    return {name: visualisation.over(image, 0.16) for name, image in shown.items()}


def blocks(results: Results) -> Iterator[Block]:
    """Yield the table of angles and distances, and the images of normals."""
    columns = ("scene", "Gaussians ° ↓", "mesh ° ↓", "shaded ° ↓", "Chamfer ↓", "stray fraction ↓", "triangles")
    names = ("gaussian_degrees", "mesh_degrees", "shaded_degrees", "mesh_chamfer", "mesh_stray", "mesh_triangles")
    rows = [[r.scene, *(r.figures.get(name) for name in names)] for r in results.records()]
    if rows:
        yield Table("Normal error and distances", columns, rows)
        yield Note(f"The paper reports {PAPER['Gaussians']}° (Gaussians) and {PAPER['mesh']}° (mesh) on other scenes.")
    shown = [[(f"{r.scene}: {name}", file) for name, file in r.images.items()] for r in results.records()]
    if shown:
        yield Images(f"Normals of the mesh; error from 0 (dark) to {LIMIT:.0f}°", shown)
