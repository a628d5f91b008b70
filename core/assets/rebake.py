# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking of a finished run again: other texture size, other UDIM tiles, other number of triangles, or an edited mesh."""

from __future__ import annotations

import dataclasses
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from ..capture.source import posed_dataset
from ..detail.report import DetailReport
from ..errors import Cancelled, InputError, IrgsppError
from ..io.file_lock import FileLock
from ..io.run_json import udim_tiles
from ..machine.cpu_memory import check_texture_memory
from ..machine.disk_space import check_texture_disk_space
from ..machine.quick_imports import quick_imports
from ..progress.protocol import Progress
from ..run_folder import RunFolder, read_run
from ..scene.camera_files import load_run_cameras
from ..scene.edited_mesh import load_edited_mesh
from ..scene.mesh import Mesh
from ..scene.mesh_ply import save_mesh_ply
from ..scene.textures import CHANNELS, save_textures
from ..scene.udim import FOLDER
from ..settings import overrides
from ..settings.schema import Settings, SurfaceSettings
from ..surface.height import height_line
from .bake_target import BakeTarget
from .blend_file import write_blend
from .fitted_textures import texture_line, texture_state
from .kept_bake import baked_bits, baked_size, drop_kept_bake, is_made_from_bake, keep_bake, mesh_at_size
from .mesh_files import save_asset_glb, save_tiles

if TYPE_CHECKING:
    from ..scene.reconstruction import Reconstruction

PARTIAL = "bake.part"  # folder in the run folder that is completed before any file of the run is replaced


def bake(
    run: Path,
    progress: Progress,
    *,
    size: int | None = None,
    triangles: int | None = None,
    edited: Path | None = None,
    height: bool = False,
    quads: int | None = None,
    bits: int | None = None,
    udim: int | None = None,
) -> None:
    """Replace mesh.ply, textures, asset.glb and scene.blend of a finished run.

    Without `triangles`, `edited` and `quads` the mesh stays as it is, but for its UVs where other tiles are asked for. Without `height` and
    other tiles, a size below that of the run's bake is then made from this bake, which the run keeps, and the size of the bake itself is
    restored from there; any other size is baked. If the work fails or is stopped, the run stays as it was.

    Args:
        run: folder of the finished run.
        progress: reporter; asked whether to stop.
        size: texels along a side, of a tile where there are several; None: bake at the size of the last bake.
        triangles: extract a new mesh from the Gaussians with at most so many.
        edited: PLY in the run's world frame that replaces the mesh, with its own UVs where it has any.
        quads: remesh the run's mesh to about so many quads, by Blender's QuadriFlow.
        bits: of each value of the textures, 8 or 16; None: those of the last bake.
        height: also bake a texture of the height of the surface as it is fused above the mesh, where the mesh is reduced.
        udim: UDIM tiles along a side, 1 for none; None: those of the last bake, or of the edited mesh's own UVs.

    Raises:
        InputError: when an argument is bad, the run is unfinished or in use, or the textures do not fit into memory or on the disk.
        Cancelled: when the user stops the work.
        NoBlender: when quads are asked for and no Blender is found.
        IrgsppError: when Blender fails.
    """
    state = read_run(run)
    settings = overrides.from_dict(state["settings"], run / "run.json")
    target = BakeTarget(triangles, edited, quads, height)
    target.check()
    if state.get("status") == "running" or not (run / "mesh.ply").is_file():
        raise InputError(run, "is not a finished run", "finish the reconstruction first")
    bits = bits or baked_bits(run) or settings.surface.texture_bits
    surface = dataclasses.replace(settings.surface, texture=size or baked_size(run) or settings.surface.tile_texels, texture_bits=bits)
    surface = dataclasses.replace(surface, udim_tiles=_tiles(run, edited, udim))
    surface = surface if triangles is None else dataclasses.replace(surface, triangles=triangles)
    settings = overrides.check(dataclasses.replace(settings, surface=surface))
    kept = size is not None and target == BakeTarget() and is_made_from_bake(run, size, bits) and surface.udim_tiles == udim_tiles(run)
    if not kept:
        _check_fits(run, surface)
    folder = RunFolder(run, state, _lock(run))
    try:
        if kept:
            _resize(folder, surface.tile_texels, progress)
        else:
            _bake(folder, settings, target, progress)
        _renew_blend(run, settings.export.material, progress)
    finally:
        shutil.rmtree(run / PARTIAL, ignore_errors=True)
        folder.close()


def _tiles(run: Path, edited: Path | None, udim: int | None) -> int:
    """Return the UDIM tiles along a side: of an edited mesh's own UVs, else as asked for, else those of the last bake."""
    given = load_edited_mesh(edited) if edited is not None else None
    if given is None or given.uvs is None:
        return udim or udim_tiles(run)
    if udim not in (None, given.tiles):
        what = f"{udim} asks for other tiles than the UVs of {edited} have, which lie in {given.tiles} x {given.tiles}"
        raise InputError("--udim", what, "leave it out, or export the mesh without UVs")
    return given.tiles


