# SPDX-License-Identifier: GPL-3.0-or-later
"""Torus of surfels with photographs and a mesh: a workload for a GPU that needs no download."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.rendering.gbuffer import render_gbuffer
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound, Dataset, View
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.shading.procedural_lights import sky_light
from irgspp.core.stages.first.initialization import surfels

MAJOR, MINOR, RADIUS = 1.0, 0.4, 1.6
VIEWS = 24


@dataclass(frozen=True, eq=False)
class Work:
    """Torus as the two stages and relighting take it.

    Attributes:
        reconstruction: surfels and light.
        dataset: photographs rendered from the surfels.
        mesh: the torus as triangles.
    """

    reconstruction: Reconstruction
    dataset: Dataset
    mesh: Mesh


def make_work(gaussians: int, size: int, triangles: int, device: torch.device) -> Work:
    """Return the torus.

    Args:
        gaussians: number of surfels.
        size: pixels along a side of the photographs.
        triangles: about how many triangles the mesh has.
        device: device of the reconstruction.
    """
    rng = np.random.default_rng(0)
    angles = rng.uniform(0, 2 * np.pi, (2, 3 * gaussians))
    fair = rng.random(3 * gaussians) * (MAJOR + MINOR) < MAJOR + MINOR * np.cos(angles[1])  # uniform by area
    a, b = angles[:, fair][:, :gaussians]
    normal = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], 1)
    points = MAJOR * np.stack([np.cos(a), np.sin(a), np.zeros(len(a))], 1) + MINOR * normal
    spacing = np.full(len(a), math.sqrt(4 * np.pi**2 * MAJOR * MINOR / len(a)))
    colour = 0.5 + 0.3 * np.sin(3 * np.stack([a, b, a + b], 1))
    splats = surfels(points, normal, colour, 1.5 * spacing, 0.9)
    bound = Bound((0.0, 0.0, 0.0), RADIUS)
    reconstruction = Reconstruction(splats, torch.from_numpy(sky_light(64, 128)), bound, np.eye(4)).to(device)
    views = [_photograph(reconstruction, camera, i) for i, camera in enumerate(ring(VIEWS, size))]
    dataset = Dataset(Path("torus"), "transforms", views, [], bound, np.eye(4), None)
    return Work(reconstruction, dataset, _mesh(triangles))


def ring(count: int, size: int) -> list[Camera]:
    """Return cameras around the torus at several heights.

    Args:
        count: number of cameras.
        size: pixels along a side of the images.
    """
    z, angle = np.linspace(-0.6, 0.9, count), np.arange(count) * 2.399963
    r = np.sqrt(1 - z**2)
    places = 4 * np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)
    return [Camera(size, size, 1.3 * size, 1.3 * size, size / 2, size / 2, look_at(place)) for place in places]


def _photograph(reconstruction: Reconstruction, camera: Camera, number: int) -> View:
    """Render the surfels as a photograph."""
    rgba = render_gbuffer(reconstruction, camera).image
    straight = rgba[..., :3] / np.maximum(rgba[..., 3:], 1e-4)
    return View(f"{number}", camera, Path(f"{number}.png"), encode_srgb(straight).clip(0, 1).astype(np.float32), rgba[..., 3].copy())


def _mesh(triangles: int) -> Mesh:
    """Return the torus as a mesh of one material."""
    sections = max(8, round(math.sqrt(triangles / 2)))
    torus = trimesh.creation.torus(MAJOR, MINOR, sections, sections)
    n = len(torus.vertices)
    vertices, normals = (np.asarray(x, np.float32) for x in (torus.vertices, torus.vertex_normals))
    albedo, rough, metal = np.full((n, 3), 0.6, np.float32), np.full(n, 0.4, np.float32), np.zeros(n, np.float32)
    return Mesh(vertices, normals, np.zeros((n, 2), np.float32), np.asarray(torus.faces, np.int32), albedo, rough, metal)
