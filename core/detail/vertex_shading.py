# SPDX-License-Identifier: GPL-3.0-or-later
"""Shading of a mesh's vertices by the solved light, seen from a camera: radiance = albedo * factor + gloss.

The factor holds the diffuse lobe and, for a metal, the specular lobe; shadows and one bounce of indirect light are traced on the mesh.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from ..relight.mesh_query import CLEARANCE
from ..relight.prepared_light import prepare_light
from ..relight.primary_hits import PrimaryHits
from ..relight.relighter import Relighter
from ..scene.camera import Camera
from ..scene.mesh import Mesh
from ..shading.environment_lookup import turned
from ..shading.specular_albedo import diffuse_fraction
from ..surface.topology import adjacency

DIFFUSE_SAMPLES = 256  # per vertex, once
GLOSS_SAMPLES = 48  # per vertex and view
NO_METAL = 0.02  # metallic up to which a mesh is none: its reflections have no colour of their own
SMOOTHING = 2  # passes that average the gloss of neighbouring vertices, which removes the noise of few samples


@dataclass(frozen=True, eq=False)
class ViewShading:
    """Shading of V vertices towards one camera, float32.

    Attributes:
        factor: (V, 3) radiance per albedo; 0 where the vertex faces away.
        gloss: (V, 3) linear radiance of the light that a dielectric surface reflects.
    """

    factor: np.ndarray
    gloss: np.ndarray


class VertexShading:
    """Shading of all vertices of a mesh under a light.

    Args:
        mesh: mesh with materials at its vertices.
        relighter: relighter of the reconstruction, whose secondary rays are traced on the mesh.
        light: (H, W, 3) map of the solved light.
        radius: scene radius, world units.
    """

    def __init__(self, mesh: Mesh, relighter: Relighter, light: np.ndarray, radius: float) -> None:
        self._mesh, self._map, self._light, self._radius = mesh, light, prepare_light(light), radius
        self._diffuse, self._gloss = relighter.with_samples(DIFFUSE_SAMPLES), relighter.with_samples(GLOSS_SAMPLES)

    @cached_property
    def irradiance(self) -> np.ndarray:
        """Irradiance / pi of the vertices, (V, 3) float32, with shadows and indirect light."""
        everything = np.arange(len(self._mesh.vertices))
        normal = self._mesh.normals.astype(np.float32)
        points = self._points(everything, normal)
        white = replace(points, albedo=torch.ones_like(points.normal), metallic=torch.zeros(len(everything)))
        return self._diffuse.reflected(white, self._light).diffuse.cpu().numpy().astype(np.float32)

    def seen_by(self, camera: Camera, light_rotation: np.ndarray | None = None) -> ViewShading:
        """Return the shading towards a camera.

        Args:
            camera: the camera.
            light_rotation: (3, 3) from the world to the frame of the light; None where the light stands still.
        """
        mesh, count = self._mesh, len(self._mesh.vertices)
        view = camera.centre - mesh.vertices.astype(np.float64)
        view = (view / np.maximum(np.linalg.norm(view, axis=-1, keepdims=True), 1e-12)).astype(np.float32)
        facing = (view * mesh.normals).sum(-1)
        index = np.flatnonzero(facing > 0)
        points = self._points(index, view[index])
        diffuse, metal, gloss = self._reflected(points, light_rotation)
        if light_rotation is None:  # what does not depend on the view is known by more samples
            cosine = torch.from_numpy(facing[index])
            fraction = diffuse_fraction(cosine, points.roughness).numpy()[:, None] if self._gloss.conserving else 1.0
            diffuse = (1 - mesh.metallic[index, None]) * fraction * self.irradiance[index]
        layers = np.zeros((2, count, 3), np.float32)
        layers[0, index], layers[1, index] = diffuse + metal, gloss
        smooth = self._smoothed(layers, facing > 0)
        return ViewShading(smooth[0], smooth[1])

    def _reflected(self, points: PrimaryHits, light_rotation: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what P points reflect, (P, 3) each: by the diffuse lobe and as metal, both per albedo, and as a dielectric's gloss."""
        light = self._light if light_rotation is None else prepare_light(turned(self._map, light_rotation))
        white = replace(points, albedo=torch.ones_like(points.normal))
        if float(self._mesh.metallic.max()) <= NO_METAL:
            found = self._gloss.reflected(replace(white, metallic=torch.zeros_like(points.metallic)), light)
            gloss = found.specular.cpu().numpy()
            return found.diffuse.cpu().numpy(), np.zeros_like(gloss), gloss
        gloss = self._gloss.reflected(replace(points, albedo=torch.zeros_like(points.normal)), light).specular.cpu().numpy()
        found = self._gloss.reflected(white, light)
        return found.diffuse.cpu().numpy(), found.specular.cpu().numpy() - gloss, gloss

    def _points(self, index: np.ndarray, view: np.ndarray) -> PrimaryHits:
        """Pack vertices into `PrimaryHits`, so that the relighter can shade them.

        The relighter takes the random shift of a point's samples from its pixel, so each vertex gets a pixel of its own in a square image.
        The camera is a placeholder that only tells the width of this image: its lens and pose are not used.

        Args:
            index: (P,) the vertices.
            view: (P, 3) unit directions towards the viewer.
        """
        mesh, count = self._mesh, len(index)
        width = max(1, math.isqrt(max(count - 1, 0)) + 1)
        camera = Camera(width, width, 1.0, 1.0, 0.0, 0.0, np.eye(4))
        arrays = mesh.vertices[index], mesh.normals[index], view, mesh.albedo[index], mesh.roughness[index], mesh.metallic[index]
        point, normal, towards, albedo, rough, metal = (torch.from_numpy(np.ascontiguousarray(a, np.float32)) for a in arrays)
        ones, origin = torch.ones(count), point + CLEARANCE * self._radius * normal
        pixel = torch.arange(count)
        return PrimaryHits(camera, pixel, -towards, towards, point, ones, normal, albedo, rough, metal, ones, ones[None], origin)

    def _smoothed(self, layers: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Average layers (2, V, 3) over neighbouring vertices that are `known` (V,), also across UV seams."""
        values = np.concatenate([layers[0], layers[1]], -1)
        for _ in range(SMOOTHING):
            total, weight = self._sums(values * known[:, None], known.astype(np.float64))
            values = np.where(known[:, None], total / np.maximum(weight, 1e-9)[:, None], values)
        return np.stack([values[:, :3], values[:, 3:]]).astype(np.float32)

    def _sums(self, values: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return sums over each vertex and its neighbours."""
        matrix = self._neighbours
        return matrix @ values, matrix @ weight

    @cached_property
    def _neighbours(self):
        """Sparse (V, V) matrix that sums over the vertices at the same place and at the other ends of their edges."""
        from scipy.sparse import coo_matrix, identity

        _, place = np.unique(self._mesh.vertices, axis=0, return_inverse=True)
        place = place.ravel()
        places = int(place.max()) + 1
        joined = adjacency(place[self._mesh.faces], places) + identity(places, format="csr")
        mean = coo_matrix((1 / np.bincount(place)[place], (place, np.arange(len(place)))), (places, len(place))).tocsr()
        return (joined @ mean)[place]
