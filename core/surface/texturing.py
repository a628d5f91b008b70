# SPDX-License-Identifier: GPL-3.0-or-later
"""Texturing of the extracted surface: UV unwrapping, material fusion from the views, baking."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..errors import Cancelled
from ..io.quantisation import eight_bits, quantised, srgb_quantised
from ..progress.protocol import Progress
from ..scene.gbuffer import GBuffer, SurfaceSamples
from ..scene.mesh import Mesh
from ..scene.surface import Surface
from ..settings.schema import SurfaceSettings
from . import meshing
from .bake import add_normal_detail, normal_noise, tangent_space, tangents
from .material_fusion import FusedMaterials, fuse_materials
from .mesh_texels import MeshTexels, mesh_texels
from .meshing import Triangles
from .repair import facing_normals
from .unwrap import unwrap
from .unwrap_process import UnwrapProcess

NOISE_POINTS = 20_000  # vertices that the noise of normals is measured at


def textured_mesh(
    surface: Surface,
    views: Sequence[GBuffer],
    samples: SurfaceSamples,
    settings: SurfaceSettings,
    progress: Progress,
    unwrapping: UnwrapProcess | None = None,
    noise: float | None = None,
) -> Mesh:
    """Unwrap the surface, and give it materials at the vertices and in textures.

    Args:
        surface: extracted from the reconstruction.
        views: G-buffers of the reconstruction at the training cameras.
        samples: its Gaussians, for parts that no view sees.
        settings: texture size and strength of the normal detail.
        progress: receives steps and may cancel.
        unwrapping: unwrapping of this surface that was begun earlier; None to unwrap it now.
        noise: largest noise of normals, see `surface_noise`; None for no limit.

    Raises:
        Cancelled: the user stopped the work.
    """
    progress.phase("unwrap", 1)
    if unwrapping is None:
        source, faces, uvs = unwrap(Triangles(surface.vertices, surface.faces), settings.texels)
    else:
        source, faces, uvs = unwrapping.result(lambda: progress.cancelled)
    progress.step(1)
    if progress.cancelled:
        raise Cancelled("stopped during UV unwrapping")
    progress.phase("bake", 2 * len(views))
    fused = fuse_materials(surface.vertices, surface.normals, views, samples, surface.voxel, stoppable(progress))
    own = limited(normal_noise(surface.normals, fused.normal, fused.weight > 0), noise)
    normals = add_normal_detail(surface.normals, fused.normal, own, settings.detail)
    normals = facing_normals(Triangles(surface.vertices, surface.faces), normals)
    mesh = _mesh_of(surface.vertices[source], normals[source], uvs, faces, fused.at(source))
    mesh.textures.update(baked_textures(mesh, views, samples, surface.voxel, settings, stoppable(progress, len(views)), noise))
    return mesh


def stoppable(progress: Progress, before: int = 0) -> Callable[[int], None]:
    """Make a function that reports the number of steps done, and raises Cancelled where the user stopped the work.

    Args:
        progress: receives the steps and may cancel.
        before: steps of the phase that were done before.
    """

    def step(done: int) -> None:
        progress.step(before + done)
        if progress.cancelled:
            raise Cancelled("stopped during texture baking")

    return step


def mesh_with_materials(
    surface: Surface,
    uvs: np.ndarray,
    views: Sequence[GBuffer],
    samples: SurfaceSamples,
    settings: SurfaceSettings,
    progress: Progress,
    noise: float | None = None,
) -> Mesh:
    """Give an existing mesh materials at its vertices and in textures; geometry and UVs do not change.

    Args:
        surface: the mesh, with the resolution of the extracted surface, which sets how far from it the mesh may lie and still be seen.
        uvs: (V, 2) in 0..1.
        views: G-buffers of the reconstruction at the training cameras.
        samples: its Gaussians, for parts that no view sees.
        settings: texture size and strength of the normal detail.
        progress: receives steps and may cancel.
        noise: largest noise of normals, see `surface_noise`; None for no limit.

    Raises:
        Cancelled: the user stopped the work.
    """
    progress.phase("bake", 2 * len(views))
    fused = fuse_materials(surface.vertices, surface.normals, views, samples, surface.voxel, stoppable(progress))
    mesh = _mesh_of(surface.vertices, surface.normals, uvs, surface.faces.astype(np.int32), fused)
    mesh.textures.update(baked_textures(mesh, views, samples, surface.voxel, settings, stoppable(progress, len(views)), noise))
    return mesh


def surface_noise(fine: Surface, views: Sequence[GBuffer], samples: SurfaceSamples) -> float:
    """Return the noise of normals on the surface before its triangles are reduced, see `normal_noise`.

    On a reduced mesh, the difference of its normals from the views' is shape that its faces have lost, which must not count as noise.

    Args:
        fine: surface as it is fused.
        views: G-buffers of the reconstruction at the training cameras.
        samples: its Gaussians, for parts that no view sees.
    """
    pick = np.random.default_rng(0).choice(len(fine.vertices), min(NOISE_POINTS, len(fine.vertices)), replace=False)
    fused = fuse_materials(fine.vertices[pick], fine.normals[pick], views, samples, fine.voxel, lambda done: None)
    return normal_noise(fine.normals[pick], fused.normal, fused.weight > 0)


def limited(noise: float, limit: float | None) -> float:
    """Return the noise of a mesh's normals, at most a limit where there is one."""
    return noise if limit is None else min(noise, limit)


