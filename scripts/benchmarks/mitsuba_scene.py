# SPDX-License-Identifier: GPL-3.0-or-later
"""Object, light and cameras of ours as Mitsuba's scene; runs in Mitsuba's own process, imported once a variant is set."""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportArgumentType=false
# (Mitsuba is optional, and its types depend on the variant)

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from . import mitsuba_brdf

# Mitsuba's light maps have +Y up and their seam elsewhere: its x, y, z are our y, z, x.
MAP_TO_WORLD = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)
SAMPLER = "multijitter"  # 2 dB better than independent random numbers, at the same cost
CAMERA_AXES = np.diag([-1.0, 1.0, -1.0, 1.0])  # Mitsuba's camera looks along +Z, with +X to the left


VERTEX_VALUES = {"vertex_albedo": 3, "vertex_roughness": 1, "vertex_metallic": 1}
LAYERS = ("albedo", "roughness", "metallic", "alpha")


def material(arrays: dict[str, np.ndarray], brdf: str) -> dict[str, Any]:
    """Return the BSDF of the materials in the arrays: textures as texture_<name>, or the vertices' own values.

    Args:
        arrays: arrays of the request, with the table `body` (N, N).
        brdf: "ours" or "principled".
    """
    if brdf == "ours":
        mitsuba_brdf.register(arrays["body"])
    textures = {key.removeprefix("texture_"): value for key, value in arrays.items() if key.startswith("texture_")}
    return textured_material(textures, brdf) if textures else vertex_material()


def lit(shape: mi.Mesh, image: np.ndarray, bounces: int) -> mi.Scene:
    """Return the scene of an object under a light map, which itself is invisible.

    Args:
        shape: the object.
        image: linear lat-long map (H, W, 3).
        bounces: bounces of indirect light.
    """
    integrator = {"type": "path", "max_depth": bounces + 2, "hide_emitters": True}
    return mi.load_dict({"type": "scene", "integrator": integrator, "object": shape, "light": light(image)})


def textured_material(textures: dict[str, np.ndarray], brdf: str) -> dict[str, Any]:
    """Return a BSDF that reads textures as Blender does.

    Args:
        textures: "albedo" (T, T, 3) uint8 sRGB, "roughness" and "metallic" (T, T) uint8, "normal" (T, T, 3) uint8.
        brdf: "ours", or "principled" for Mitsuba's own.
    """
    kind = mitsuba_brdf.NAME if brdf == "ours" else "principled"
    read = {name: _bitmap(textures[name], raw=name != "albedo") for name in ("albedo", "roughness", "metallic", "normal")}
    inner: dict[str, Any] = {"type": kind, "base_color": read["albedo"], "roughness": read["roughness"], "metallic": read["metallic"]}
    if kind == "principled":
        inner["eta"] = 1.5
    return {"type": "normalmap", "normalmap": read["normal"], "bsdf": inner}


def _bitmap(texture: np.ndarray, raw: bool) -> dict[str, Any]:
    """Return a texture; `raw` is True for values that are not sRGB-encoded."""
    image = texture if texture.ndim == 3 else texture[..., None]
    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(image)), "raw": raw, "filter_type": "bilinear"}


def vertex_material() -> dict[str, Any]:
    """Return a BSDF that reads the vertices' own values."""
    names = {"base_color": "vertex_albedo", "roughness": "vertex_roughness", "metallic": "vertex_metallic"}
    return {"type": mitsuba_brdf.NAME, **{key: {"type": "mesh_attribute", "name": name} for key, name in names.items()}}


def mesh_shape(arrays: dict[str, np.ndarray], material: dict[str, Any]) -> mi.Mesh:
    """Return a mesh with a material.

    Args:
        arrays: vertices, normals (V, 3), faces (F, 3); uvs (V, 2) with textures, v = 0 at the bottom; VERTEX_VALUES if any.
        material: BSDF of the mesh.
    """
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(material)
    uvs = arrays.get("uvs")
    count = (len(arrays["vertices"]), len(arrays["faces"]))
    mesh = mi.Mesh("object", *count, has_vertex_normals=True, has_vertex_texcoords=uvs is not None, props=properties)
    data = mi.traverse(mesh)
    data["vertex_positions"] = np.ascontiguousarray(arrays["vertices"], np.float32).ravel()
    data["vertex_normals"] = np.ascontiguousarray(arrays["normals"], np.float32).ravel()
    data["faces"] = np.ascontiguousarray(arrays["faces"], np.uint32).ravel()
    if uvs is not None:
        data["vertex_texcoords"] = np.stack([uvs[:, 0], 1 - uvs[:, 1]], 1).astype(np.float32).ravel()
    data.update()
    for name, size in VERTEX_VALUES.items():
        if name in arrays:
            mesh.add_attribute(name, size, np.ascontiguousarray(arrays[name], np.float32).ravel())
    return mesh


