# SPDX-License-Identifier: GPL-3.0-or-later
"""A run folder as Blender datablocks: mesh, material, light and cameras, in one collection under one empty."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import InputError
from ...core.scene.camera_files import load_run_cameras
from ..world.light_to_world import load_image, world_from_map
from .cameras import look_through, place_cameras
from .materials import SOURCES, TEXTURES, build_material
from .ownership import Owner, folder_of, link, put
from .placement import Placement, place, place_beside
from .ply import read_ply
from .run_frame import ALBEDO_SCALE

COLUMNS = ("x", "y", "z", "nx", "ny", "nz", "s", "t", "albedo_r", "albedo_g", "albedo_b", "roughness", "metallic", "vertex_indices")
RUN, DATASET = "irgspp_run", "irgspp_dataset"  # custom properties of the empty: the folders it shows


@dataclass(frozen=True)
class Imported:
    """What `import_run` made: everything but the World lies below the empty `root`, in the frame that the engine works in."""

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
    """Build everything of a finished run in a scene (default: the current), in place of what an earlier import of the folder made.

    The scene's render settings and World stay as they are. `source` says what the material reads, "textures" or "attributes"; `pack`
    puts textures and light into the .blend; without `placement` the run lies over its imported dataset, or as the engine found it.
    Raises InputError where the folder is not a finished run, before anything is made.
    """
    cameras, elements = load_run_cameras(run / "cameras.json"), _read_mesh(run / "mesh.ply")
    _check_files(run, source)
    to_world, centre = _frame(run)
    owner = Owner(run)
    edited = owner.find(bpy.data.objects, "mesh")
    if edited is not None and edited.mode == "EDIT":
        raise InputError(edited.name, "is being edited", "leave Edit Mode and import again")
    name = owner.folder.name
    collection = owner.kept(bpy.data.collections, "collection", name)
    scene = scene or bpy.context.scene
    link_to_scene(collection, scene)
    root = new_root(owner, f"{collection.name} frame", collection)
    root[RUN] = str(owner.folder)
    dataset = _dataset_root(run, scene)
    if placement is None and dataset is not None:
        place_beside(root, dataset, to_world)
    else:
        place(root, placement or Placement(), to_world, centre)
    mesh = owner.object("mesh", name, owner.exchanged(bpy.data.meshes, "mesh data", _mesh(elements, name)), root)
    put(mesh, collection)
    _offer_albedo_scale(mesh)
    mesh.data.materials.append(_material(owner, name, run / "textures", source, pack))
    placed = place_cameras(owner, cameras, root, collection)
    world = _light(owner, run / "environment.exr", f"{name} light", pack, root)
    owner.drop_rest()
    return Imported(collection, root, mesh, placed, world)


def _check_files(run: Path, source: str) -> None:
    """What is read only after the first datablock was made."""
    if source not in SOURCES:
        raise InputError(source, "is not a material source", "use textures or attributes")
    for needed in ["environment.exr", *(f"textures/{name}.png" for name in TEXTURES if source == "textures")]:
        if not (run / needed).is_file():
            raise InputError(run / needed, "is missing", "the run is not finished" if source == "attributes" else "or use the attributes")


def _offer_albedo_scale(mesh: bpy.types.Object) -> None:
    """The factor of relighting as a custom property, with 1 to begin with."""
    if ALBEDO_SCALE not in mesh:
        mesh[ALBEDO_SCALE] = 1.0
        about = "Factor of the object's albedo where IRGS++ relights: as the light was unknown, so is the brightness of all albedo"
        mesh.id_properties_ui(ALBEDO_SCALE).update(min=0.0, soft_max=4.0, description=about)


def link_to_scene(collection: bpy.types.Collection, scene: bpy.types.Scene) -> None:
    """Show the collection in the scene, unless a person has put it somewhere in it already."""
    if collection not in scene.collection.children_recursive:
        link(collection, scene.collection)


def new_root(owner: Owner, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """The empty above everything."""
    root = owner.object("root", name, None, None)
    put(root, collection)
    return root


def find_roots(scene: bpy.types.Scene, folder_property: str) -> list[bpy.types.Object]:
    """The empties of all imported runs (RUN) or datasets (DATASET) of a scene."""
    return [thing for thing in scene.objects if folder_property in thing and thing.type == "EMPTY"]


def run_of(thing: bpy.types.Object | None) -> Path | None:
    """The run folder that an object was imported from."""
    folder, above = folder_of(thing), thing
    while above is not None and RUN not in above:
        above = above.parent
    return folder if folder == folder_of(above) else None


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
    _set_triangles(mesh, positions, welded.reshape(-1)[corners])
    uv = mesh.uv_layers.new(name="UVMap")
    uv.data.foreach_set("uv", _columns(vertex, "s", "t")[corners.reshape(-1)].reshape(-1))
    _set_attributes(mesh, vertex[first])
    mesh.shade_smooth()
    mesh.update()
    mesh.normals_split_custom_set_from_vertices(_columns(vertex[first], "nx", "ny", "nz").tolist())
    return mesh


def _set_triangles(mesh: bpy.types.Mesh, positions: np.ndarray, faces: np.ndarray) -> None:
    """As `from_pydata`, without a Python object for each number."""
    mesh.vertices.add(len(positions))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(positions, np.float32).reshape(-1))
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, np.int32).reshape(-1))
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)


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


def _material(owner: Owner, name: str, textures: Path, source: str, pack: bool) -> bpy.types.Material:
    """One material that can read either source, where there are textures at all."""
    images = {}
    if all((textures / f"{texture}.png").is_file() for texture in TEXTURES):
        for texture in TEXTURES:
            image = load_image(textures / f"{texture}.png", "sRGB" if texture == "albedo" else "Non-Color", pack)
            images[texture] = owner.exchanged(bpy.data.images, f"{texture} texture", image)
    material = owner.kept(bpy.data.materials, "material", name)
    build_material(material, images, source)
    return material


def _light(owner: Owner, path: Path, name: str, pack: bool, root: bpy.types.Object) -> bpy.types.World:
    """The recovered light as a World, turned like the empty: the object is lit as it was photographed, however it was placed."""
    fresh = world_from_map(path, name, pack)
    nodes = {node.bl_idname: node for node in fresh.node_tree.nodes}
    owner.exchanged(bpy.data.images, "light", nodes["ShaderNodeTexEnvironment"].image)
    # The Mapping node turns the direction that is looked up: from Blender's world into the engine's frame.
    turned = root.matrix_world.to_quaternion().inverted()
    nodes["ShaderNodeMapping"].inputs["Rotation"].default_value = turned.to_euler()
    world = owner.exchanged(bpy.data.worlds, "world", fresh)
    world.use_fake_user = True
    return world


def _frame(run: Path) -> tuple[np.ndarray, tuple[float, float, float]]:
    """(4, 4) from the dataset's own frame to the run's, and the object's middle in it."""
    path = run / "reconstruction.json"
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        x, y, z = map(float, about["bound"]["centre"])
        return np.array(about["to_world"], float).reshape(4, 4), (x, y, z)
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})", "the run is not finished") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(path, f"does not tell the run's frame ({error!r})") from error


def _dataset_root(run: Path, scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The empty of the dataset that the run was made from, where that has been imported too."""
    try:
        dataset = json.loads((run / "run.json").read_text(encoding="utf-8"))["dataset"]
    except (OSError, ValueError, KeyError, TypeError):
        return None  # the run may have been given on without its notes
    roots = find_roots(scene, DATASET)
    return next((root for root in roots if Path(root[DATASET]) == Path(dataset).resolve()), None)
