# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of a run's object for other programs and game engines: glTF, USD, OBJ and FBX, with levels of detail and collision hulls."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.run_json import udim_tiles
from ..machine.blender_process import check_written, run_in_blender
from ..progress.protocol import Progress
from ..scene.mesh import Mesh, placed_mesh, standing
from ..scene.mesh_ply import load_mesh_ply
from ..scene.textures import load_textures
from .blend_file import write_blend
from .collision import collision_hulls
from .mesh_files import save_asset_glb
from .options import LEVELS, AssetOptions
from .texture_set import occlusion_of, save_texture_set


def export_asset(run: Path, target: Path, options: AssetOptions, progress: Progress) -> None:
    """Write the object as .glb, .usd, .usdc, .usda, .usdz, .obj or .fbx: turned and scaled as `options` say, its foot at the origin.

    Args:
        run: folder of the finished run.
        target: file to write; what lies beside it (.mtl, NAME_textures) is replaced with it.
        options: levels of detail, collision hulls, textures.
        progress: receives the phases, and is asked whether to stop.

    Raises:
        InputError: when the run lacks a part, or an option doesn't fit the format.
        Cancelled: when the user stops the work.
        NoBlender: when Blender is needed and not found.
        IrgsppError: when Blender fails.
    """
    suffix, mesh = target.suffix.lower(), load_mesh_ply(run / "mesh.ply")
    packed, matrix = options.packs(suffix), standing(mesh.vertices, options.matrix(suffix))
    tiles = options.tiles(suffix, udim_tiles(run))
    if suffix == ".glb" and not (options.lods or options.collision):
        save_production_glb(placed_mesh(mesh, matrix), run, target, options.occlusion)
        return
    with staged(target) as staging, tempfile.TemporaryDirectory() as scratch:
        textures = Path(scratch) / "textures" if packed else staging / f"{target.stem}_textures"
        occluded = mesh if options.occlusion else None
        save_texture_set(run, textures, options.normal_map, suffix == ".glb", occluded, tiles)
        job = {"textures": str(textures), "tiles": tiles, "matrix": matrix.tolist(), "pack": packed, "occlusion": options.occlusion}
        job |= asset_job(run, target.stem, options, Path(scratch), progress)
        (Path(scratch) / "job.json").write_text(json.dumps(job), encoding="utf-8")
        progress.phase("write", 0)
        words = [str(Path(scratch) / "job.json"), str(staging / target.name)]
        status, line = run_in_blender("irgspp_addon.importer.write_asset", words, lambda: progress.cancelled)
        check_written(status, line, target, staging / target.name)


def export_blend(run: Path, target: Path, material: str, options: AssetOptions, progress: Progress) -> None:
    """Write the run's scene as .blend, with levels of detail and collision hulls, its textures packed or beside it.

    Args:
        run: folder of the finished run.
        target: .blend file to write.
        material: what the material reads, "textures" or "attributes".
        options: levels of detail, collision hulls, textures.
        progress: receives the phases, and is asked whether to stop.

    Raises:
        InputError: when the run has no mesh, or the file can't be written.
        Cancelled: when the user stops the work.
        NoBlender: when no Blender is found.
        IrgsppError: when Blender fails.
    """
    packed, tiles = options.packs(".blend"), options.tiles(".blend", udim_tiles(run))
    with tempfile.TemporaryDirectory() as scratch, staged(target) as staging:
        job = asset_job(run, run.resolve().name, options, Path(scratch), progress)
        (Path(scratch) / "job.json").write_text(json.dumps(job), encoding="utf-8")
        additions = ["--parts", str(Path(scratch) / "job.json")]
        additions += ["--transform=" + ",".join(f"{value:.9g}" for value in options.matrix(".blend").reshape(-1))]
        if not packed:
            folder = staging / f"{target.stem}_textures"
            save_texture_set(run, folder, occluded=load_mesh_ply(run / "mesh.ply") if options.occlusion else None, tiles=tiles)
            additions += ["--textures", str(folder)]
        progress.phase("write", 0)
        write_blend(run, staging / target.name, material, progress, additions, target)


def asset_job(run: Path, name: str, options: AssetOptions, scratch: Path, progress: Progress) -> dict:
    """Return what Blender's process is told of the asset: "run", "name", "lods" and "hulls", a file that is written here.

    Args:
        run: folder of the finished run.
        name: of the asset.
        options: levels of detail, collision hulls.
        scratch: folder for the hulls.
        progress: receives the phase of the hulls.
    """
    hulls = None
    if options.collision:
        hulls = scratch / "hulls.npz"
        found = collision_hulls(load_mesh_ply(run / "mesh.ply"), progress)
        arrays = {f"{part}{i}": values for i, hull in enumerate(found) for part, values in zip(("vertices", "faces"), hull, strict=True)}
        np.savez(hulls, **arrays)  # pyright: ignore[reportArgumentType]
    lods = LEVELS if options.lods else ()
    return {"run": str(run.resolve()), "name": name, "lods": list(lods), "hulls": None if hulls is None else str(hulls)}


def save_production_glb(mesh: Mesh, run: Path, target: Path, occlusion: bool = False) -> None:
    """Write a mesh with the run's textures as .glb with tangents.

    Args:
        mesh: of the run, on its foot at the origin.
        run: folder of the finished run.
        target: file to write.
        occlusion: True to trace its occlusion.
    """
    textures = load_textures(run / "textures")
    if occlusion:
        textures["occlusion"] = occlusion_of(mesh, textures)
    save_asset_glb(dataclasses.replace(mesh, textures=textures), target, target.stem)


@contextmanager
def staged(target: Path) -> Iterator[Path]:
    """Yield a folder next to `target`; after the block its contents replace those of the same names beside `target`, folders as a whole.

    Args:
        target: the file to write; all other files are beside it, so that relative paths between them stay valid.

    Raises:
        InputError: when the folder is not writable.
    """
    try:
        folder = Path(tempfile.mkdtemp(prefix=f".{target.stem}.", dir=target.resolve().parent))
    except OSError as error:
        raise InputError(target.parent, f"is not writable ({error.strerror})", "choose another folder") from error
    try:
        yield folder
        for made in sorted(folder.iterdir(), key=lambda path: path.name == target.name):  # the file itself last
            _move(made, target.resolve().parent / made.name)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _move(source: Path, target: Path) -> None:
    """Move a file or folder within a folder's tree, over an older one."""
    if target.is_dir() and source.is_dir():
        shutil.rmtree(target)
    os.replace(source, target)