def light(image: np.ndarray) -> dict[str, Any]:
    """Return the emitter of a light map.

    Args:
        image: linear lat-long map (H, W, 3), row 0 = +Z, middle column +X; see `at_nodes`.
    """
    bitmap = mi.Bitmap(at_nodes(np.asarray(image, np.float32)))
    return {"type": "envmap", "bitmap": bitmap, "to_world": mi.ScalarTransform4f(MAP_TO_WORLD)}


def at_nodes(image: np.ndarray) -> np.ndarray:
    """Return a light map resampled for Mitsuba, whose first and last rows are at the poles while ours are half a texel away.

    Args:
        image: (H, W, 3).

    Returns:
        (2 H + 1, W, 3) float32.
    """
    rows = np.empty((2 * len(image) + 1, *image.shape[1:]), np.float32)
    rows[1::2], rows[0], rows[-1] = image, image[0], image[-1]
    rows[2:-1:2] = 0.5 * (image[1:] + image[:-1])
    return rows


def sensor(camera: dict[str, Any]) -> mi.Sensor:
    """Return a camera.

    Args:
        camera: "width", "height", "fx", "fy", "cx", "cy" in pixels and "to_world" (4, 4), axes as Blender's.

    Raises:
        ValueError: where pixels are not square, which Mitsuba's cameras do not support.
    """
    width, height = camera["width"], camera["height"]
    if abs(camera["fx"] / camera["fy"] - 1) > 1e-3:
        raise ValueError("Mitsuba's cameras support square pixels only")
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(width / (2 * camera["fx"]))),
            "fov_axis": "x",
            "principal_point_offset_x": 0.5 - camera["cx"] / width,
            "principal_point_offset_y": 0.5 - camera["cy"] / height,
            "near_clip": 1e-3,
            "far_clip": 1e4,
            "to_world": mi.ScalarTransform4f(np.array(camera["to_world"]) @ CAMERA_AXES),
            "sampler": {"type": SAMPLER},
            "film": {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgba", "rfilter": {"type": "box"}},
        }
    )


class Layers(mi.SamplingIntegrator):
    """Integrator that renders the vertices' materials: albedo as the image, roughness and metallic as further channels."""

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Return the materials at the first hit (Mitsuba's interface of an integrator).

        Args:
            scene: scene to trace.
            sampler: random numbers, unused.
            ray: camera rays.
            medium: medium of the camera, unused.
            active: mask of the lanes.

        Returns:
            Albedo (3,), the mask of the hits, and roughness and metallic.
        """
        si = scene.ray_intersect(ray, active)
        found = si.is_valid() & active
        values = [si.shape.eval_attribute_3("vertex_albedo", si, found)]
        values += [si.shape.eval_attribute_1(f"vertex_{name}", si, found) for name in ("roughness", "metallic")]
        albedo, roughness, metallic = (dr.select(found, value, 0) for value in values)
        return albedo, found, [roughness, metallic]

    def aov_names(self) -> list[str]:
        """Return the names of the further channels."""
        return ["roughness", "metallic"]


def layers(scene: mi.Scene, sensor: mi.Sensor, samples: int) -> dict[str, np.ndarray]:
    """Render the material layers named in LAYERS.

    Args:
        scene: scene to render.
        sensor: camera.
        samples: samples per pixel.

    Returns:
        Albedo (H, W, 3), roughness and metallic (H, W), each divided by alpha, and alpha (H, W).
    """
    image = np.array(mi.render(scene, sensor=sensor, integrator=Layers(mi.Properties()), spp=samples))
    alpha = image[..., 3]
    straight = image / np.maximum(alpha, 1e-6)[..., None]
    return {"albedo": straight[..., :3], "roughness": straight[..., 4], "metallic": straight[..., 5], "alpha": alpha}
