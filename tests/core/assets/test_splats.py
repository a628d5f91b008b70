# SPDX-License-Identifier: GPL-3.0-or-later
"""Splats: the picture that a viewer of 3DGS files shows is the one that our renderer shows, with its own columns and axes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.assets.export import export
from irgspp.core.assets.options import AssetOptions
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.progress.protocol import Silent
from irgspp.core.rendering.deferred import radiance
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.spherical_harmonics import sh_basis
from plyfile import PlyData
from relight_run import write_relightable
from scipy.spatial.transform import Rotation
from splat_reader import C0, read_splats

COLUMNS = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(45)), "opacity"]
COLUMNS += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]  # of 3DGS, in its order
UP_IN_FILE = np.array([0, -1, 0])


@pytest.fixture(params=[False, True], ids=["radiance", "reflections"])
def run(request, tmp_path) -> Path:
    """Run of a sphere whose radiance changes with the direction, without and with reflections beside the SH."""
    folder = tmp_path / "run"
    write_relightable(folder, 4000)
    own = Reconstruction.load(folder)
    own.gaussians.sh[1:4] = 0.1 * torch.randn(3, 3, own.gaussians.count, generator=torch.Generator().manual_seed(1))
    replace(own, has_split_sum=request.param).save(folder)
    return folder


def read(path: Path) -> dict[str, torch.Tensor]:
    vertex = PlyData.read(str(path))["vertex"]
    assert [p.name for p in vertex.properties] == COLUMNS
    return {name: torch.from_numpy(np.array(vertex[name], np.float32)) for name in COLUMNS}


def rows(splats: dict[str, torch.Tensor], *names: str) -> torch.Tensor:
    return torch.stack([splats[name] for name in names])


def coefficients(splats: dict[str, torch.Tensor]) -> torch.Tensor:
    rest = rows(splats, *(f"f_rest_{i}" for i in range(45))).reshape(3, 15, -1).permute(1, 0, 2)
    return torch.cat([rows(splats, "f_dc_0", "f_dc_1", "f_dc_2")[None], rest]).contiguous()


def seen(reconstruction: Reconstruction, camera: Camera) -> torch.Tensor:
    """Our picture (3, H, W), sRGB-encoded over black."""
    g, mirrored = reconstruction.gaussians, reconstruction.mirrored()
    sums, _ = rasterize(g.position, g.quaternion, g.log_scale, g.opacity, g.sh, g.materials(), camera, reconstruction.bound.radius)
    rays = torch.from_numpy(camera.rays()).permute(2, 0, 1).contiguous()
    return encode_srgb(radiance(sums, rays, None if mirrored is None else mirrored.environment)) * sums[-1]


def seen_by_viewer(splats: dict[str, torch.Tensor], camera: Camera) -> torch.Tensor:
    """Picture of a viewer of 3DGS that reads the file's flat splats, with the camera in the file's axes."""
    to_file = np.eye(4)
    to_file[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    turned = replace(camera, to_world=to_file @ camera.to_world)
    names = ("x", "y", "z"), ("rot_0", "rot_1", "rot_2", "rot_3"), ("scale_0", "scale_1")
    position, quaternion, scale = (rows(splats, *one) for one in names)
    none = position.new_zeros(0, position.shape[1])
    return rasterize(position, quaternion, scale, splats["opacity"], coefficients(splats), none, turned, 1.3)[0][:3]


def test_a_viewer_shows_our_picture(run, tmp_path, camera_ring):
    export(run, tmp_path / "o.ply")
    splats, reconstruction = read(tmp_path / "o.ply"), Reconstruction.load(run)
    error = [(seen(reconstruction, camera) - seen_by_viewer(splats, camera)).square().mean().item() for camera in camera_ring(6)]
    assert -10 * np.log10(np.mean(error)) > 34  # SH of degree 3 hold no sharper reflections


def test_an_independent_reader_finds_our_surfels(run, tmp_path):
    """Places, sizes, rotations, opacities and colours, by numbers, of surfels whose radiance is the same in all directions."""
    reconstruction = Reconstruction.load(run)
    g = reconstruction.gaussians
    g.sh[:] = 0
    g.sh[0] = torch.empty(3, g.count).uniform_(-1.5, 1.5, generator=torch.Generator().manual_seed(2))
    g.log_scale[:] += 0.5 * torch.randn(2, g.count, generator=torch.Generator().manual_seed(3))
    g.quaternion[:] = torch.randn(4, g.count, generator=torch.Generator().manual_seed(4))
    g.opacity[:] = 2 * torch.randn(g.count, generator=torch.Generator().manual_seed(5))
    replace(reconstruction, has_split_sum=False).save(run)
    export(run, tmp_path / "o.ply")
    splats, w_last = read_splats(tmp_path / "o.ply"), g.quaternion.T.double().numpy()[:, [1, 2, 3, 0]]
    np.testing.assert_allclose(splats.place, g.position.T.numpy(), atol=1e-6)
    np.testing.assert_allclose(splats.opacity, 1 / (1 + np.exp(-g.opacity.double().numpy())), atol=1e-6)
    sizes = np.exp(np.c_[g.log_scale.T.double().numpy(), np.full(g.count, -np.inf)])  # ours have no thickness
    axes = Rotation.from_quat(w_last).as_matrix() * sizes[:, None]
    largest = (sizes**2).max()
    np.testing.assert_allclose(splats.covariance / largest, axes @ axes.transpose(0, 2, 1) / largest, atol=2e-4)
    linear = 0.5 + C0 * g.sh[0].T.double().numpy()
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.abs(linear) ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(splats.colour, encoded, atol=1e-4)
    assert np.abs(splats.rest).max() < 1e-3


def test_turned_and_scaled(run, tmp_path, camera_ring):
    """A viewer whose camera is turned and moved with the object sees the same picture."""
    turn = Rotation.from_euler("xyz", (0.4, -0.7, 1.1)).as_matrix()
    export(run, tmp_path / "o.ply")
    export(run, tmp_path / "turned.ply", options=AssetOptions(transform=tuple((2.5 * turn).reshape(-1))))
    before, after = read(tmp_path / "o.ply"), read(tmp_path / "turned.ply")
    for camera in camera_ring(2):
        pose = camera.to_world.copy()
        pose[:3, :3], pose[:3, 3] = turn @ pose[:3, :3], 2.5 * turn @ pose[:3, 3]
        error = (seen_by_viewer(before, camera) - seen_by_viewer(after, replace(camera, to_world=pose))).square().mean().item()
        assert -10 * np.log10(error) > 45
    with pytest.raises(InputError, match="stretches"):
        export(run, tmp_path / "o.ply", options=AssetOptions(transform=(1, 0, 0, 0, 1, 0, 0, 0, 2)))


def test_z_up_becomes_minus_y_up(run, tmp_path):
    export(run, tmp_path / "o.ply")
    position = rows(read(tmp_path / "o.ply"), "x", "y", "z").T.numpy()
    own = Reconstruction.load(run).gaussians.position.T.numpy()
    np.testing.assert_allclose(position @ UP_IN_FILE, own[:, 2], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), np.linalg.norm(own, axis=1), atol=1e-5)


def test_splats_are_flat_along_their_normal(run, tmp_path):
    export(run, tmp_path / "o.ply")
    splats = read(tmp_path / "o.ply")
    scale, normal = rows(splats, "scale_0", "scale_1", "scale_2"), rows(splats, "nx", "ny", "nz")
    assert (scale[2] <= scale[:2].min(0).values + np.log(0.011)).all()
    w, x, y, z = rows(splats, "rot_0", "rot_1", "rot_2", "rot_3")
    third = torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])  # third axis of the rotation
    torch.testing.assert_close(third, normal, atol=1e-5, rtol=0)


def test_radiance_behind_the_surface_does_not_spoil_the_front(run, tmp_path):
    reconstruction = Reconstruction.load(run)
    g = reconstruction.gaussians
    g.sh[:4] = 0  # 0.5, plus a steep ramp that is negative, thus clamped, behind the surface
    g.sh[1:4] = 2.0 * torch.stack([g.normals()[1], -g.normals()[2], g.normals()[0]])[:, None]
    replace(reconstruction, has_split_sum=False).save(run)
    export(run, tmp_path / "o.ply")
    splats = read(tmp_path / "o.ply")
    normal = rows(splats, "nx", "ny", "nz")
    outward = torch.where((normal * rows(splats, "x", "y", "z")).sum(0) < 0, -normal, normal)
    shown = 0.5 + (sh_basis(-outward, 3)[:, None] * coefficients(splats)).sum(0)
    expected = encode_srgb(torch.tensor(0.5 + 2.0 * 0.4886025))
    assert (shown - expected).abs().max() < 0.05


def test_a_cancelled_export_writes_nothing(run, tmp_path):
    progress = Silent()
    progress.cancelled = True
    with pytest.raises(Cancelled):
        export(run, tmp_path / "o.ply", progress=progress)
    assert not (tmp_path / "o.ply").exists()


def test_an_unfinished_run_is_refused_in_one_line(run, tmp_path):
    (run / "mesh.ply").unlink()
    with pytest.raises(InputError, match=r"mesh\.ply: no such file"):
        export(run, tmp_path / "o.ply")
    assert not (tmp_path / "o.ply").exists()


def test_a_run_without_gaussians_is_an_error(run, tmp_path):
    (run / "gaussians.ply").unlink()
    with pytest.raises(InputError):
        export(run, tmp_path / "o.ply")
    assert not (tmp_path / "o.ply").exists()
