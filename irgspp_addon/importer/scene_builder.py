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
from ...core.io.run_json import udim_tiles
from ...core.scene.camera_files import load_run_cameras
from ...core.scene.mesh import foot
from ...core.scene.udim import FOLDER
from ..world.light_to_world import world_from_map
from .cameras import look_through, place_cameras
from .confidence_view import ATTRIBUTE, add_confidence_nodes
from .displacement import Heights
from .materials import SOURCES, TEXTURES, build_material
from .mesh_origin import mesh_to_run, set_origin
from .ownership import Owner, put
from .placement import Placement
from .run_frame import ALBEDO_SCALE
from .run_mesh import built_mesh, columns, read_mesh
from .run_root import placed_root
from .texture_images import load_texture, texture_files


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
    cameras, elements, tiles = load_run_cameras(run / "cameras.json"), read_mesh(run / "mesh.ply"), udim_tiles(run)
    _check_files(run, source, tiles)
    to_world, centre = _frame(run)
    owner = Owner(run)
    existing = owner.find(bpy.data.objects, "mesh")
    if existing is not None and existing.mode == "EDIT":
        raise InputError(existing.name, "is being edited", "leave Edit Mode and import again")
    scene = scene or bpy.context.scene
    name = owner.folder.name
    collection, root = placed_root(owner, scene, to_world, centre, placement)
    before, origin = mesh_to_run(existing) if existing is not None else Matrix(), foot(columns(elements["vertex"], "x", "y", "z"))
    data = owner.replace(bpy.data.meshes, "mesh data", built_mesh(elements, name, np.array(Matrix.Translation(-origin)), tiles))
    mesh = owner.object("mesh", name, data, root)
    set_origin(mesh, before, origin)
    put(mesh, collection)
    _add_albedo_scale(mesh)
    material = _material(owner, name, run, source, pack, tiles)
    if ATTRIBUTE in mesh.data.attributes:
        add_confidence_nodes(material)
    mesh.data.materials.append(material)
    placed = place_cameras(owner, cameras, root, collection)
    world = _light(owner, run / "environment.exr", f"{name} light", pack, root)
    owner.remove_unused()
    return Imported(collection, root, mesh, placed, world)


def _check_files(run: Path, source: str, tiles: int) -> None:
    """Check the files that are read only after the first datablock has been created."""
    if source not in SOURCES:
        raise InputError(source, "is not a material source", "use textures or attributes")
    textures = [file for name in TEXTURES for file in texture_files(_folder(run, tiles), name, tiles)] if source == "textures" else []
    for needed in [run / "environment.exr", *textures]:
        if not needed.is_file():
            fix = "finish the run" if source == "attributes" else "finish the run, or let the material read attributes"
            raise InputError(needed, "is missing", fix)


def _folder(run: Path, tiles: int) -> Path:
    """Return the folder of the textures that the material reads."""
    return run / "textures" / FOLDER if tiles > 1 else run / "textures"


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


def _material(owner: Owner, name: str, run: Path, source: str, pack: bool, tiles: int) -> bpy.types.Material:
    """Create the material, which can read textures (if there are any) and attributes."""
    images, textures = {}, _folder(run, tiles)
    if all(file.is_file() for texture in TEXTURES for file in texture_files(textures, texture, tiles)):
        for texture in TEXTURES:
            image = load_texture(textures, texture, pack, tiles)
            images[texture] = owner.replace(bpy.data.images, f"{texture} texture", image)
    material = owner.reuse(bpy.data.materials, "material", name)
    build_material(material, images, source, _heights(owner, run, pack, tiles) if images else None)
    return material


def _heights(owner: Owner, run: Path, pack: bool, tiles: int) -> Heights | None:
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
    image = owner.replace(bpy.data.images, "height texture", load_texture(_folder(run, tiles), "height", pack, tiles))
    return Heights(image, scale, midlevel)


def _light(owner: Owner, path: Path, name: str, pack: bool, root: bpy.types.Object) -> bpy.types.World:
    """Create a World of the recovered light with the rotation of the empty, so that the object is lit as in the photographs."""
    new = world_from_map(path, name, pack)
    nodes = {node.bl_idname: node for node in new.node_tree.nodes}
    owner.replace(bpy.data.images, "light", nodes["ShaderNodeTexEnvironment"].image)
    turn_light(new, root)
    world = owner.replace(bpy.data.worlds, "world", new)
    world.use_fake_user = True
    return world


def turn_light(world: bpy.types.World, root: bpy.types.Object) -> None:
    """Turn the World of the recovered light with the empty, so that the object is lit as in the photographs.

    Args:
        world: World of an imported run.
        root: empty above the run's objects.
    """
    mapping = next(node for node in world.node_tree.nodes if node.bl_idname == "ShaderNodeMapping")
    # The Mapping node rotates the lookup direction from Blender's world into the engine's frame.
    mapping.inputs["Rotation"].default_value = root.matrix_world.to_quaternion().inverted().to_euler()


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
