# SPDX-License-Identifier: GPL-3.0-or-later
"""A sphere of known albedo as a finished run, which is baked again."""

import numpy as np
import torch
from irgspp.core.run_folder import RunFolder
from irgspp.core.scene.camera_files import save_views
from irgspp.core.scene.dataset import Bound, View
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.mesh_ply import load_mesh_ply, save_mesh_ply
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.textures import load_textures, save_textures
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.first.initialization import surfels
from irgspp.core.surface.mesh_texels import mesh_texels

SETTINGS = with_overrides(Settings(), ["surface.voxels=40", "surface.triangles=1500", "surface.texture=64"])


def albedo_at(points):
    """Return the albedo (P, 3) at points (P, 3): reddish above, bluish below."""
    share = 1 / (1 + np.exp(-6 * points[:, 2:] / np.linalg.norm(points, axis=-1, keepdims=True)))
    return 0.2 + 0.5 * np.concatenate([share, 0 * share + 0.4, 1 - share], -1)


def ball(count=12_000):
    z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * 2.39996322972865
    normal = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
    gaussians = surfels(normal, normal, np.full((count, 3), 0.5), np.full(count, np.sqrt(4 * np.pi / count)), 0.99)
    values = np.concatenate([albedo_at(normal), np.full((count, 1), 0.6), np.full((count, 1), 0.01)], -1)
    gaussians.material = torch.logit(torch.from_numpy(values.T.copy()).float())
    return Reconstruction(gaussians, torch.full((8, 16, 3), 0.5), Bound((0, 0, 0), 1.3), np.eye(4))


def unwrapped(scale=1.0):
    """Return the sphere as a mesh with a UV map of longitude and latitude, split along the seam."""
    v, u = np.meshgrid(np.linspace(0.02, 0.98, 17), np.linspace(0, 1, 33), indexing="ij")
    theta, phi = (1 - v) * np.pi, u * 2 * np.pi
    normal = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3).astype(np.float32)
    a = (np.arange(16)[:, None] * 33 + np.arange(32)).reshape(-1)
    faces = np.concatenate([np.stack([a, a + 1, a + 34], -1), np.stack([a, a + 34, a + 33], -1)]).astype(np.int32)
    n = len(normal)
    grey, half = np.full((n, 3), 0.5, np.float32), np.full(n, 0.5, np.float32)
    uvs = np.stack([u, v], -1).reshape(-1, 2).astype(np.float32)
    textures = {name: np.zeros((8, 8), np.uint8) for name in ("roughness", "metallic")}
    return Mesh(scale * normal, normal, uvs, faces, grey, half, half, textures)


def write_finished_run(path, cameras):
    """Write the sphere, 13 training views and a test view as a finished run; the cameras are 14."""
    folder = RunFolder.open(path, SETTINGS, "nowhere")
    with folder.job():
        ball().save(folder.path)
        save_mesh_ply(unwrapped(), folder.path / "mesh.ply")
        save_textures(unwrapped().textures, folder.path / "textures")
        views = [View(str(i), camera, folder.path / "none.png", np.empty((0, 0, 3)), None) for i, camera in enumerate(cameras)]
        save_views(folder.path / "cameras.json", [("train", view) for view in views[:-1]] + [("test", views[-1])])
    folder.close()
    return folder.path


def albedo_error(run):
    """Return the mean difference between the albedo texture and the true albedo at each texel, linear."""
    mesh, texture = load_mesh_ply(run / "mesh.ply"), load_textures(run / "textures")["albedo"] / 255.0
    texels = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, len(texture))
    linear = np.where(texture <= 0.04045, texture / 12.92, ((texture + 0.055) / 1.055) ** 2.4).reshape(-1, 3)[texels.index]
    return np.abs(linear - albedo_at(texels.interpolate(mesh.vertices, mesh.faces))).mean()


def tiles_on_disk(run):
    """Return the names of the files that hold the albedo's UDIM tiles."""
    return sorted(path.name for path in (run / "textures" / "udim").glob("albedo.*.png"))
