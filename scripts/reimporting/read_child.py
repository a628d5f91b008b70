# SPDX-License-Identifier: GPL-3.0-or-later
"""Read an exported file in a fresh Blender, and write what came back: `read_child.py JOB.json`, in any Python with `bpy`.

JOB.json holds "file", "light" (environment.exr of the run), "views" (cameras, relative to the object's foot), "samples" per pixel, and
"out" (folder). Results there: mesh.npz, textures.npz, material.json, view0.exr and so on, and single0.exr and so on, the same by single
scattering, where the material has another distribution. Only a .blend brings its own light. Of splats (.ply), which no material shows,
their values alone are written, as splats.npz; "file" and "out" are enough.
"""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
if "irgspp" not in sys.modules:  # Blender's Python does not know the package
    runpy.run_path(str(ROOT / "irgspp_addon" / "launch.py"))["mount"](ROOT)
from irgspp.core.errors import InputError  # noqa: E402
from irgspp.core.scene.camera import Camera  # noqa: E402
from irgspp.irgspp_addon.exit_status import exit_status  # noqa: E402
from irgspp.irgspp_addon.importer.cameras import look_through, set_camera  # noqa: E402
from irgspp.irgspp_addon.importer.materials import principled_of  # noqa: E402
from irgspp.irgspp_addon.world.light_to_world import world_from_map  # noqa: E402

READERS = {
    ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
    ".fbx": lambda path: bpy.ops.import_scene.fbx(filepath=path),
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".usdc": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usdz": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".ply": lambda path: bpy.ops.wm.ply_import(filepath=path),
}
INPUTS = ("Base Color", "Roughness", "Metallic", "Normal")
SINGLE = "GGX"  # the .blend's microfacet distribution
PATTERN = "TABULATED_SOBOL"  # of samples: Blender 5.0 gives files of older versions another one, and noise would count as a difference


def read_back(job: dict[str, Any]) -> None:
    """Read the file of a job, and write its mesh, material and images.

    Args:
        job: content of JOB.json.

    Raises:
        InputError: if the file holds more or less than one mesh, faces that are no triangles, or no Principled BSDF.
    """
    file, out = Path(job["file"]), Path(job["out"])
    thing = opened(file)
    if file.suffix == ".ply":
        np.savez(out / "splats.npz", **splats(thing.data))  # pyright: ignore[reportArgumentType]
        return
    scene, foot = bpy.context.scene, np.zeros(3)
    mesh = geometry(thing)
    if file.suffix == ".blend":  # it keeps its place; the other formats stand on the origin
        low, high = mesh["vertices"].min(0), mesh["vertices"].max(0)
        foot = np.array([*(low + high)[:2] / 2, low[2]])
    else:
        scene.world = world_from_map(Path(job["light"]))
    np.savez(out / "mesh.npz", **{**mesh, "vertices": mesh["vertices"] - foot})  # pyright: ignore[reportArgumentType]
    principled = principled_of(thing.active_material) if thing.active_material else None
    if principled is None:
        raise InputError(file, "its material has no Principled BSDF", "mend the exporter")
    textures, record = material(principled, file.suffix == ".obj")
    np.savez(out / "textures.npz", **textures)  # pyright: ignore[reportArgumentType]
    (out / "material.json").write_text(json.dumps({**record, "blender": bpy.app.version_string}), "utf-8")
    render(scene, job, foot, "view")
    if principled.distribution != SINGLE:
        principled.distribution = SINGLE
        render(scene, job, foot, "single")


def opened(file: Path) -> bpy.types.Object:
    """Open or import a file in an empty Blender, and return its one visible mesh."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    if file.suffix == ".blend":
        bpy.ops.wm.open_mainfile(filepath=str(file))
    else:
        READERS[file.suffix](str(file))
    bpy.context.view_layer.update()
    things = [thing for thing in bpy.context.scene.objects if thing.type == "MESH" and not thing.hide_render]
    if len(things) != 1:
        raise InputError(file, f"holds {len(things)} visible meshes instead of one", "mend the exporter")
    return things[0]


def geometry(thing: bpy.types.Object) -> dict[str, np.ndarray]:
    """Return "vertices" (V, 3) in the world, "faces" (F, 3), and of their corners "normals" (F, 3, 3) and "uvs" (F, 3, 2), NaN without."""
    mesh, matrix = thing.data, np.array(thing.matrix_world)
    sizes = _values(mesh.polygons, "loop_total", 1, np.int32)
    if (sizes != 3).any():
        raise InputError(thing.name, "has faces that are no triangles", "mend the exporter")
    place = _values(mesh.vertices, "co", 3) @ matrix[:3, :3].T + matrix[:3, 3]
    normal = _values(mesh.corner_normals, "vector", 3) @ np.linalg.inv(matrix[:3, :3])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    uvs = _values(mesh.uv_layers.active.data, "uv", 2) if mesh.uv_layers else np.full((len(mesh.loops), 2), np.nan)
    faces = _values(mesh.loops, "vertex_index", 1, np.int32).reshape(-1, 3)
    return {"vertices": place, "faces": faces, "normals": normal.reshape(-1, 3, 3), "uvs": uvs.reshape(-1, 3, 2)}


def splats(mesh: bpy.types.Mesh) -> dict[str, np.ndarray]:
    """Return "x", "y", "z" and the attributes of splats that were read as a mesh's vertices, each (N,), by their names in the file."""
    found = {attribute.name: _values(attribute.data, "value", 1) for attribute in mesh.attributes if attribute.data_type == "FLOAT"}
    return found | dict(zip("xyz", _values(mesh.vertices, "co", 3).T, strict=True))


