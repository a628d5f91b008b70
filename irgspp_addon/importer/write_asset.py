# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a run's object in formats of other programs, in a separate process with `bpy`: `launch.py ... JOB.json OUT.fbx OUT.usdc`.

JOB.json holds "run" (folder), "name" of the asset, "textures" (folder of albedo, roughness, metallic, normal and orm.png), "pack" (True to
put them into the file), "tiles" (UDIM tiles along a side of the textures), "lods" (fraction of the triangles in each further level),
"hulls" (.npz, or null), "occlusion" (True where red of orm.png is to be read) and "matrix" (4 x 4, that the vertices are multiplied by).
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.errors import InputError, IrgsppError
from ..exit_status import exit_status
from ..world.shader_nodes import node_tree
from .asset_parts import add_hulls, add_levels
from .materials import TEXTURES
from .run_mesh import textured_mesh
from .texture_images import existing_paths, load_texture

AXES = {"forward_axis": "NEGATIVE_Z", "up_axis": "Y"}  # of OBJ


def write_asset(job: dict[str, Any], targets: list[Path]) -> None:
    """Replace the open file by the asset and write it in one or several formats.

    Args:
        job: content of JOB.json.
        targets: files to write; their suffixes decide on the formats.

    Raises:
        InputError: if the run lacks its mesh or a texture, or a format is unknown.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    name, textures = job["name"], Path(job["textures"])
    mesh = textured_mesh(Path(job["run"]) / "mesh.ply", name, np.array(job["matrix"]), job["tiles"])
    material = bpy.data.materials.new(name)
    mesh.materials.append(material)
    full = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(full)
    if job["lods"]:
        add_levels(full, job["lods"], name)
    if job["hulls"]:
        add_hulls(full, Path(job["hulls"]), np.array(job["matrix"]))
    for target in targets:
        write = WRITERS.get(target.suffix.lower())
        if write is None:
            raise InputError(target, "has no known suffix", f"use {', '.join(WRITERS)}")
        _build_material(material, textures, job["tiles"], target.suffix.lower() == ".glb", bool(job["occlusion"]))
        write(target, bool(job["pack"]))


def _build_material(material: bpy.types.Material, textures: Path, tiles: int, packed_channels: bool, occlusion: bool) -> None:
    """Link the textures to a Principled BSDF: roughness and metallic as images of their own, or as channels of orm.png (glTF)."""
    nodes, links = node_tree(material)
    principled, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    links.new(principled.outputs["BSDF"], output.inputs["Surface"])
    names = ("albedo", "orm", "normal") if packed_channels else TEXTURES
    images = {name: nodes.new("ShaderNodeTexImage") for name in names}
    for name, node in images.items():
        node.image = load_texture(textures, name, False, tiles)
        node.image.name = name
    links.new(images["albedo"].outputs["Color"], principled.inputs["Base Color"])
    if packed_channels:
        channels = nodes.new("ShaderNodeSeparateColor")
        links.new(images["orm"].outputs["Color"], channels.inputs["Color"])
        links.new(channels.outputs["Green"], principled.inputs["Roughness"])
        links.new(channels.outputs["Blue"], principled.inputs["Metallic"])
        if occlusion:
            links.new(channels.outputs["Red"], _gltf_output(nodes).inputs["Occlusion"])
    else:
        links.new(images["roughness"].outputs["Color"], principled.inputs["Roughness"])
        links.new(images["metallic"].outputs["Color"], principled.inputs["Metallic"])
    normal = nodes.new("ShaderNodeNormalMap")
    links.new(images["normal"].outputs["Color"], normal.inputs["Color"])
    links.new(normal.outputs["Normal"], principled.inputs["Normal"])


def _gltf_output(nodes: bpy.types.Nodes) -> bpy.types.Node:
    """Return the group of nodes by which Blender's exporter of glTF knows the occlusion texture."""
    tree = bpy.data.node_groups.new("glTF Material Output", "ShaderNodeTree")
    tree.interface.new_socket("Occlusion", in_out="INPUT", socket_type="NodeSocketFloat")
    node = nodes.new("ShaderNodeGroup")
    node.node_tree = tree
    return node


def _write_obj(target: Path, pack: bool) -> None:
    _call(bpy.ops.wm.obj_export, target, export_pbr_extensions=True, path_mode="RELATIVE", export_triangulated_mesh=False, **AXES)


def _write_fbx(target: Path, pack: bool) -> None:
    textures = {"path_mode": "COPY", "embed_textures": True} if pack else {"path_mode": "RELATIVE"}
    axes = {"axis_forward": "-Z", "axis_up": "Y", "apply_scale_options": "FBX_SCALE_ALL"}
    _call(bpy.ops.export_scene.fbx, target, object_types={"MESH"}, use_tspace=True, bake_anim=False, **axes, **textures)


def _write_glb(target: Path, pack: bool) -> None:
    _call(bpy.ops.export_scene.gltf, target, export_format="GLB", export_tangents=True, export_animations=False, export_yup=True)


def _write_usd(target: Path, pack: bool) -> None:
    axes = {"export_global_forward_selection": "NEGATIVE_Z", "export_global_up_selection": "Y", "convert_orientation": True}
    left_out = dict.fromkeys(("export_animation", "export_lights", "export_cameras", "convert_world_material", "export_mesh_colors"), False)
    # 4.2 and 4.3 name the choice otherwise.
    textures = {"export_textures_mode": "NEW" if pack else "KEEP", "export_textures": pack, "relative_paths": True}
    root = "/" + re.sub(r"\W", "_", f"_{target.stem}" if target.stem[:1].isdigit() else target.stem)
    with existing_paths(bpy.data.images):
        _call(bpy.ops.wm.usd_export, target, root_prim_path=root, generate_preview_surface=True, **axes, **left_out, **textures)


WRITERS = {
    ".obj": _write_obj,
    ".fbx": _write_fbx,
    ".glb": _write_glb,
    ".usd": _write_usd,
    ".usdc": _write_usd,
    ".usda": _write_usd,
    ".usdz": _write_usd,
}


def _call(operator: Any, target: Path, **options: Any) -> None:
    """Run an export operator with those of the options that this version of Blender knows.

    Raises:
        IrgsppError: if it writes no file.
    """
    known = {prop.identifier for prop in operator.get_rna_type().properties}
    try:
        operator(filepath=str(target), **{name: value for name, value in options.items() if name in known})
    except RuntimeError as error:
        raise IrgsppError(f"{target}: Blender can't write it: {error}") from error
    if not target.is_file():
        raise IrgsppError(f"{target}: Blender wrote no file")


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(prog="irgspp.irgspp_addon.importer.write_asset")
    parser.add_argument("job", type=Path)
    parser.add_argument("targets", type=Path, nargs="+")
    args = parser.parse_args(argv)
    return exit_status(lambda: write_asset(json.loads(args.job.read_text(encoding="utf-8")), args.targets))


if __name__ == "__main__":
    sys.exit(main())