def _bake(folder: RunFolder, settings: Settings, target: BakeTarget, progress: Progress) -> None:
    """Bake, and replace the run's mesh and textures."""
    with quick_imports():
        from .rebaked_mesh import rebaked_mesh  # torch takes a second or two, which other sizes and bad arguments need not wait for

    run, surface = folder.path, settings.surface
    size, tiles = surface.tile_texels, surface.udim_tiles
    made, edited = rebaked_mesh(run, surface, target, progress), target.edited
    mesh, report = _detailed(made.mesh, made.reconstruction, run, settings, str(folder.state["dataset"]), progress)
    _replace(run, mesh, tiles)
    drop_kept_bake(run)
    folder.state["baked"] = {"texture": size, "bits": surface.texture_bits, "triangles": len(mesh.faces)}
    folder.state["baked"] |= {"mesh": str(edited) if edited else None, "quads": target.quads}
    folder.state["albedo_detail"] = report.state()
    folder.state["textures"] = texture_state(mesh, size, "as set for the last bake", tiles)
    folder.state["height"] = None if made.heights is None else made.heights.state()
    folder.write()
    if target.height:
        progress.message(height_line(folder.state["height"]))
        folder.log(height_line(folder.state["height"]))
    progress.message(texture_line(folder.state["textures"]))
    sizes = f"{size} texels" if tiles == 1 else f"{tiles} x {tiles} UDIM tiles of {size} texels"
    folder.log(f"baked again: {sizes}, {len(mesh.faces):,} triangles" + (f" of {edited}" if edited else ""))


def _resize(folder: RunFolder, size: int, progress: Progress) -> None:
    """Replace the textures by others of a size that are made from the run's bake, or by the bake itself."""
    run, baked, tiles = folder.path, baked_size(folder.path), udim_tiles(folder.path)
    assert baked is not None
    progress.phase("resize", 1)
    mesh = mesh_at_size(run, size)
    if progress.cancelled:
        raise Cancelled("stopped while textures were resized")
    if size < baked:
        keep_bake(run, run / PARTIAL)
    _replace(run, mesh, tiles)
    if size == baked:
        drop_kept_bake(run)
    why = "as baked" if size == baked else f"made from the bake of {baked} texels, which textures/baked keeps"
    folder.state["textures"] = texture_state(mesh, baked, why, tiles)
    folder.write()
    progress.step(1)
    progress.message(texture_line(folder.state["textures"]))
    folder.log(texture_line(folder.state["textures"]))


def _check_fits(run: Path, settings: SurfaceSettings) -> None:
    """Refuse textures that do not fit into memory or on the disk of the run, before any work."""
    cameras = [placed.camera for placed in load_run_cameras(run / "cameras.json") if placed.split == "train"]
    check_texture_memory(settings.texels, sum(camera.width * camera.height for camera in cameras))
    check_texture_disk_space(run, settings)


def _lock(run: Path) -> FileLock:
    try:
        return FileLock(run / ".lock")
    except BlockingIOError as error:
        raise InputError(run, "is in use by another process", "wait until that one has ended") from error
    except OSError as error:
        raise InputError(run, f"is not writable ({error.strerror})", "check the folder's permissions") from error


def _detailed(
    mesh: Mesh, reconstruction: Reconstruction, run: Path, settings: Settings, dataset: str, progress: Progress
) -> tuple[Mesh, DetailReport]:
    """Add the detail of the run's photographs to the albedo, where they are still on the disk."""
    views = {placed.name: placed for placed in load_run_cameras(run / "cameras.json") if placed.split == "train"}
    try:
        posed = posed_dataset(Path(dataset), run)
    except InputError as error:
        progress.message(f"warning: {error}; the texture takes no detail from its photographs")
        return mesh, DetailReport(False, "the photographs are gone")
    with quick_imports():
        from ..detail.albedo_detail import detailed_by_dataset

    return detailed_by_dataset(mesh, reconstruction, posed, views, settings, progress)


def _replace(run: Path, mesh: Mesh, tiles: int) -> None:
    """Write all files into the folder PARTIAL, then replace the old ones by them."""
    partial = run / PARTIAL
    try:
        partial.mkdir(exist_ok=True)
        save_mesh_ply(mesh, partial / "mesh.ply")
        save_textures(mesh.textures, partial)
        save_asset_glb(mesh, partial / "asset.glb")
        save_tiles(mesh.textures, partial, tiles)
        (run / "textures").mkdir(exist_ok=True)
        for name in CHANNELS:
            if name in mesh.textures:
                os.replace(partial / f"{name}.png", run / "textures" / f"{name}.png")
            else:  # of an earlier bake, for another mesh
                (run / "textures" / f"{name}.png").unlink(missing_ok=True)
        shutil.rmtree(run / "textures" / FOLDER, ignore_errors=True)
        if tiles > 1:
            os.replace(partial / FOLDER, run / "textures" / FOLDER)
        for name in ("mesh.ply", "asset.glb"):
            os.replace(partial / name, run / name)
    except OSError as error:
        raise IrgsppError(f"{run}: can't be written ({error.strerror or error})") from error


def _renew_blend(run: Path, material: str, progress: Progress) -> None:
    """Write scene.blend again where the run has one; remove it where that fails."""
    if not (run / "scene.blend").is_file():
        return
    progress.phase("scene", 0)
    try:
        write_blend(run, run / "scene.blend", material, progress)
    except IrgsppError as error:
        (run / "scene.blend").unlink()
        progress.message(f"warning: scene.blend held the old mesh and was removed; it can't be written again: {error}")
