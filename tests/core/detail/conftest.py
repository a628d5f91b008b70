# SPDX-License-Identifier: GPL-3.0-or-later
"""A sphere with a fine pattern under a smooth light: photographs, working solution and truth."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.detail.photographs import FullSizePhotograph, find_full_size_photographs
from irgspp.core.io.quantisation import srgb_eight_bits
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.camera_files import PlacedCamera
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gaussians import Gaussians
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.schema import DataSettings
from irgspp.core.shading.specular_albedo import diffuse_fraction
from irgspp.core.shading.split_sum import specular_radiance
from irgspp.core.surface.mesh_texels import MeshTexels, mesh_texels
from PIL import Image
from scipy import ndimage

FULL, WORKING, TEXTURE, VIEWS = 240, 80, 512, 10
SETTINGS = DataSettings(resolution=WORKING, exposure="off", holdout=1000)
ROUGHNESS = 0.6


@dataclass(frozen=True, eq=False)
class Scene:
    """Dataset on the disk, working solution, and truth."""

    folder: Path
    mesh: Mesh
    reconstruction: Reconstruction
    truth: np.ndarray  # (TEXTURE, TEXTURE, 3) linear

    def texels(self, size: int) -> MeshTexels:
        """Texels of the mesh in a texture of `size` texels along a side."""
        return mesh_texels(self.mesh.vertices, self.mesh.uvs, self.mesh.faces, size)

    def photographs(self) -> list[FullSizePhotograph]:
        found, missing = find_full_size_photographs(self.folder, SETTINGS, self.views())
        assert not missing
        return found

    def cameras(self) -> dict[str, Camera]:
        return {f"r_{i}": camera(i, WORKING) for i in range(VIEWS)}

    def views(self, light_rotation: np.ndarray | None = None) -> dict[str, PlacedCamera]:
        """Training views, as a run records them."""
        return {name: PlacedCamera(name, "train", one, self.folder, light_rotation) for name, one in self.cameras().items()}


def camera(number: int, size: int) -> Camera:
    z = np.array([0.3, -0.3, 0.7])[number % 3]
    azimuth = 2 * np.pi * number / VIEWS
    away = np.array([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z])
    return Camera(size, size, 1.4 * size, 1.4 * size, size / 2, size / 2, look_at(3 * away))


def sphere(columns: int = 72, rows: int = 36) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices on the unit sphere, UVs, and triangles."""
    u, v = np.meshgrid(np.arange(columns + 1) / columns, np.linspace(0.02, 0.98, rows))
    theta, phi = np.pi * (1 - v), 2 * np.pi * u
    points = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    corner = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return points.astype(np.float32), np.stack([u, v], -1).reshape(-1, 2).astype(np.float32), faces.astype(np.int32)


def pattern(uv: np.ndarray) -> np.ndarray:
    """Linear albedo (..., 3) at UVs (..., 2): stripes, checks and dots with soft edges, over slow colours."""
    u, v = uv[..., 0], uv[..., 1]
    stripes = 1 / (1 + np.exp(-4 * np.sin(2 * np.pi * 30 * (u + 0.6 * v))))
    checks = 1 / (1 + np.exp(-6 * np.sin(2 * np.pi * 24 * u) * np.sin(2 * np.pi * 12 * v)))
    mixed = np.where(np.sin(2 * np.pi * 3 * u) > 0, stripes, checks)[..., None]
    slow = 0.35 + 0.15 * np.stack([np.sin(2 * np.pi * u), np.cos(2 * np.pi * u), np.sin(3 * v)], -1)
    return slow * (0.35 + mixed * [0.95, 0.8, 0.3])  # a coloured ink


def light_map() -> np.ndarray:
    """A bright side and a dim one."""
    v, u = np.meshgrid((np.arange(16) + 0.5) / 16, (np.arange(32) + 0.5) / 32, indexing="ij")
    bright = 0.6 + 0.4 * np.cos(2 * np.pi * u) * np.sin(np.pi * v) + 0.2 * np.cos(np.pi * v)
    return (bright[..., None] * [1.0, 0.95, 0.85]).astype(np.float32)


def photograph(number: int) -> np.ndarray:
    """sRGB photograph with alpha, (FULL, FULL, 4) uint8, of the exact sphere."""
    light, view = prepare_light(light_map()), camera(number, FULL)
    rays = view.rays().astype(np.float64)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    b = rays @ view.centre
    inside = b * b - (view.centre @ view.centre - 1)
    hit = inside > 0
    point = view.centre + (-b - np.sqrt(np.maximum(inside, 0)))[..., None] * rays
    normal, away = (torch.from_numpy(a[hit].astype(np.float32)) for a in (point, -rays))
    u = np.arctan2(point[..., 1], point[..., 0]) / (2 * np.pi) % 1
    albedo = torch.from_numpy(pattern(np.stack([u, 1 - np.arccos(np.clip(point[..., 2], -1, 1)) / np.pi], -1))[hit].astype(np.float32))
    rough, metal = torch.full((len(normal),), ROUGHNESS), torch.zeros(len(normal))
    facing = (normal * away).sum(1)
    diffuse = albedo * diffuse_fraction(facing, rough)[:, None] * light.irradiance(normal) / np.pi
    image = np.zeros((FULL, FULL, 4), np.uint8)
    image[hit, :3] = srgb_eight_bits((diffuse + specular_radiance(away, normal, albedo, rough, metal, light.specular)).numpy())
    image[..., 3] = 255 * hit
    return image


@pytest.fixture(scope="session")
def written(tmp_path_factory) -> Scene:
    """The scene, with its dataset on the disk; tests must not change it."""
    folder = tmp_path_factory.mktemp("pattern")
    (folder / "train").mkdir()
    frames = []
    for i in range(VIEWS):
        Image.fromarray(photograph(i), "RGBA").save(folder / "train" / f"r_{i}.png")
        frames.append({"file_path": f"./train/r_{i}", "transform_matrix": camera(i, FULL).to_world.tolist()})
    angle = 2 * np.arctan(0.5 / 1.4)
    for split, listed in (("train", frames), ("test", frames[:1])):
        (folder / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": angle, "frames": listed}))
    vertices, uvs, faces = sphere()
    row, column = np.mgrid[:TEXTURE, :TEXTURE] + 0.5
    truth = pattern(np.stack([column / TEXTURE, 1 - row / TEXTURE], -1))
    blurred = ndimage.gaussian_filter(truth, (14, 14, 0), mode=("nearest", "wrap", "nearest"))
    rough, metal = (np.full(len(vertices), value, np.float32) for value in (ROUGHNESS, 0.0))
    mesh = Mesh(vertices, vertices, uvs, faces, pattern(uvs).astype(np.float32), rough, metal, {"albedo": srgb_eight_bits(blurred)})
    return Scene(folder, mesh, _reconstruction(), truth)


def _reconstruction() -> Reconstruction:
    """The light, and some Gaussians that nothing looks at."""
    random = torch.Generator().manual_seed(0)
    shapes = {"position": (3,), "quaternion": (4,), "log_scale": (2,), "opacity": (), "sh": (16, 3), "material": (5,)}
    gaussians = Gaussians(**{name: torch.randn(*shape, 20, generator=random) for name, shape in shapes.items()})
    gaussians.material[4] = -5
    return Reconstruction(gaussians, torch.from_numpy(light_map()), Bound((0.0, 0.0, 0.0), 1.0), np.eye(4))
