# SPDX-License-Identifier: GPL-3.0-or-later
"""A reconstruction goes to a folder and comes back."""

import json

import numpy as np
import pytest
import torch
from irgspp.core.datasets.dataset import Bound
from irgspp.core.errors import InputError
from irgspp.core.scene.gaussians import Gaussians
from irgspp.core.scene.reconstruction import Reconstruction


def make(background=False, glossy=True):
    g = torch.Generator().manual_seed(0)
    shapes = {"position": (3,), "quaternion": (4,), "log_scale": (2,), "opacity": (), "sh": (16, 3), "material": (5,)}
    gaussians = Gaussians(**{name: torch.randn(*shape, 20, generator=g) for name, shape in shapes.items()})
    to_world = np.diag([2.0, 2.0, 2.0, 1.0])
    to_world[:3, 3] = 1 / 3, -5, 1e-7
    light = torch.rand(8, 16, 3, generator=g) * 100
    return Reconstruction(gaussians, light, Bound((0.1, 0.2, 0.3), 1.7), to_world, glossy, light / 7 if background else None)


@pytest.mark.parametrize("background", [False, True])
def test_comes_back_as_it_was(tmp_path, background):
    given = make(background, glossy=not background)
    given.save(tmp_path)
    loaded = Reconstruction.load(tmp_path)
    assert loaded.bound == given.bound and loaded.glossy == given.glossy
    assert np.array_equal(loaded.to_world, given.to_world)
    assert np.allclose(loaded.environment_map(), given.environment_map(), rtol=1e-3)
    assert torch.equal(loaded.gaussians.position, given.gaussians.position)
    assert (loaded.background is None) == (given.background is None)
    if background:
        assert torch.allclose(loaded.background, given.background, rtol=1e-3)
    names = {"gaussians.ply", "environment.exr", "reconstruction.json"} | ({"background.exr"} if background else set())
    assert {p.name for p in tmp_path.iterdir()} == names


def test_surface_samples_are_the_gaussians():
    given = make()
    assert np.array_equal(given.surface_samples().position, given.gaussians.position.T.numpy())


@pytest.mark.parametrize("name", ["gaussians.ply", "environment.exr", "background.exr", "reconstruction.json"])
@pytest.mark.parametrize("harm", ["missing", "cut"])
def test_missing_and_broken_files_are_named(tmp_path, name, harm):
    make(background=True).save(tmp_path)
    path = tmp_path / name
    if harm == "missing":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(InputError, match=name):
        Reconstruction.load(tmp_path)


@pytest.mark.parametrize(
    "change", [{"bound": None}, {"bound": {"centre": [0, 0, 0]}}, {"to_world": [[1, 0], [0, 1]]}, {"to_world": "no"}]
)  # fmt: skip
def test_unusable_description_is_refused(tmp_path, change):
    make().save(tmp_path)
    path = tmp_path / "reconstruction.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=r"reconstruction\.json"):
        Reconstruction.load(tmp_path)
