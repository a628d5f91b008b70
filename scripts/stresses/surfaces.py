# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that are hard to mesh, unwrap or bake: empty fields, thin sheets, many parts, non-manifold, tiny and huge meshes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from irgspp.core.errors import IrgsppError
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gbuffer import GBuffer, SurfaceSamples
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.surface import Surface
from irgspp.core.scene.triangle_tracer import TriangleTracer
from irgspp.core.settings.schema import SurfaceSettings
from irgspp.core.surface.extraction import extract_geometry
from irgspp.core.surface.mesh_texels import mesh_texels
from irgspp.core.surface.meshing import Triangles, cleaned, decimated, main_components, smoothed, vertex_normals
from irgspp.core.surface.texturing import textured_mesh
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from .case import Measured, group
from .shapes import ball, box, joined, mobius, round_box
from .training import cameras

case = group("surfaces")
BOUND = Bound((0.0, 0.0, 0.0), 1.6)
SETTINGS = replace(SurfaceSettings(), voxels=48, triangles=3000, texture=128)
VOXEL = 0.04
BAKED = "UVs lie in the square and hardly overlap, all is finite, normals are unit, and texels that views see have the surface's colour."


def colour_of(points: np.ndarray) -> np.ndarray:
    """Return a smooth colour for each point.

    Args:
        points: (..., 3).

    Returns:
        (..., 3) in 0..1.
    """
    return 0.5 + 0.4 * np.sin(points * np.array([2.0, 3.0, 2.5]) + np.array([0.0, 1.0, 2.0]))


def gbuffers_of(mesh: Triangles, views: list[Camera]) -> list[GBuffer]:
    """Render the G-buffers of a mesh: exact depth and flat normals, two-sided, coloured by position.

    Args:
        mesh: mesh to render.
        views: cameras.
    """
    corners = mesh.vertices[mesh.faces]
    tracer = TriangleTracer(corners)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-30)
    buffers = []
    for camera in views:
        rays, found = camera.rays().reshape(-1, 3), tracer.seen_by(camera)
        hit, far = found.triangle >= 0, np.where(found.triangle >= 0, found.distance, 0).astype(np.float64)
        normal = across[np.maximum(found.triangle, 0)] * hit[:, None]
        normal = np.where((normal * rays).sum(-1, keepdims=True) > 0, -normal, normal)
        colour = colour_of(camera.centre + far[:, None] * rays) * hit[:, None]
        layers = (hit, far, normal, colour, colour, colour[:, 1], colour[:, 2])
        shape = (camera.height, camera.width)
        buffers.append(GBuffer(camera, *(x.reshape(*shape, *x.shape[1:]).astype(np.float32) for x in layers)))
    return buffers


def samples(mesh: Triangles) -> SurfaceSamples:
    """Return samples all over a mesh, as its Gaussians would be."""
    points, normal = Surface(mesh.vertices, vertex_normals(mesh), mesh.faces, VOXEL).samples(3000, np.random.default_rng(0))
    colour = colour_of(points).astype(np.float32)
    return SurfaceSamples(points, normal, np.full(len(points), 0.9, np.float32), colour, colour[:, 1], colour[:, 2])


def check_reconstruction(measured: Measured, what: str, mesh: Triangles, settings: SurfaceSettings = SETTINGS) -> Surface:
    """Extract a surface from 12 G-buffers of a mesh, and check it, its UVs and its textures.

    Args:
        measured: result of the case.
        what: name of the mesh.
        mesh: true surface.
        settings: settings of the extraction.
    """
    views = gbuffers_of(mesh, cameras(12, 96, 4.5))
    surface = extract_geometry(views, samples(mesh), BOUND, settings, Silent())
    measured.holds(f"{what}: vertices finite", bool(np.isfinite(surface.vertices).all() and np.isfinite(surface.normals).all()))
    measured.at_most(f"{what}: triangles", len(surface.faces), settings.triangles)
    check_baking(measured, what, surface, views, samples(mesh), settings)
    return surface


