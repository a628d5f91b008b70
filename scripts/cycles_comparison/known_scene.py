# SPDX-License-Identifier: GPL-3.0-or-later
"""Sphere above a square with exactly known geometry and materials: as dense surfels for our ray tracer and as smooth meshes for Cycles."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import torch
from irgspp.core.io.exr import read_exr, rgb_channels, write_exr
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.gaussians import SH_COEFFICIENTS, Gaussians, quaternion_to
from irgspp.irgspp_addon.world.light_to_world import world_from_map
from irgspp.irgspp_addon.world.shader_nodes import node_tree
from scenes.cycles_ground_truth import place_camera

RADIUS, HEIGHT = 0.5, 0.55  # of the sphere, which floats so that no ray starts between two touching surfaces
HALF = 1.0  # the square is -HALF..HALF at z = 0
EYE = (1.9, -1.6, 1.5)
SPREAD = 0.7  # standard deviation of a surfel over the spacing
OPACITY = 0.99
SPHERE_FRACTION = 0.45  # of all surfels


@dataclass(frozen=True)
class Surface:
    """Material of an object.

    Attributes:
        albedo: linear base colour.
        roughness: 0..1.
        metallic: 0..1.
        diffuse: True for a plain Diffuse BSDF, without our specular lobe and Blender's.
        multiscatter: True where Blender adds the light that a rough metal reflects more than once (its default), which we don't.
    """

    albedo: tuple[float, float, float]
    roughness: float = 0.5
    metallic: float = 0.0
    diffuse: bool = False
    multiscatter: bool = False


def camera(size: int) -> Camera:
    """Return a camera of size x size pixels that looks down on the scene, which fills the image."""
    return Camera(size, size, 1.6 * size, 1.6 * size, size / 2, size / 2, look_at(EYE, (0.0, 0.0, 0.3)))


def first_hits(view: Camera) -> np.ndarray:
    """Return what each pixel's ray meets first, (H, W): 0 nothing, 1 the square, 2 the sphere."""
    rays, eye = view.rays().astype(np.float64), view.centre - np.array([0.0, 0.0, HEIGHT])
    a, b, c = (rays**2).sum(-1), rays @ eye, eye @ eye - RADIUS**2
    ground = view.centre - rays * (view.centre[2] / rays[..., 2:])
    on_square = (np.abs(ground[..., :2]) < HALF).all(-1) & (rays[..., 2] < 0)
    return np.where(b * b > a * c, 2, np.where(on_square, 1, 0))


def inner_pixels(objects: np.ndarray, margin: int) -> np.ndarray:
    """Return the pixels away from every edge, because surfels have soft edges.

    Args:
        objects: number of the object at each pixel (H, W), 0 for none.
        margin: pixels of distance.

    Returns:
        Mask (H, W).
    """
    inner = objects > 0
    for rows in range(-margin, margin + 1):
        for columns in range(-margin, margin + 1):
            inner &= np.roll(objects, (rows, columns), (0, 1)) == objects
    inner[:margin], inner[-margin:], inner[:, :margin], inner[:, -margin:] = False, False, False, False
    return inner


def splats(count: int, sphere: Surface, square: Surface) -> Gaussians:
    """Return surfels of constant material, so dense that both surfaces are closed; their radiance is left at 0.5.

    Args:
        count: about how many.
        sphere: material of the sphere.
        square: material of the square.
    """
    on_sphere = round(SPHERE_FRACTION * count)
    ball, ground = _sphere_points(on_sphere), _square_points(round((count - on_sphere) ** 0.5))
    points = np.concatenate([RADIUS * ball + [0.0, 0.0, HEIGHT], ground])
    normals = np.concatenate([ball, np.broadcast_to([0.0, 0.0, 1.0], ground.shape)])
    spacing = np.repeat([np.sqrt(4 * np.pi / on_sphere) * RADIUS, 2 * HALF / len(ground) ** 0.5], [on_sphere, len(ground)])
    rows = torch.tensor([[*s.albedo, s.roughness, s.metallic] for s in (sphere, square)])
    material = rows.clamp(1e-6, 1 - 1e-6).logit().repeat_interleave(torch.tensor([on_sphere, len(ground)]), 0).T.contiguous()
    n = len(points)
    return Gaussians(
        torch.tensor(points.T, dtype=torch.float32),
        quaternion_to(torch.tensor(normals.T, dtype=torch.float32)),
        torch.tensor(np.log(SPREAD * spacing), dtype=torch.float32)[None].repeat(2, 1),
        torch.full((n,), OPACITY).logit(),
        torch.zeros(SH_COEFFICIENTS, 3, n),
        material,
    )


def lift(count: int) -> float:
    """Return the distance above a surface at which rays must start to clear the rims of the surfels around, which stand off the sphere."""
    spacing = np.sqrt(4 * np.pi / (SPHERE_FRACTION * count)) * RADIUS
    rim = SPREAD * spacing * np.sqrt(2 * np.log(255 * OPACITY))
    return float(rim**2 / (2 * RADIUS))


