# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh as a binary glTF file: +Y up, PBR material, occlusion, roughness and metallic packed into one texture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from trimesh.exchange.gltf import export_glb
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from ..io.atomic import write_atomic
from ..io.quantisation import eight_bits, in_eight_bits
from .mesh import Mesh
from .textures import occlusion_roughness_metallic


def save_glb(mesh: Mesh, path: Path, tangents: np.ndarray | None = None, name: str = "object") -> None:
    """Write the mesh atomically, with its textures if it has any, else with the albedo of its vertices.

    `_CONFIDENCE` has a column for the confidence of the surface, of albedo, of roughness and of metallic, those that are known.

    Args:
        mesh: the mesh.
        path: the .glb to write.
        tangents: (V, 4) that the normal texture refers to, as `surface.bake.tangents` returns them; viewers compute them where None.
        name: of the object and its material.
    """
    body = trimesh.Trimesh(_y_up(mesh.vertices), mesh.faces, vertex_normals=_y_up(mesh.normals), process=False, validate=False)
    if mesh.textures:
        body.visual = TextureVisuals(uv=mesh.uvs.astype(np.float64), material=_textured(mesh.textures, name))
    else:
        _colour_vertices(body, mesh, name)
    # A single attribute: Blender's importers before March 2026 mix up several and then fail at random (glTF-Blender-IO issue 2658).
    known = [values for values in (mesh.confidence, mesh.material_confidence) if values is not None]
    if known:  # glTF's own attributes have no underscore
        body.vertex_attributes["_CONFIDENCE"] = np.column_stack(known).astype(np.float32)
    if tangents is not None:
        body.vertex_attributes["_TANGENT"] = np.concatenate([_y_up(tangents), tangents[:, 3:]], -1).astype(np.float32)
    scene = trimesh.Scene()
    scene.add_geometry(body, node_name=name, geom_name=name)

    def postprocessor(tree: dict) -> None:
        _own_tangents(tree)
        if "occlusion" in mesh.textures:
            _own_occlusion(tree)

    write_atomic(path, export_glb(scene, include_normals=True, tree_postprocessor=postprocessor))


def _own_tangents(tree: dict) -> None:
    """Rename the attribute _TANGENT: trimesh writes none of glTF's own but positions, normals, colours and UVs."""
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            if "_TANGENT" in primitive["attributes"]:
                primitive["attributes"]["TANGENT"] = primitive["attributes"].pop("_TANGENT")


def _own_occlusion(tree: dict) -> None:
    """Let the materials read occlusion from the red channel of the texture of roughness and metallic."""
    for material in tree["materials"]:
        material["occlusionTexture"] = {"index": material["pbrMetallicRoughness"]["metallicRoughnessTexture"]["index"]}


def _y_up(vectors: np.ndarray) -> np.ndarray:
    """Convert world vectors (V, 3) to glTF's axes: x, z, -y."""
    return np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], -1)


def _textured(textures: dict[str, np.ndarray], name: str) -> PBRMaterial:
    textures = {kind: in_eight_bits(texture) for kind, texture in textures.items()}  # which all viewers of glTF read
    packed = Image.fromarray(occlusion_roughness_metallic(textures))
    return PBRMaterial(
        name=name,
        baseColorTexture=Image.fromarray(textures["albedo"]),
        metallicRoughnessTexture=packed,
        normalTexture=Image.fromarray(textures["normal"]),
        metallicFactor=1.0,
        roughnessFactor=1.0,
    )


def _colour_vertices(body: trimesh.Trimesh, mesh: Mesh, name: str) -> None:
    """Set the vertex colours, linear in glTF; roughness and metallic can only be one value each, their mean."""
    body.visual = TextureVisuals(
        uv=mesh.uvs.astype(np.float64),
        material=PBRMaterial(name=name, metallicFactor=float(mesh.metallic.mean()), roughnessFactor=float(mesh.roughness.mean())),
    )
    rgba = np.concatenate([mesh.albedo, np.ones((len(mesh.albedo), 1), np.float32)], -1)
    body.visual.vertex_attributes["color"] = eight_bits(rgba)