def check_baking(
    measured: Measured, what: str, surface: Surface, views: list[GBuffer], own: SurfaceSamples, settings: SurfaceSettings = SETTINGS
) -> Mesh:
    """Unwrap and bake a surface, and compare the texels with the colour of their positions.

    Args:
        measured: result of the case.
        what: name of the surface.
        surface: surface to bake.
        views: G-buffers with its colour.
        own: samples of its Gaussians.
        settings: settings of the textures.
    """
    mesh = textured_mesh(surface, views, own, settings, Silent())
    arrays = [mesh.vertices, mesh.normals, mesh.uvs, mesh.albedo, mesh.roughness, mesh.metallic]
    measured.finite(f"{what}: mesh", [torch.from_numpy(np.ascontiguousarray(array)) for array in arrays])
    measured.holds(f"{what}: all faces kept", len(mesh.faces) == len(surface.faces))
    measured.holds(f"{what}: UVs in the square", bool((mesh.uvs >= 0).all() and (mesh.uvs <= 1).all()))
    measured.at_most(f"{what}: normals' length off by", float(np.abs(np.linalg.norm(mesh.normals, axis=-1) - 1).max()), 1e-5)
    texels = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, settings.texels)
    measured.holds(f"{what}: texels", len(texels.face) > 0)
    a, b, c = (mesh.uvs[mesh.faces[:, k]].astype(np.float64) * settings.texels for k in range(3))
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2
    measured.at_least("texels per area", len(texels.face) / max(area, 1.0), 0.9)
    places = texels.interpolate(mesh.vertices, mesh.faces)
    shown = decode_srgb(mesh.textures["albedo"].reshape(-1, 3)[texels.index] / 255.0)
    error = np.abs(shown - colour_of(places)).max(-1)
    measured.at_most("colour off by, 95 %", float(np.quantile(error, 0.95)), 0.05)
    return mesh


@case(
    "an empty field",
    """Views that see nothing, depths of NaN, infinity and 0, samples of opacity 0, none, or all outside the bound, and depths that
    agree on a speck alone: one clear line, no surface.""",
)
def empty(measured: Measured) -> None:
    """Check fields without a surface."""
    full = gbuffers_of(ball(16), cameras(12, 48))
    nobody = SurfaceSamples(*(np.zeros(shape, np.float32) for shape in ((0, 3), (0, 3), (0,), (0, 3), (0,), (0,))))
    clear = [replace(view, alpha=0 * view.alpha) for view in full]
    fields = {"nothing": (clear, nobody), "transparent Gaussians": (clear, replace(samples(ball(16)), opacity=np.zeros(3000, np.float32)))}
    for name, value in (("depth NaN", np.nan), ("depth infinite", np.inf), ("depth 0", 0.0), ("outside", 50.0)):
        fields[name] = ([replace(view, depth=np.full_like(view.depth, value)) for view in full], nobody)
    fields["a speck"] = (gbuffers_of(ball(8, 1e-9), cameras(12, 48)), nobody)
    for name, (views, own) in fields.items():
        try:
            surface = extract_geometry(views, own, BOUND, SETTINGS, Silent())
        except IrgsppError as error:
            measured.holds(f"{name}: one line", "\n" not in str(error) and "surface" in str(error))
            continue
        measured.holds(f"{name}: {len(surface.faces)} triangles without a surface", False)


@case(
    "a thin sheet",
    """A plate 2 wide and 0.004 thick, a tenth of a voxel, is reconstructed closed: its sides lie within 1 voxel of it, its rim, which no
    view sees frontally, within 3. """
    + BAKED,
)
def thin(measured: Measured) -> None:
    """Check a thin sheet."""
    surface = check_reconstruction(measured, "plate", box((1.0, 0.8, 0.002)))
    beyond = np.abs(surface.vertices) - np.array([1.0, 0.8, 0.002])
    voxels, sides = np.maximum(beyond, 0).max(1) / surface.voxel, (beyond[:, :2] < -0.15).all(1)
    measured.at_most("voxels from its sides", float(voxels[sides].max()), 1.0)
    measured.at_most("from its rim", float(voxels.max()), 3.0)
    measured.at_most("open edges", _open_edges(surface.faces), 0)
    measured.at_least("its width", float(np.ptp(surface.vertices[:, 0])), 1.9)


@case(
    "several components",
    "Balls of 0.6 and 0.4 and one of 0.03 far from them, a fragment: two closed components are reconstructed in place. " + BAKED,
)
def components(measured: Measured) -> None:
    """Check several components."""
    parts = ball(24, 0.6, (-0.7, 0, 0)), ball(24, 0.4, (0.7, 0.2, 0.3)), ball(8, 0.03, (0.2, 1.0, -0.8))
    surface = check_reconstruction(measured, "balls", joined(*parts))
    mesh = Triangles(surface.vertices, surface.faces)
    count, _ = connected_components(_adjacency(mesh), directed=False)
    measured.holds(f"two components, not {count}", count == 2)
    apart = [np.abs(np.linalg.norm(mesh.vertices - c, axis=-1) - r) for c, r in (((-0.7, 0, 0), 0.6), ((0.7, 0.2, 0.3), 0.4))]
    measured.at_most("voxels from the balls", float(np.minimum(*apart).max() / surface.voxel), 1.5)
    measured.at_most("open edges", _open_edges(surface.faces), 0)


def _adjacency(mesh: Triangles):
    """Return the adjacency matrix of the vertices."""
    i, j = mesh.faces[:, [0, 1, 2]].ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    return sparse.csr_matrix((np.ones(len(i)), (i, j)), shape=(len(mesh.vertices),) * 2)