def _sphere_points(count: int) -> np.ndarray:
    """Return points spread evenly over the unit sphere (Fibonacci lattice), (count, 3)."""
    z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)


def _square_points(side: int) -> np.ndarray:
    """Return the centres of the square's cells, (side^2, 3)."""
    x = HALF * ((np.arange(side) + 0.5) * 2 / side - 1)
    return np.stack([*np.meshgrid(x, x), np.zeros((side, side))], -1).reshape(-1, 3)


class CyclesScene:
    """Same scene as Blender's scene, under one light, with materials chosen for each rendering."""

    def __init__(self, light: np.ndarray) -> None:
        """Replace Blender's scene by this one.

        Args:
            light: linear lat-long map (H, W, 3).
        """
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        self.scene = bpy.context.scene
        self.sphere = self._add("sphere", *_sphere_mesh(256))
        corners = np.array([[-HALF, -HALF, 0.0], [HALF, -HALF, 0.0], [HALF, HALF, 0.0], [-HALF, HALF, 0.0]])
        self.square = self._add("square", corners, np.array([[0, 1, 2, 3]]))
        with tempfile.TemporaryDirectory() as folder:
            write_exr(Path(folder) / "light.exr", rgb_channels(light))
            self.scene.world = world_from_map(Path(folder) / "light.exr", pack=True)
        self.scene.world.cycles.sampling_method = "MANUAL"
        self.scene.world.cycles.sample_map_resolution = 4 * light.shape[1]

    def _add(self, name: str, vertices: np.ndarray, faces: np.ndarray) -> bpy.types.Object:
        """Add a mesh object."""
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(vertices, [], faces)
        mesh.shade_smooth()
        thing = bpy.data.objects.new(name, mesh)
        thing.cycles.shadow_terminator_geometry_offset = 0.0
        self.scene.collection.objects.link(thing)
        return thing

    def render(self, view: Camera, sphere: Surface, square: Surface, bounces: int, samples: int, seed: int = 1) -> np.ndarray:
        """Render through each pixel's centre, without denoising.

        Args:
            view: camera of H x W pixels.
            sphere: material of the sphere.
            square: material of the square.
            bounces: bounces of indirect light, 0 for direct light only.
            samples: samples per pixel.
            seed: seed of Cycles.

        Returns:
            (H, W, 4) linear premultiplied.
        """
        for thing, surface in ((self.sphere, sphere), (self.square, square)):
            thing.data.materials.clear()
            thing.data.materials.append(_material(surface))
        _set_up(self.scene, bounces, samples, seed)
        place_camera(self.scene, view)
        with tempfile.TemporaryDirectory() as folder:
            self.scene.render.filepath = str(Path(folder) / "picture.exr")
            bpy.ops.render.render(write_still=True)
            channels = read_exr(Path(folder) / "picture.exr")
        return np.stack([channels[c] for c in "RGBA"], -1)


def _sphere_mesh(rings: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and quads on meridians and parallels; the quads at the poles have one side of length 0."""
    theta, phi = np.linspace(0, np.pi, rings + 1), np.arange(2 * rings) * np.pi / rings
    r, z = np.sin(theta)[:, None], np.cos(theta)[:, None]
    unit = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z), -1)
    index = np.arange(unit.shape[0] * unit.shape[1]).reshape(unit.shape[:2])
    beside = np.roll(index, -1, 1)
    quads = np.stack([index[:-1], index[1:], beside[1:], beside[:-1]], -1)
    return RADIUS * unit.reshape(-1, 3) + [0.0, 0.0, HEIGHT], quads.reshape(-1, 4)


def _set_up(scene: bpy.types.Scene, bounces: int, samples: int, seed: int) -> None:
    """Set Cycles to an unbiased path tracer, without what saves time at the price of bias."""
    scene.render.engine, scene.render.film_transparent = "CYCLES", True
    cycles = scene.cycles
    cycles.samples, cycles.seed, cycles.use_adaptive_sampling, cycles.use_denoising = samples, seed, False, False
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
    cycles.caustics_reflective, cycles.blur_glossy, cycles.light_sampling_threshold = True, 0.0, 0.0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 0.01
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"


def _material(surface: Surface) -> bpy.types.Material:
    """Return a material of a Diffuse or a Principled BSDF."""
    material = bpy.data.materials.new("known")
    nodes, links = node_tree(material)
    shader = nodes.new("ShaderNodeBsdfDiffuse" if surface.diffuse else "ShaderNodeBsdfPrincipled")
    shader.inputs["Color" if surface.diffuse else "Base Color"].default_value = (*surface.albedo, 1.0)
    if not surface.diffuse:
        shader.distribution = "MULTI_GGX" if surface.multiscatter else "GGX"
        shader.inputs["Roughness"].default_value = surface.roughness
        shader.inputs["Metallic"].default_value = surface.metallic
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    return material
