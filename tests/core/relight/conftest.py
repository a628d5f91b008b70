# SPDX-License-Identifier: GPL-3.0-or-later
"""Two balls that shadow each other, as surfels and as a mesh."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
import trimesh
from irgspp.core.relight.gaussian_query import GaussianQuery
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.relight.relighter import Relighter
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.stages.first.initialization import surfels

BALLS = ((np.zeros(3), 1.0), (np.array([1.1, 0.0, 1.1]), 0.5))  # centre and radius of each
RADIUS = 2.0  # of the scene


def splat_ball(centre: np.ndarray, radius: float, count: int):
    z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * 2.39996322972865
    normal = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
    spacing = np.full(count, radius * np.sqrt(4 * np.pi / count))
    return surfels(centre + radius * normal, normal, np.full((count, 3), 0.5), spacing, 0.99)


def splat_scene(balls, material) -> Reconstruction:
    """Balls of one material (albedo 3, roughness, metallic)."""
    first, *others = (splat_ball(centre, radius, int(16_000 * radius**2)) for centre, radius in balls)
    for other in others:
        first = first.joined(other)
    first.material = torch.logit(torch.tensor(material).clamp(1e-6, 1 - 1e-6))[:, None].repeat(1, first.count)
    return Reconstruction(first, torch.full((16, 32, 3), 0.5), Bound((0, 0, 0), RADIUS), np.eye(4))


def mesh_scene(balls, material) -> Mesh:
    """The same balls as triangles."""
    meshes = [trimesh.creation.icosphere(5, radius) for _, radius in balls]
    for mesh, (centre, _) in zip(meshes, balls, strict=True):
        mesh.apply_translation(centre)
    mesh = trimesh.util.concatenate(meshes)
    n = len(mesh.vertices)
    albedo, roughness, metallic = np.tile(np.float32(material[:3]), (n, 1)), np.full(n, material[3]), np.full(n, material[4])
    arrays = (mesh.vertices, mesh.vertex_normals, np.zeros((n, 2)))
    floats = (a.astype(np.float32) for a in arrays)
    return Mesh(*floats, mesh.faces.astype(np.int32), albedo, roughness.astype(np.float32), metallic.astype(np.float32))


@pytest.fixture(scope="session")
def relighter() -> Callable[..., Relighter]:
    """Return a function (backend, material, balls, settings...) to a relighter."""

    def make(backend, material=(0.6, 0.4, 0.2, 0.7, 0.0), balls=BALLS, **settings) -> Relighter:
        scene = splat_scene(balls, material)
        mesh = MeshQuery(mesh_scene(balls, material), RADIUS) if backend == "mesh" else None
        return Relighter(scene, mesh or GaussianQuery(scene), RelightSettings(**{"samples": 64, **settings}), mesh)

    return make


@pytest.fixture(scope="session")
def camera() -> Camera:
    """Camera in front of both balls."""
    to_world = np.eye(4)
    to_world[:3, :3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)  # looks along +Y, up is +Z
    to_world[:3, 3] = (0.3, -5.0, 0.3)
    return Camera(80, 72, 100.0, 100.0, 40.0, 36.0, to_world)
