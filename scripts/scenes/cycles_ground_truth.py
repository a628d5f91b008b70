# SPDX-License-Identifier: GPL-3.0-or-later
"""Images and exact surface layers of a Blender scene, rendered by Cycles."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
import numpy as np
from irgspp.core.io.exr import read_exr
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.surface import draw_on_triangles
from mathutils import Matrix, Vector
from mathutils.bvhtree import BVHTree

ALBEDO, MATERIAL = "irgspp_albedo", "irgspp_material"


def prepare(scene: bpy.types.Scene, samples: int, seed: int, threads: int = 0, transparent: bool = True) -> None:
    """Set a scene to complete light paths, and add AOVs of the layers to every material.

    Args:
        scene: scene to render.
        samples: samples per pixel.
        seed: seed of Cycles.
        threads: threads of Cycles, or 0 for as many as the machine has.
        transparent: images are transparent beside the objects; otherwise they show the World there.
    """
    scene.render.engine = "CYCLES"
    scene.render.threads_mode, scene.render.threads = ("FIXED", threads) if threads else ("AUTO", scene.render.threads)
    scene.render.film_transparent = transparent
    scene.render.use_persistent_data = True
    cycles = scene.cycles
    cycles.samples, cycles.seed, cycles.use_adaptive_sampling = samples, seed, False
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 8, 6, 6
    cycles.caustics_reflective, cycles.blur_glossy = True, 0.0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    layer = scene.view_layers[0]
    layer.use_pass_normal = layer.use_pass_position = True
    for name in (ALBEDO, MATERIAL):
        aov = layer.aovs.add()
        aov.name, aov.type = name, "COLOR"
    for material in bpy.data.materials:
        _expose_inputs(material)


def _expose_inputs(material: bpy.types.Material) -> None:
    """Connect the inputs of the Principled BSDF to the AOVs as well."""
    tree = material.node_tree
    principled = next((n for n in tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled"), None) if tree else None
    if tree is None or principled is None:
        return
    combined = tree.nodes.new("ShaderNodeCombineColor")
    combined.inputs["Blue"].default_value = 0.0
    _copy_input(tree, principled.inputs["Roughness"], combined.inputs["Red"])
    _copy_input(tree, principled.inputs["Metallic"], combined.inputs["Green"])
    for name, source in ((ALBEDO, principled.inputs["Base Color"]), (MATERIAL, combined.outputs["Color"])):
        output = tree.nodes.new("ShaderNodeOutputAOV")
        output.aov_name = name
        if source.is_output:
            tree.links.new(source, output.inputs["Color"])
        else:
            _copy_input(tree, source, output.inputs["Color"])


def _copy_input(tree: bpy.types.NodeTree, source: bpy.types.NodeSocket, target: bpy.types.NodeSocket) -> None:
    """Give a socket the link or the value of another."""
    if source.is_linked:
        tree.links.new(source.links[0].from_socket, target)
    else:
        target.default_value = source.default_value


def place_camera(scene: bpy.types.Scene, camera: Camera) -> None:
    """Set the scene's camera to a centred camera with square pixels.

    Args:
        scene: scene to render.
        camera: camera to set.
    """
    if scene.camera is None:
        scene.camera = bpy.data.objects.new("irgspp camera", bpy.data.cameras.new("irgspp camera"))
        scene.collection.objects.link(scene.camera)
    lens = scene.camera.data
    lens.type, lens.sensor_fit = "PERSP", "HORIZONTAL"
    lens.lens = camera.fx / camera.width * lens.sensor_width
    lens.shift_x = lens.shift_y = 0.0
    lens.clip_start, lens.clip_end = 1e-3, 1e5
    scene.camera.parent = None
    scene.camera.matrix_world = Matrix(camera.to_world.tolist())
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = camera.width, camera.height, 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0


def render_image(scene: bpy.types.Scene) -> dict[str, np.ndarray]:
    """Render the scene through its camera.

    Returns:
        "rgba" (H, W, 4) linear premultiplied and denoised; "albedo" (H, W, 3) linear and "material" (H, W, 2), roughness and metallic, both
        divided by alpha, 0 where nothing is.
    """
    scene.cycles.use_denoising = True
    scene.cycles.denoiser = "OPENIMAGEDENOISE"
    scene.cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
    scene.cycles.denoising_prefilter = "ACCURATE"
    scene.cycles.filter_width = 1.5
    channels = _render_layers(scene)
    rgba = _stack(channels, "Combined", "RGBA")
    alpha = np.maximum(rgba[..., 3:], 1e-6)
    seen = rgba[..., 3:] > 1e-3
    albedo = np.where(seen, _stack(channels, ALBEDO, "RGB") / alpha, 0)
    material = np.where(seen, _stack(channels, MATERIAL, "RG") / alpha, 0)
    return {"rgba": rgba, "albedo": albedo, "material": material}


def render_geometry(scene: bpy.types.Scene, camera: Camera) -> dict[str, np.ndarray]:
    """Render the geometry that one ray through each pixel's centre hits.

    Args:
        scene: scene to render.
        camera: the scene's camera.

    Returns:
        "normal" (H, W, 3) unit, in world axes, "depth" (H, W) planar; 0 where nothing is.
    """
    samples = scene.cycles.samples
    scene.cycles.use_denoising, scene.cycles.samples, scene.cycles.filter_width = False, 1, 0.01
    channels = _render_layers(scene)
    scene.cycles.samples = samples
    hit = channels["Combined.A"] > 0.5
    normal = _stack(channels, "Normal", "XYZ")
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    depth = (_stack(channels, "Position", "XYZ") - camera.centre) @ camera.forward
    return {"normal": np.where(hit[..., None], normal, 0), "depth": np.where(hit, depth, 0)}


def _render_layers(scene: bpy.types.Scene) -> dict[str, np.ndarray]:
    """Render to a multilayer EXR and return its channels (H, W) by pass and channel."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    if hasattr(settings, "use_exr_interleave"):  # Blender 5 would write one part per pass
        settings.use_exr_interleave = True
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "layers.exr")
        bpy.ops.render.render(write_still=True, scene=scene.name)
        channels = read_exr(Path(folder) / "layers.exr")
    return {name.split(".", 1)[1]: pixels for name, pixels in channels.items()}


