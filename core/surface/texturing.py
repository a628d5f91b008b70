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
from .bake import tangent_space, tangents
from .material_fusion import FusedMaterials, fuse_materials
from .mesh_texels import MeshTexels, mesh_texels
from .meshing import Triangles
from .normal_source import NormalSource
from .repair import facing_normals
from .unwrap import unwrap
from .unwrap_process import UnwrapProcess


def textured_mesh(
    surface: Surface,
    views: Sequence[GBuffer],
    samples: SurfaceSamples,
    settings: SurfaceSettings,
    progress: Progress,
    unwrapping: UnwrapProcess | None = None,
    normal_source: NormalSource | None = None,
) -> Mesh:
    """Unwrap the surface, and give it materials at the vertices and in textures.

    Args:
        surface: extracted from the reconstruction.
        views: G-buffers of the reconstruction at the training cameras.
        samples: its Gaussians, for parts that no view sees.
        settings: texture size and strength of the normal detail.
        progress: receives steps and may cancel.
        unwrapping: unwrapping of this surface that was begun earlier; None to unwrap it now.
        normal_source: source of the normals; None: the surface with detail of the views.

    Raises:
        Cancelled: the user stopped the work.
    """
    normal_source = normal_source or NormalSource(settings.detail)
    progress.phase("unwrap", 1)
    if unwrapping is None:
        source, faces, uvs = unwrap(Triangles(surface.vertices, surface.faces), settings.texels, settings.udim_tiles)
    else:
        source, faces, uvs = unwrapping.result(lambda: progress.cancelled)
    progress.step(1)
    if progress.cancelled:
        raise Cancelled("stopped during UV unwrapping")
    progress.phase("bake", 2 * len(views))
    fused = fuse_materials(surface.vertices, surface.normals, views, samples, surface.voxel, stoppable(progress))
    normals = normal_source.normals(surface.vertices, surface.normals, fused).astype(np.float64)
    normals = facing_normals(Triangles(surface.vertices, surface.faces), normals)
    mesh = _mesh_of(surface.vertices[source], normals[source], uvs, faces, fused.at(source))
    mesh.textures.update(baked_textures(mesh, views, samples, surface.voxel, settings, stoppable(progress, len(views)), normal_source))
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
    normal_source: NormalSource | None = None,
) -> Mesh:
    """Give an existing mesh materials at its vertices and in textures; geometry and UVs do not change.

    Args:
        surface: the mesh, with the resolution of the extracted surface, which sets how far from it the mesh may lie and still be seen.
        uvs: (V, 2) in 0..1.
        views: G-buffers of the reconstruction at the training cameras.
        samples: its Gaussians, for parts that no view sees.
        settings: texture size and strength of the normal detail.
        progress: receives steps and may cancel.
        normal_source: source of the texture's normals; None: the mesh with detail of the views.

    Raises:
        Cancelled: the user stopped the work.
    """
    progress.phase("bake", 2 * len(views))
    fused = fuse_materials(surface.vertices, surface.normals, views, samples, surface.voxel, stoppable(progress))
    mesh = _mesh_of(surface.vertices, surface.normals, uvs, surface.faces.astype(np.int32), fused)
    mesh.textures.update(baked_textures(mesh, views, samples, surface.voxel, settings, stoppable(progress, len(views)), normal_source))
    return mesh


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
    normal_source: NormalSource | None = None,
) -> dict[str, np.ndarray]:
    """Bake albedo, roughness, metallic, normal and confidence textures.

    Args:
        mesh: mesh with UVs and normals.
        views: G-buffers of the reconstruction.
        samples: its Gaussians, for parts that no view sees.
        voxel: resolution of the surface, world units.
        settings: size and bits of the textures, and strength of the normal detail.
        step: called with the number of views done; may raise.
        normal_source: source of the normals; None: the mesh with detail of the views.

    Returns:
        Images by name as in `Mesh.textures`: (S, S, 3) albedo (sRGB) and normal (tangent space), (S, S) roughness and metallic, uint8
        or uint16; (S, S) confidence (see `Mesh`), and where it is known (S, S, 3) material_confidence, uint8.
    """
    texels, bits = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, settings.texels), settings.texture_bits
    normals = texels.interpolated(mesh.normals, mesh.faces)
    for part in texels.chunks():
        normals[part] = meshing.unit(normals[part])
    place = texels.interpolated(mesh.vertices, mesh.faces)
    fused = fuse_materials(place, normals, views, samples, voxel, step)
    detailed = (normal_source or NormalSource(settings.detail)).normals(place, normals, fused)
    images = {
        "albedo": texels.image(srgb_quantised(fused.albedo, bits)),
        "roughness": texels.image(quantised(fused.roughness, bits)),
        "metallic": texels.image(quantised(fused.metallic, bits)),
        "normal": texels.image(_normal_codes(mesh, texels, normals, detailed, bits)),
        "confidence": texels.image(eight_bits(fused.confidence)),
    }
    if fused.material_confidence is not None:
        images["material_confidence"] = texels.image(eight_bits(fused.material_confidence))
    return images


def _normal_codes(mesh: Mesh, texels: MeshTexels, normals: np.ndarray, detailed: np.ndarray, bits: int) -> np.ndarray:
    """Return normals of P texels, `detailed` (P, 3), as codes (P, 3) in the tangent space of the mesh's normals, `normals` (P, 3)."""
    frames = tangents(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces)
    codes = np.empty(normals.shape, np.dtype(f"u{bits // 8}"))
    for part in texels.chunks():
        normal = normals[part].astype(np.float64)
        side = frames[mesh.faces[texels.face[part], 0], 3]
        tangent = texels.interpolate(frames[:, :3], mesh.faces, part)
        tangent = meshing.unit(tangent - (tangent * normal).sum(-1, keepdims=True) * normal)
        codes[part] = quantised(0.5 + 0.5 * tangent_space(detailed[part], normal, tangent, side), bits)
    return codes
