# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance transfer of the mesh's vertices: how much light reaches each vertex, with shadows and interreflections, under any light.

Secondary rays hit surfaces that are themselves in shadow and lit by others. The paper shades them by the unoccluded light, which is far too
bright in hollows. Here rays over each vertex's hemisphere are traced once; every light is then summed along them (Sloan et al. 2002,
"Precomputed radiance transfer", with rays in place of a basis, so that nothing rings).
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
import torch
from scipy.spatial import KDTree

from ..kernels.cpu.vertex_light import bounce_range, visible_light_range
from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..scene.mesh import Mesh
from ..shading.environment_lookup import direction_to_uv, lookup_at
from ..shading.sampling import cosine_directions
from .mesh_tracer import MeshTracer
from .prepared_light import PreparedLight
from .sample_counts import pixel_shifts

RAYS_PER_VERTEX = 32  # per vertex; 96 change relit images by 0.02 dB
BOUNCES = 3  # between vertices; 6 change relit images by 0.01 dB
CLEARANCE = 0.004  # distance of ray origins from the vertices, as a fraction of the scene radius
DIRECTION_ROWS = 64  # of the grid of texels in which the directions of rays are kept
SPECULAR_LEVEL = 2  # of the specular stack that rays see: a lobe about as wide as the space between the rays
VERTICES_AT_A_TIME = 1 << 15  # vertices whose rays are traced at a time


