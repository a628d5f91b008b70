# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of a run folder as Blender datablocks: mesh, material, light and cameras, in one collection under one empty."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...core.errors import InputError
from ...core.scene.camera_files import load_run_cameras
from ...core.scene.gbuffer import CONFIDENCE
from ..world.light_to_world import load_image, world_from_map
from .cameras import look_through, place_cameras
from .confidence_view import ATTRIBUTE, add_confidence_nodes
from .displacement import Heights
from .materials import SOURCES, TEXTURES, build_material
from .ownership import Owner, put
from .placement import Placement
from .ply import read_ply
from .run_frame import ALBEDO_SCALE
from .run_root import placed_root

COLUMNS = ("x", "y", "z", "nx", "ny", "nz", "s", "t", "albedo_r", "albedo_g", "albedo_b", "roughness", "metallic", "vertex_indices")
QUAD = "quad"  # property of faces: this triangle and the next one make up a quad
COVERAGE = "confidence"  # column that runs of version 0.1 lack


@dataclass(frozen=True)
class Imported:
    """Result of `import_run`: all objects are children of the empty `root`, in the engine's frame.

    Attributes:
        collection: collection of all objects.
        root: empty above them.
        mesh: mesh object.
        cameras: camera objects.
        world: World with the recovered light.
    """

    collection: bpy.types.Collection
    root: bpy.types.Object
    mesh: bpy.types.Object
    cameras: list[bpy.types.Object]
    world: bpy.types.World


def import_run(
    run: Path,
    source: str = "textures",
    pack: bool = True,
    placement: Placement | None = None,
    scene: bpy.types.Scene | None = None,
) -> Imported:
    """Build the datablocks of a finished run in a scene, in place of those of an earlier import; the scene's settings and World stay.

    Args:
        run: run folder.
        source: source of the material's values, "textures" or "attributes".
        pack: True to pack textures and light into the .blend.
        placement: placement in Blender's world; None places the run over its imported dataset, or else in the engine's upright frame.
        scene: scene to build in; None for the current one.

    Raises:
        InputError: if the folder is not a finished run, or the imported mesh is in Edit Mode; then no datablock has been created.
    """
    cameras, elements = load_run_cameras(run / "cameras.json"), _read_mesh(run / "mesh.ply")
    _check_files(run, source)
    to_world, centre = _frame(run)
    owner = Owner(run)
    existing = owner.find(bpy.data.objects, "mesh")
    if existing is not None and existing.mode == "EDIT":
        raise InputError(existing.name, "is being edited", "leave Edit Mode and import again")
    scene = scene or bpy.context.scene
    name = owner.folder.name
    collection, root = placed_root(owner, scene, to_world, centre, placement)
    mesh = owner.object("mesh", name, owner.replace(bpy.data.meshes, "mesh data", _mesh(elements, name)), root)
    put(mesh, collection)
    _add_albedo_scale(mesh)
    material = _material(owner, name, run, source, pack)
    if ATTRIBUTE in mesh.data.attributes:
        add_confidence_nodes(material)
    mesh.data.materials.append(material)
    placed = place_cameras(owner, cameras, root, collection)
    world = _light(owner, run / "environment.exr", f"{name} light", pack, root)
    owner.remove_unused()
    return Imported(collection, root, mesh, placed, world)


def _check_files(run: Path, source: str) -> None:
    """Check the files that are read only after the first datablock has been created."""
    if source not in SOURCES:
        raise InputError(source, "is not a material source", "use textures or attributes")
    for needed in ["environment.exr", *(f"textures/{name}.png" for name in TEXTURES if source == "textures")]:
        if not (run / needed).is_file():
            fix = "finish the run" if source == "attributes" else "finish the run, or let the material read attributes"
            raise InputError(run / needed, "is missing", fix)


def _add_albedo_scale(mesh: bpy.types.Object) -> None:
    """Add the custom property for the albedo factor of relighting, initially 1."""
    if ALBEDO_SCALE not in mesh:
        mesh[ALBEDO_SCALE] = 1.0
        description = "Factor for the albedo when IRGS++ relights. Light and albedo are recovered only up to a common factor"
        mesh.id_properties_ui(ALBEDO_SCALE).update(min=0.0, soft_max=4.0, description=description)


def show_as_photographed(scene: bpy.types.Scene, imported: Imported) -> None:
    """Light a scene by the recovered light and look through the first camera, without a tone curve.

    Args:
        scene: scene to change.
        imported: imported run.
    """
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
        raise InputError(path, f"lacks {', '.join(missing)}", "choose the folder of a finished run")
    return elements


def textured_mesh(path: Path, name: str, offset: np.ndarray) -> bpy.types.Mesh:
    """Build the mesh of a run with its UVs and normals, without the materials at its vertices.

    Args:
        path: mesh.ply of the run.
        name: of the mesh.
        offset: (3,) added to the vertices.

    Raises:
        InputError: if the file is missing or no mesh of a run.
    """
    mesh = _mesh(_read_mesh(path), name)
    for name in ("albedo", "roughness", "metallic", COVERAGE, ATTRIBUTE):
        if name in mesh.attributes:
            mesh.attributes.remove(mesh.attributes[name])
    mesh.transform(Matrix.Translation(offset.tolist()))
    return mesh


def _mesh(elements: dict[str, np.ndarray], name: str) -> bpy.types.Mesh:
    """Build the mesh with welded UV seams, a connected surface for sculpting and smoothing: Blender stores UVs per corner."""
    vertex, face = elements["vertex"], elements["face"]
    corners, sizes = _polygons(face)
    positions, first, welded = np.unique(_columns(vertex, "x", "y", "z"), axis=0, return_index=True, return_inverse=True)
    mesh = bpy.data.meshes.new(name)
    set_polygons(mesh, positions, welded.reshape(-1)[corners], sizes)
    uv = mesh.uv_layers.new(name="UVMap")
    uv.data.foreach_set("uv", _columns(vertex, "s", "t")[corners].reshape(-1))
    _set_attributes(mesh, vertex[first])
    mesh.shade_smooth()
    mesh.update()
    mesh.normals_split_custom_set_from_vertices(_columns(vertex[first], "nx", "ny", "nz").tolist())
    return mesh