def _values(items: Any, name: str, width: int, kind: type = np.float32) -> np.ndarray:
    values = np.empty(width * len(items), kind)
    items.foreach_get(name, values)
    return values.reshape(-1, width) if width > 1 else values


def material(principled: bpy.types.Node, unnamed: bool) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the texels that each of INPUTS reads, uint8, and a record of the material's other values.

    Args:
        principled: Principled BSDF.
        unnamed: True for a format that names no colour spaces: all but the base colour are then set to Non-Color, as a person would.
    """
    textures, spaces, values = {}, {}, unlinked_values(principled)
    for name in INPUTS:
        image, channel, strength = source(principled.inputs[name])
        if image is None:
            continue
        if unnamed and name != "Base Color":
            image.colorspace_settings.name = "Non-Color"
        spaces[name] = image.colorspace_settings.name
        if strength is not None:
            values["normal map strength"] = strength
        texels = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(texels)
        texels = np.round(texels * 255).astype(np.uint8).reshape(image.size[1], image.size[0], -1)[..., :3]
        textures[name] = texels if name in ("Base Color", "Normal") else texels[..., channel]
    return textures, {"spaces": spaces, "values": values}


def unlinked_values(principled: bpy.types.Node) -> dict[str, Any]:
    """Return distribution, emitted light and the other values of a Principled BSDF that no texture gives, by name."""
    values: dict[str, Any] = {"distribution": principled.distribution}
    for socket in principled.inputs:
        if socket.name not in INPUTS and not socket.is_linked and hasattr(socket, "default_value"):
            value = socket.default_value
            values[socket.name] = list(value) if hasattr(value, "__len__") else value
    strength, colour = values.pop("Emission Strength", 0.0), values.pop("Emission Color", [0.0])
    return {**values, "emission": [strength * part for part in colour[:3]]}


def source(socket: bpy.types.NodeSocket) -> tuple[bpy.types.Image | None, int, float | None]:
    """Follow the links of an input back to its image.

    Returns:
        The image, or None; the channel that is read of it; the strength of a normal map in between, or None.
    """
    channel, strength, links = 0, None, list(socket.links)
    while links:
        node = links[0].from_node
        if node.bl_idname == "ShaderNodeTexImage":
            return node.image, channel, strength
        if node.bl_idname == "ShaderNodeSeparateColor":
            channel = list(node.outputs).index(links[0].from_socket)
        elif node.bl_idname == "ShaderNodeNormalMap":
            strength = float(node.inputs["Strength"].default_value)
        links = [link for before in node.inputs for link in before.links]
    return None, channel, strength


def render(scene: bpy.types.Scene, job: dict[str, Any], foot: np.ndarray, name: str) -> None:
    """Render the views of a job by Cycles, linear premultiplied, as NAME0.exr and so on.

    Args:
        scene: scene of the object.
        job: content of JOB.json.
        foot: (3,) place of the object.
        name: of the files.
    """
    settings = scene.render.image_settings
    scene.render.engine, scene.render.film_transparent = "CYCLES", True
    scene.cycles.device, scene.cycles.samples, scene.cycles.seed = "CPU", job["samples"], 0
    scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = False, False
    scene.cycles.sampling_pattern = PATTERN
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"
    placed = bpy.data.objects.new("view", bpy.data.cameras.new("view"))
    scene.collection.objects.link(placed)
    for i, view in enumerate(job["views"]):
        to_world = np.array(view["to_world"])
        to_world[:3, 3] += foot
        set_camera(placed, Camera(**{**view, "to_world": to_world}))
        look_through(scene, placed)
        scene.render.filepath = str(Path(job["out"]) / f"{name}{i}.exr")
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    sys.exit(exit_status(lambda: read_back(json.loads(Path(sys.argv[-1]).read_text("utf-8")))))