def _open_edges(faces: np.ndarray) -> int:
    """Return the number of edges of a single face."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    return int((count == 1).sum())


def check_as_is(measured: Measured, what: str, mesh: Triangles, settings: SurfaceSettings = SETTINGS, size: int = 96) -> None:
    """Unwrap and bake a mesh without extraction.

    Args:
        measured: result of the case.
        what: name of the mesh.
        mesh: mesh to bake.
        settings: settings of the textures.
        size: pixels along a side of the G-buffers.
    """
    surface = Surface(mesh.vertices, vertex_normals(mesh), mesh.faces, VOXEL)
    measured.finite(f"{what}: normals", torch.from_numpy(surface.normals))
    check_baking(measured, what, surface, gbuffers_of(mesh, cameras(12, size, 4.5)), samples(mesh), settings)


@case(
    "non-manifold",
    """Three sheets on one edge, two cones on one vertex, a one-sided strip, faces repeated, turned over, without area or on one line, lone
    vertices: unwrapped and baked as they are; cleaned, smoothed and decimated they stay finite. """
    + BAKED,
)
def non_manifold(measured: Measured) -> None:
    """Check meshes that are not manifold."""
    book = Triangles(
        np.array([[0, 0, -1], [0, 0, 1], [1, 0, 0], [-0.5, 0.9, 0], [-0.5, -0.9, 0.0]]), np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    )
    cones = np.array([[0, 0, 0], [1, 0, 1], [-0.5, 0.9, 1], [-0.5, -0.9, 1], [1, 0, -1], [-0.5, 0.9, -1], [-0.5, -0.9, -1.0]])
    hourglass = Triangles(cones, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [0, 5, 4], [0, 6, 5], [0, 4, 6]]))
    whole = ball(12)
    spoilt = np.concatenate([whole.faces, whole.faces[:5], whole.faces[5:9, ::-1], [[0, 0, 1], [3, 3, 3], [0, 1, len(whole.vertices)]]])
    lone = np.concatenate([whole.vertices, [(whole.vertices[0] + whole.vertices[1]) / 2, [9.0, 9.0, 9.0]]])
    for name, mesh in (("book", book), ("hourglass", hourglass), ("strip", mobius()), ("spoilt ball", Triangles(lone, spoilt))):
        check_as_is(measured, name, mesh)
        mended = decimated(smoothed(main_components(cleaned(mesh), 0.0), 5), max(4, len(mesh.faces) // 2))
        measured.finite(f"{name} cleaned, smoothed, decimated", torch.from_numpy(mended.vertices))
        measured.holds(f"{name}: faces are left", len(mended.faces) > 0)


@case("10 triangles", "A bipyramid of 10 triangles, one of 1e-6 its size, and one 1000 times as long as wide. " + BAKED)
def ten(measured: Measured) -> None:
    """Check tiny meshes."""
    angle = np.arange(5) / 5 * 2 * np.pi
    vertices = np.concatenate([np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1), [[0, 0, 1.0], [0, 0, -1.0]]])
    a, b = np.arange(5), np.roll(np.arange(5), -1)
    faces = np.concatenate([np.stack([a, b, a * 0 + 5], -1), np.stack([b, a, a * 0 + 6], -1)])
    check_as_is(measured, "10", Triangles(vertices, faces))
    check_as_is(measured, "long", Triangles(vertices * np.array([1.0, 1e-3, 1e-3]), faces))
    small = Triangles(1e-6 * vertices, faces)
    near = [replace(view, to_world=_closer(view.to_world, 1e-6)) for view in cameras(12, 96, 4.5)]
    surface = Surface(small.vertices, vertex_normals(small), small.faces, 1e-6 * VOXEL)
    check_baking(measured, "1e-6", surface, gbuffers_of(small, near), samples(small))


def _closer(pose: np.ndarray, factor: float) -> np.ndarray:
    """Return a pose nearer to the origin."""
    moved = pose.copy()
    moved[:3, 3] *= factor
    return moved


@case(
    "2 million triangles",
    """A ball of 2 million, smoothed, decimated to 20,000 as every surface is, within 0.002 of the sphere, closed; that unwrapped and baked.
    (Unwrapping all 2 million is not tested: xatlas takes minutes from 100,000 on.) """
    + BAKED,
    quick=False,
)
def huge(measured: Measured) -> None:
    """Check a huge mesh."""
    mesh = round_box(409)
    measured.at_least("triangles", len(mesh.faces), 2_000_000)
    few = cleaned(decimated(smoothed(mesh, 2), 20_000))
    measured.at_most("decimated: triangles", len(few.faces), 20_500)
    measured.at_most("from the sphere", float(np.abs(np.linalg.norm(few.vertices, axis=-1) - 1).max()), 2e-3)
    measured.at_most("open edges", _open_edges(few.faces), 0)
    check_as_is(measured, "2 million", few, replace(SETTINGS, texture=512), 256)