def _polygons(face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners (L,) of the polygons one after another, and their numbers: 4 where two triangles are marked as a quad."""
    triangles = face["vertex_indices"].astype(np.int64)
    quads = face[QUAD].astype(bool) if QUAD in face.dtype.names else np.zeros(len(face), bool)
    quads[-1:] = False  # there is no next one
    rows = np.concatenate([triangles, np.roll(triangles, -1, axis=0)[:, 2:]], -1)
    begins = ~np.append([False], quads[:-1])
    sizes = np.where(quads, 4, 3)[begins]
    return rows[begins][np.arange(4) < sizes[:, None]], sizes


def set_polygons(mesh: bpy.types.Mesh, positions: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> None:
    """Set vertices and polygons as `from_pydata` does, without a Python object for each number.

    Args:
        mesh: empty mesh.
        positions: (V, 3).
        corners: (L,) indices of vertices, all valid, polygon after polygon.
        sizes: (P,) number of corners of each polygon.
    """
    mesh.vertices.add(len(positions))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(positions, np.float32).reshape(-1))
    mesh.loops.add(len(corners))
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(corners, np.int32))
    mesh.polygons.add(len(sizes))
    mesh.polygons.foreach_set("loop_start", (np.cumsum(sizes) - sizes).astype(np.int32))
    mesh.update(calc_edges=True)


def _set_attributes(mesh: bpy.types.Mesh, vertex: np.ndarray) -> None:
    if set(CONFIDENCE) <= set(vertex.dtype.names):
        _set_colour(mesh, ATTRIBUTE, _columns(vertex, *CONFIDENCE))
    _set_colour(mesh, "albedo", _columns(vertex, "albedo_r", "albedo_g", "albedo_b"))
    mesh.color_attributes.active_color = mesh.color_attributes["albedo"]
    for name in ("roughness", "metallic", *({COVERAGE} & set(vertex.dtype.names))):
        mesh.attributes.new(name, "FLOAT", "POINT").data.foreach_set("value", _columns(vertex, name)[:, 0])


def _set_colour(mesh: bpy.types.Mesh, name: str, rgb: np.ndarray) -> None:
    """Add a colour attribute with the values (N, 3)."""
    attribute = mesh.color_attributes.new(name, "FLOAT_COLOR", "POINT")
    attribute.data.foreach_set("color", np.c_[rgb, np.ones(len(rgb), np.float32)].reshape(-1))


def _columns(vertex: np.ndarray, *names: str) -> np.ndarray:
    """Return columns of a PLY element as (N, len(names)) float32."""
    return np.stack([vertex[name] for name in names], -1).astype(np.float32)


def _material(owner: Owner, name: str, run: Path, source: str, pack: bool) -> bpy.types.Material:
    """Create the material, which can read textures (if there are any) and attributes."""
    images, textures = {}, run / "textures"
    if all((textures / f"{texture}.png").is_file() for texture in TEXTURES):
        for texture in TEXTURES:
            image = load_image(textures / f"{texture}.png", "sRGB" if texture == "albedo" else "Non-Color", pack)
            images[texture] = owner.replace(bpy.data.images, f"{texture} texture", image)
    material = owner.reuse(bpy.data.materials, "material", name)
    build_material(material, images, source, _heights(owner, run, pack) if images else None)
    return material


def _heights(owner: Owner, run: Path, pack: bool) -> Heights | None:
    """Load the height texture with its scale in run.json; None where the run has none."""
    path = run / "textures" / "height.png"
    if not path.is_file():
        return None
    state = run / "run.json"
    try:
        values = json.loads(state.read_text(encoding="utf-8"))["height"]
        scale, midlevel = float(values["scale"]), float(values["midlevel"])
    except OSError as error:
        raise InputError(state, f"can't be read ({error.strerror})", "restore it, or remove textures/height.png") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(state, f"lacks the scale of textures/height.png ({error!r})", "bake the run again") from error
    image = owner.replace(bpy.data.images, "height texture", load_image(path, "Non-Color", pack))
    return Heights(image, scale, midlevel)


def _light(owner: Owner, path: Path, name: str, pack: bool, root: bpy.types.Object) -> bpy.types.World:
    """Create a World of the recovered light with the rotation of the empty, so that the object is lit as in the photographs."""
    new = world_from_map(path, name, pack)
    nodes = {node.bl_idname: node for node in new.node_tree.nodes}
    owner.replace(bpy.data.images, "light", nodes["ShaderNodeTexEnvironment"].image)
    # The Mapping node rotates the lookup direction from Blender's world into the engine's frame.
    rotation = root.matrix_world.to_quaternion().inverted()
    nodes["ShaderNodeMapping"].inputs["Rotation"].default_value = rotation.to_euler()
    world = owner.replace(bpy.data.worlds, "world", new)
    world.use_fake_user = True
    return world


def _frame(run: Path) -> tuple[np.ndarray, tuple[float, float, float]]:
    """Return the matrix (4, 4) from the dataset's own frame to the run's, and the object's centre (3,) in the run's frame."""
    path = run / "reconstruction.json"
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        x, y, z = map(float, values["bound"]["centre"])
        return np.array(values["to_world"], float).reshape(4, 4), (x, y, z)
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})", "finish the run") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(path, f"does not describe the run's frame ({error!r})", "run the reconstruction again") from error