class VertexTransfer:
    """Rays of all vertices of a mesh, traced once.

    Args:
        mesh: triangles with albedo at their vertices.
        tracer: tracer of rays on the mesh.
        radius: scene radius, world units.
        device: device of the rays and of the lights.

    Attributes:
        count: number of vertices, V.
    """

    def __init__(self, mesh: Mesh, tracer: MeshTracer, radius: float, device: torch.device | str = "cpu") -> None:
        self.count = len(mesh.vertices)
        self._vertices, self._tree = mesh.vertices, None
        self._normal = torch.from_numpy(np.ascontiguousarray(mesh.normals, np.float32)).to(device)
        self._place = direction_to_uv(self._normal)
        self._albedo = torch.from_numpy(np.ascontiguousarray(mesh.albedo, np.float32)).to(device)
        self._faces = torch.from_numpy(mesh.faces.astype(np.int64)).to(device)
        origin = torch.from_numpy(np.ascontiguousarray(mesh.vertices, np.float32)).to(device) + CLEARANCE * radius * self._normal
        parts = [self._traced(origin, tracer, begin) for begin in range(0, max(self.count, 1), VERTICES_AT_A_TIME)]
        self._texel, self._vertex = (torch.cat(rows).int().contiguous() for rows in zip(*parts, strict=True))
        self._lit: WeakKeyDictionary[PreparedLight, tuple[torch.Tensor, torch.Tensor]] = WeakKeyDictionary()

    def light(self, light: PreparedLight, scale: torch.Tensor) -> torch.Tensor:
        """Return the light at all vertices, kept for the next call with the same light and the same tensor `scale`.

        Args:
            light: the light, possibly rotated.
            scale: (3,) factors of the albedo.

        Returns:
            (V, 4) float32: irradiance / pi with shadows and interreflections, and its brightness as a fraction, at most 1, of that of the
            unoccluded irradiance, by which reflections at the vertex are darkened.
        """
        kept = self._lit.get(light)
        if kept is None or kept[0] is not scale:
            unoccluded = light.irradiance_at(*self._place) / torch.pi
            arriving = (self.arriving if by_warp(scale) else self._by_kernels)(light, scale, unoccluded)
            fraction = (arriving.mean(1) / unoccluded.mean(1).clamp_min(1e-30)).clamp(0, 1)
            kept = self._lit[light] = scale, torch.cat([arriving, fraction[:, None]], 1).contiguous()
        return kept[1]

    def nearest(self, point: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the vertices nearest to points as corners of degenerate triangles.

        Args:
            point: (K, 3) world.

        Returns:
            (K, 3) int32 vertices and (K, 3) weights 1, 0, 0.
        """
        self._tree = self._tree or KDTree(self._vertices)
        vertex = torch.from_numpy(self._tree.query(point.cpu().numpy(), workers=thread_count())[1]).to(point.device, torch.int32)
        return vertex[:, None].repeat(1, 3), point.new_tensor([1.0, 0.0, 0.0]).repeat(len(point), 1)

    def arriving(self, light: PreparedLight, scale: torch.Tensor, unoccluded: torch.Tensor) -> torch.Tensor:
        """Return the irradiance / pi of all vertices (V, 3) by PyTorch operations: on a GPU, and the reference of the kernels.

        The unoccluded light is known exactly, so that rays have to find only the fraction that is visible (see `estimate_reflected_light`).

        Args:
            light: the light, possibly rotated.
            scale: (3,) factors of the albedo; its floating type is that of the result.
            unoccluded: (V, 3) irradiance / pi without occlusion.
        """
        along = _grid(light).to(scale)[self._texel.long()]
        hit, vertex = (self._vertex >= 0)[..., None], self._vertex.long().clamp_min(0)
        total = along.sum(1)
        visible = torch.where(total > 0, unoccluded * along.masked_fill(hit, 0.0).sum(1) / total, 0.0)
        arriving = visible
        for _ in range(BOUNCES):
            reflected = torch.cat([self._albedo * scale * arriving, scale.new_zeros(1, 3)])
            arriving = visible + torch.where(hit, reflected[vertex], 0.0).mean(1)
        return arriving

    def _by_kernels(self, light: PreparedLight, scale: torch.Tensor, unoccluded: torch.Tensor) -> torch.Tensor:
        """Return `arriving`, computed by the kernels of the CPU."""
        texel, vertex, albedo = self._texel.numpy(), self._vertex.numpy(), (self._albedo * scale).numpy()
        parts = even_ranges(self.count, 4 * thread_count())
        visible, reflected = np.empty((self.count, 3), np.float32), np.zeros((self.count + 1, 3), np.float32)
        run_ranges(visible_light_range, parts, texel, vertex, _grid(light).numpy(), unoccluded.contiguous().numpy(), visible)
        arriving = visible.copy()
        for _ in range(BOUNCES):
            np.multiply(albedo, arriving, out=reflected[:-1])
            run_ranges(bounce_range, parts, vertex, visible, reflected, arriving)
        return torch.from_numpy(arriving)

    def _traced(self, origin: torch.Tensor, tracer: MeshTracer, begin: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Trace the rays of VERTICES_AT_A_TIME vertices from number `begin` on.

        Returns:
            (P, RAYS_PER_VERTEX) texels of the grid in the rays' directions, and of the same shape vertices next to their hits, -1 for none;
            rays with hits come first. A ray that hits the back of a triangle, from inside the object, gets vertex V, which is black.
        """
        index = torch.arange(begin, min(begin + VERTICES_AT_A_TIME, self.count), device=origin.device)
        direction = cosine_directions(self._normal[index], RAYS_PER_VERTEX, pixel_shifts(index, self.count)).view(-1, 3)
        start = origin[index, None].expand(-1, RAYS_PER_VERTEX, 3).reshape(-1, 3)
        triangle, u, v, _ = tracer.closest(start, direction)
        place_u, place_v = direction_to_uv(direction)
        row, column = ((x * size).long().clamp(0, size - 1) for x, size in ((place_v, DIRECTION_ROWS), (place_u, 2 * DIRECTION_ROWS)))
        hit = torch.nonzero(triangle >= 0)[:, 0]
        corners = self._faces[triangle[hit].long()]
        nearest = corners.gather(1, torch.stack([1 - u[hit] - v[hit], u[hit], v[hit]], 1).argmax(1, keepdim=True))[:, 0]
        behind = (self._normal[nearest] * direction[hit]).sum(1) > 0
        vertex = torch.full_like(row, -1).index_copy(0, hit, torch.where(behind, self.count, nearest)).view(-1, RAYS_PER_VERTEX)
        order = vertex.argsort(dim=1, descending=True, stable=True)
        return (row * 2 * DIRECTION_ROWS + column).view(-1, RAYS_PER_VERTEX).gather(1, order), vertex.gather(1, order)


def _grid(light: PreparedLight) -> torch.Tensor:
    """Return a light, prefiltered and rotated, at the directions of the grid, (2 DIRECTION_ROWS^2, 3) contiguous."""
    sides = (DIRECTION_ROWS, 2 * DIRECTION_ROWS)
    v, u = torch.meshgrid(*((torch.arange(size, device=light.specular.device) + 0.5) / size for size in sides), indexing="ij")
    return lookup_at(light.specular[SPECULAR_LEVEL], light.turned_u(u.flatten()), v.flatten()).contiguous()