def _mesh_of(vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray, faces: np.ndarray, materials: FusedMaterials) -> Mesh:
    """Return a mesh with materials at its V vertices, without textures."""
    return Mesh(
        vertices=vertices.astype(np.float32),
        normals=normals.astype(np.float32),
        uvs=uvs,
        faces=faces,
        albedo=materials.albedo,
        roughness=materials.roughness,
        metallic=materials.metallic,
        confidence=materials.confidence,
        material_confidence=materials.material_confidence,
    )


def baked_textures(
    mesh: Mesh,
    views: Sequence[GBuffer],
    samples: SurfaceSamples,
    voxel: float,
    settings: SurfaceSettings,
    step: Callable[[int], None] = lambda done: None,
    noise: float | None = None,
) -> dict[str, np.ndarray]:
    """Bake albedo, roughness, metallic, normal and confidence textures.

    Args:
        mesh: mesh with UVs and normals.
        views: G-buffers of the reconstruction.
        samples: its Gaussians, for parts that no view sees.
        voxel: resolution of the surface, world units.
        settings: size and bits of the textures, and strength of the normal detail.
        step: called with the number of views done; may raise.
        noise: largest noise of normals, see `surface_noise`; None for no limit.

    Returns:
        Images by name as in `Mesh.textures`: (S, S, 3) albedo (sRGB) and normal (tangent space), (S, S) roughness and metallic, uint8
        or uint16; (S, S) confidence (see `Mesh`), and where it is known (S, S, 3) material_confidence, uint8.
    """
    texels, bits = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, settings.texels), settings.texture_bits
    normals = texels.interpolated(mesh.normals, mesh.faces)
    for part in texels.chunks():
        normals[part] = meshing.unit(normals[part])
    fused = fuse_materials(texels.interpolated(mesh.vertices, mesh.faces), normals, views, samples, voxel, step)
    images = {
        "albedo": texels.image(srgb_quantised(fused.albedo, bits)),
        "roughness": texels.image(quantised(fused.roughness, bits)),
        "metallic": texels.image(quantised(fused.metallic, bits)),
        "normal": texels.image(_normal_codes(mesh, texels, normals, fused, settings, noise)),
        "confidence": texels.image(eight_bits(fused.confidence)),
    }
    if fused.material_confidence is not None:
        images["material_confidence"] = texels.image(eight_bits(fused.material_confidence))
    return images


def _normal_codes(
    mesh: Mesh, texels: MeshTexels, normals: np.ndarray, fused: FusedMaterials, settings: SurfaceSettings, limit: float | None
) -> np.ndarray:
    """Return the normals of P texels with detail as codes (P, 3) uint8 or uint16 in tangent space; `normals` (P, 3) are the mesh's."""
    frames = tangents(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces)
    seen, codes = fused.weight > 0, np.empty(normals.shape, np.dtype(f"u{settings.texture_bits // 8}"))
    noise = limited(normal_noise(normals, fused.normal, seen), limit)
    for part in texels.chunks():
        normal = normals[part].astype(np.float64)
        detailed = np.where(seen[part, None], add_normal_detail(normal, fused.normal[part], noise, settings.detail), normal)
        side = frames[mesh.faces[texels.face[part], 0], 3]
        tangent = texels.interpolate(frames[:, :3], mesh.faces, part)
        tangent = meshing.unit(tangent - (tangent * normal).sum(-1, keepdims=True) * normal)
        codes[part] = quantised(0.5 + 0.5 * tangent_space(detailed, normal, tangent, side), settings.texture_bits)
    return codes