def _stack(channels: dict[str, np.ndarray], layer: str, names: str) -> np.ndarray:
    """Return channels of a layer as (H, W, C)."""
    return np.stack([channels[f"{layer}.{name}"] for name in names], -1)


def visible_points(triangles: np.ndarray, cameras: list[Camera], count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw area-uniform samples of the surface that some camera sees.

    Args:
        triangles: corners of the surface's triangles (T, 3, 3).
        cameras: cameras that may see it.
        count: number of samples at most.
        seed: seed of the samples.

    Returns:
        Positions (N, 3) and geometric normals (N, 3), N <= count.
    """
    tree = BVHTree.FromPolygons(triangles.reshape(-1, 3).tolist(), np.arange(3 * len(triangles)).reshape(-1, 3).tolist())
    a, b, c = triangles.transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=-1)
    random = np.random.default_rng(seed)
    pick, weight = draw_on_triangles(area, 2 * count, random)
    points = (triangles[pick] * weight).sum(1)
    normals = cross[pick] / area[pick, None]
    size = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    seen = [i for i in range(len(points)) if any(_sees(tree, camera.centre, points[i], 1e-4 * size) for camera in cameras)][:count]
    return points[seen], normals[seen]


def _sees(tree: BVHTree, eye: np.ndarray, point: np.ndarray, slack: float) -> bool:
    """Return True where the first hit of a ray from the eye is the point."""
    ray = Vector(point - eye)
    distance = ray.length
    hit = tree.ray_cast(Vector(eye), ray.normalized())[3]
    return hit is not None and abs(hit - distance) < slack


def world_triangles(scene: bpy.types.Scene) -> np.ndarray:
    """Return the corners of everything that renders, with modifiers applied, (T, 3, 3)."""
    graph = bpy.context.evaluated_depsgraph_get()
    parts = []
    for thing in scene.objects:
        if thing.type not in {"MESH", "CURVE", "SURFACE", "META", "FONT"} or thing.hide_render:
            continue
        evaluated = thing.evaluated_get(graph)
        mesh = evaluated.to_mesh()
        mesh.calc_loop_triangles()
        corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
        vertices = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.loop_triangles.foreach_get("vertices", corners)
        mesh.vertices.foreach_get("co", vertices)
        matrix = np.array(thing.matrix_world)
        world = vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
        parts.append(world[corners].reshape(-1, 3, 3))
        evaluated.to_mesh_clear()
    return np.concatenate(parts)
