# SPDX-License-Identifier: GPL-3.0-or-later
"""A run folder as Blender datablocks: mesh, materials, light and cameras, in one collection."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..core.errors import InputError
from ..core.scene.cameras import PlacedCamera, load_cameras
from .cameras import look_through, new_camera, set_background
from .materials import TEXTURES, attribute_material, textured_material
from .ply import read_ply
from .world import world_from_map

SOURCES = ("textures", "attributes")
COLUMNS = ("x", "y", "z", "nx", "ny", "nz", "s", "t", "albedo_r", "albedo_g", "albedo_b", "roughness", "metallic", "vertex_indices")


@dataclass(frozen=True)
class Imported:
    """What `import_run` made."""

    collection: bpy.types.Collection
    mesh: bpy.types.Object
    cameras: list[bpy.types.Object]
    world: bpy.types.World


def import_run(run: Path, source: str = "textures", pack: bool = True) -> Imported:
    """Build everything of a finished run and link it to the current scene; its render settings and World stay as they are.

    `source` says what the material reads, "textures" or "attributes"; `pack` puts textures and light into the .blend.
    Raises InputError where the folder is not a finished run.
    """
    if source not in SOURCES:
        raise InputError(source, "is not a material source", "use textures or attributes")
    cameras, elements = load_cameras(run / "cameras.json"), _read_mesh(run / "mesh.ply")
    for needed in ["environment.exr", *(f"textures/{name}.png" for name in TEXTURES if source == "textures")]:
        if not (run / needed).is_file():  # all is looked at before anything is made
            raise InputError(run / needed, "is missing", "the run is not finished" if source == "attributes" else "or use the attributes")
    collection = bpy.data.collections.new(run.resolve().name)
    bpy.context.scene.collection.children.link(collection)
    mesh = bpy.data.objects.new(collection.name, _mesh(elements, collection.name))
    collection.objects.link(mesh)
    _give_materials(mesh, run / "textures", source, pack)
    world = world_from_map(run / "environment.exr", f"{collection.name} light", pack)
    world.use_fake_user = True
    return Imported(collection, mesh, _place_cameras(cameras, collection), world)


def show_as_photographed(scene: bpy.types.Scene, imported: Imported) -> None:
    """Light the scene by the recovered light and look through the first camera, without Blender's tone curve."""
    scene.world = imported.world
    scene.render.engine = "CYCLES"
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    scene.view_settings.exposure, scene.view_settings.gamma = 0.0, 1.0
    if imported.cameras:
        look_through(scene, imported.cameras[0])


def _read_mesh(path: Path) -> dict[str, np.ndarray]:
    elements = read_ply(path)
    found = [name for element in ("vertex", "face") if element in elements for name in elements[element].dtype.names or ()]
    missing = [name for name in COLUMNS if name not in found]
    if missing:
        raise InputError(path, f"lacks {', '.join(missing)}", "give the folder of a run")
    return elements


def _mesh(elements: dict[str, np.ndarray], name: str) -> bpy.types.Mesh:
    """The mesh with its seams welded: Blender keeps UVs per corner, so that the surface stays one piece for sculpting and smoothing."""
    vertex, face = elements["vertex"], elements["face"]
    corners = face["vertex_indices"].astype(np.int64)
    positions, first, welded = np.unique(_columns(vertex, "x", "y", "z"), axis=0, return_index=True, return_inverse=True)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(positions.tolist(), [], welded.reshape(-1)[corners].tolist())
    uv = mesh.uv_layers.new(name="UVMap")
    uv.data.foreach_set("uv", _columns(vertex, "s", "t")[corners.reshape(-1)].reshape(-1))
    _set_attributes(mesh, vertex[first])
    mesh.shade_smooth()
    mesh.update()
    mesh.normals_split_custom_set_from_vertices(_columns(vertex[first], "nx", "ny", "nz").tolist())
    return mesh


def _set_attributes(mesh: bpy.types.Mesh, vertex: np.ndarray) -> None:
    albedo = mesh.color_attributes.new("albedo", "FLOAT_COLOR", "POINT")
    rgb = _columns(vertex, "albedo_r", "albedo_g", "albedo_b")
    albedo.data.foreach_set("color", np.c_[rgb, np.ones(len(rgb), np.float32)].reshape(-1))
    mesh.color_attributes.active_color = albedo
    for name in ("roughness", "metallic"):
        mesh.attributes.new(name, "FLOAT", "POINT").data.foreach_set("value", _columns(vertex, name)[:, 0])


def _columns(vertex: np.ndarray, *names: str) -> np.ndarray:
    """(N, len(names)) float32 of a PLY element."""
    return np.stack([vertex[name] for name in names], -1).astype(np.float32)


def _give_materials(mesh: bpy.types.Object, textures: Path, source: str, pack: bool) -> None:
    """Both materials are made where both can be, so that a person may swap them; the chosen one is in the slot."""
    name = mesh.name
    materials = {"attributes": attribute_material(f"{name} attributes")}
    if all((textures / f"{texture}.png").is_file() for texture in TEXTURES):
        materials["textures"] = textured_material(textures, f"{name} textures", pack)
    for material in materials.values():
        material.use_fake_user = True
    mesh.data.materials.append(materials[source])


def _place_cameras(cameras: list[PlacedCamera], parent: bpy.types.Collection) -> list[bpy.types.Object]:
    folder = bpy.data.collections.new(f"{parent.name} cameras")
    parent.children.link(folder)
    placed = []
    for record in cameras:
        camera = new_camera(f"{record.split} {record.name}", record.camera)
        camera.data.display_size = 0.1
        if record.picture.is_file():  # photographs may have moved since
            set_background(camera.data, record.picture)
        folder.objects.link(camera)
        placed.append(camera)
    return placed
