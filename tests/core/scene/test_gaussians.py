# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians: geometry, copies, and their PLY file."""

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.scene.gaussians import Gaussians, load_gaussians, load_surfels, quaternion_to, save_gaussians
from plyfile import PlyData, PlyElement


@pytest.fixture
def gaussians():
    g = torch.Generator().manual_seed(0)
    shapes = {"position": (3,), "quaternion": (4,), "log_scale": (2,), "opacity": (), "sh": (16, 3), "material": (5,)}
    return Gaussians(**{name: torch.randn(*shape, 50, generator=g) for name, shape in shapes.items()})


def rotation_columns(quaternion):
    """Independent of the package: v -> q v q*, for the three axes; (3 axes, 3, N)."""
    w, r = quaternion[0], quaternion[1:]
    axes = []
    for axis in torch.eye(3, dtype=quaternion.dtype):
        v = axis[:, None].expand_as(r)
        t = 2 * torch.linalg.cross(r, v, dim=0)
        axes.append(v + w * t + torch.linalg.cross(r, t, dim=0))
    return torch.stack(axes)


def test_normal_is_the_third_axis(gaussians):
    unit = torch.nn.functional.normalize(gaussians.quaternion, dim=0)
    assert torch.allclose(gaussians.normals(), rotation_columns(unit)[2], atol=1e-5)


def test_quaternion_turns_up_to_the_normal():
    n = torch.randn(3, 100, generator=torch.Generator().manual_seed(1))
    n[:, 0], n[:, 1] = torch.tensor([0.0, 0.0, -1.0]), torch.tensor([0.0, 0.0, 1.0])
    n[:, 2] = torch.tensor([1e-4, 0.0, -1.0])
    n = torch.nn.functional.normalize(n, dim=0)
    q = quaternion_to(n)
    assert torch.allclose(q.norm(dim=0), torch.ones(100), atol=1e-6)
    assert torch.allclose(rotation_columns(q)[2], n, atol=1e-3)


def test_select_and_join_are_copies(gaussians):
    some = gaussians.select(torch.tensor([3, 1]))
    assert torch.equal(some.sh, gaussians.sh[..., [3, 1]]) and torch.equal(some.opacity, gaussians.opacity[[3, 1]])
    both = gaussians.joined(some)
    assert both.count == 52 and torch.equal(both.material[:, 50:], gaussians.material[:, [3, 1]])
    before = gaussians.position.clone()
    some.position += 1
    both.position += 1
    assert torch.equal(gaussians.position, before)


def test_samples_are_the_surfels(gaussians):
    s = gaussians.samples()
    assert np.array_equal(s.position, gaussians.position.T.numpy())
    assert np.allclose(np.linalg.norm(s.normal, axis=1), 1, atol=1e-5)
    assert np.allclose(s.opacity, 1 / (1 + np.exp(-gaussians.opacity.numpy())), atol=1e-6)
    assert np.allclose(s.roughness, 1 / (1 + np.exp(-gaussians.material[3].numpy())), atol=1e-6)
    assert s.albedo.shape == (50, 3) and s.metallic.shape == (50,) and s.albedo.dtype == np.float32


def test_ply_keeps_every_value(gaussians, tmp_path):
    gaussians.material[:2, 0] = torch.tensor([40.0, -40.0])  # beyond what a logit can come back from
    save_gaussians(gaussians, tmp_path / "a.ply")
    loaded = load_gaussians(tmp_path / "a.ply")
    for name in ("position", "log_scale", "opacity", "sh"):
        assert torch.equal(getattr(loaded, name), getattr(gaussians, name)), name
    assert torch.allclose(loaded.normals(), gaussians.normals(), atol=1e-6)
    assert torch.allclose(loaded.materials(), gaussians.materials(), atol=2e-6)
    assert torch.isfinite(loaded.material).all()
    save_gaussians(loaded, tmp_path / "b.ply")
    again = load_gaussians(tmp_path / "b.ply")
    for name, value in loaded.tensors().items():
        if name != "material":
            assert torch.allclose(getattr(again, name), value, rtol=1e-6, atol=1e-6), name
    assert torch.allclose(again.materials(), loaded.materials(), atol=2e-7)
    assert (tmp_path / "a.ply").stat().st_size == (tmp_path / "b.ply").stat().st_size
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.ply", "b.ply"]


def test_ply_keeps_the_confidence_where_it_is_known(gaussians, tmp_path):
    known = torch.rand(3, gaussians.count, generator=torch.Generator().manual_seed(0))
    save_gaussians(gaussians, tmp_path / "a.ply", known)
    loaded, confidence = load_surfels(tmp_path / "a.ply")
    assert torch.equal(confidence, known) and torch.equal(loaded.position, gaussians.position)
    save_gaussians(gaussians, tmp_path / "a.ply")
    assert load_surfels(tmp_path / "a.ply")[1] is None


def test_ply_has_the_columns_of_3dgs(gaussians, tmp_path):
    save_gaussians(gaussians, tmp_path / "a.ply")
    vertex = PlyData.read(str(tmp_path / "a.ply"))["vertex"]
    assert np.array_equal(vertex["f_dc_1"], gaussians.sh[0, 1].numpy())
    assert np.array_equal(vertex["f_rest_0"], gaussians.sh[1, 0].numpy())  # channel by channel
    assert np.array_equal(vertex["f_rest_15"], gaussians.sh[1, 1].numpy())
    assert np.array_equal(vertex["f_rest_44"], gaussians.sh[15, 2].numpy())
    assert np.array_equal(vertex["scale_1"], gaussians.log_scale[1].numpy())
    assert np.allclose(vertex["roughness"], gaussians.materials()[3].numpy())
    assert np.allclose(np.stack([vertex[n] for n in ("nx", "ny", "nz")]), gaussians.normals().numpy(), atol=1e-6)


def broken(kind, path):
    good = path.read_bytes()
    if kind == "missing":
        path.unlink()
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "truncated":
        path.write_bytes(good[: len(good) // 2])
    elif kind == "text":
        path.write_text("this is no point cloud\n")
    elif kind == "column":
        path.write_bytes(good.replace(b"property float metallic\n", b"property float metallik\n"))
    elif kind == "element":
        PlyData([PlyElement.describe(np.zeros(3, [("x", "f4")]), "face")]).write(str(path))
    elif kind == "nan":
        vertex = PlyData.read(str(path), mmap=False)
        vertex["vertex"]["z"][7] = np.nan
        vertex.write(str(path))


@pytest.mark.parametrize("kind", ["missing", "empty", "truncated", "text", "column", "element", "nan"])
def test_broken_ply_is_an_input_error_in_one_line(gaussians, tmp_path, kind):
    path = tmp_path / "a.ply"
    save_gaussians(gaussians, path)
    broken(kind, path)
    with pytest.raises(InputError) as caught:
        load_gaussians(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
