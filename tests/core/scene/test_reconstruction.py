# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstruction: written to a folder and read back, with its reflections."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gaussians import Gaussians
from irgspp.core.scene.reconstruction import Reconstruction, Reflections


def make(background=False, glossy=True):
    g = torch.Generator().manual_seed(0)
    shapes = {"position": (3,), "quaternion": (4,), "log_scale": (2,), "opacity": (), "sh": (16, 3), "material": (5,)}
    gaussians = Gaussians(**{name: torch.randn(*shape, 20, generator=g) for name, shape in shapes.items()})
    to_world = np.diag([2.0, 2.0, 2.0, 1.0])
    to_world[:3, 3] = 1 / 3, -5, 1e-7
    light = torch.rand(8, 16, 3, generator=g) * 100
    return Reconstruction(gaussians, light, Bound((0.1, 0.2, 0.3), 1.7), to_world, glossy, light / 7 if background else None)


@pytest.mark.parametrize("background", [False, True])
def test_round_trip(tmp_path, background):
    given = make(background, glossy=not background)
    given.save(tmp_path)
    loaded = Reconstruction.load(tmp_path)
    assert loaded.bound == given.bound and loaded.has_split_sum == given.has_split_sum
    assert np.array_equal(loaded.to_world, given.to_world)
    assert np.allclose(loaded.environment_map(), given.environment_map(), rtol=1e-3)
    assert torch.equal(loaded.gaussians.position, given.gaussians.position)
    assert (loaded.background is None) == (given.background is None)
    if background:
        assert torch.allclose(loaded.background, given.background, rtol=1e-3)
    names = {"gaussians.ply", "environment.exr", "reconstruction.json"} | ({"background.exr"} if background else set())
    assert {p.name for p in tmp_path.iterdir()} == names


def test_confidence_belongs_to_the_materials(tmp_path):
    known = torch.rand(3, 20, generator=torch.Generator().manual_seed(2))
    given = replace(make(), confidence=known)
    given.save(tmp_path)
    assert torch.equal(Reconstruction.load(tmp_path).confidence, known)
    assert torch.equal(given.to("cpu").confidence, known)
    assert given.relabelled(given.gaussians.material, given.environment).confidence is None


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


def relabelled():
    given = make()
    return given, given.relabelled(torch.randn(5, 20, generator=torch.Generator().manual_seed(1)), torch.rand(4, 8, 3))


def test_relabelled_keeps_the_reflections_of_the_radiance(tmp_path):
    given, new = relabelled()
    assert new.gaussians.sh is given.gaussians.sh and new.gaussians.material is not given.gaussians.material
    again = new.relabelled(given.gaussians.material, given.environment)
    again.save(tmp_path)
    loaded = Reconstruction.load(tmp_path)
    for one in (new, again, loaded):
        mirrored = one.mirrored()
        assert torch.equal(mirrored.material, given.gaussians.materials())
        assert torch.equal(mirrored.environment, given.environment)
    assert not [p for p in tmp_path.iterdir() if ".part" in p.name]


def test_nothing_is_reflected_where_the_sh_hold_all_radiance():
    given = make(glossy=False)
    new = given.relabelled(given.gaussians.material + 1, given.environment)
    assert given.mirrored() is None and new.mirrored() is None and new.reflections is None


def save_arrays(path, material, environment, **more):
    np.savez(path, material=material, environment=environment, **more)


GOOD = np.full((5, 20), 0.5, np.float32), np.ones((4, 8, 3), np.float32)


@pytest.mark.parametrize(
    "harm",
    [
        lambda path: path.unlink(),
        lambda path: path.write_bytes(path.read_bytes()[:100]),
        lambda path: path.write_bytes(b""),
        lambda path: np.savez(path, material=GOOD[0]),
        lambda path: save_arrays(path, GOOD[0][:, :19], GOOD[1]),
        lambda path: save_arrays(path, GOOD[0] * np.nan, GOOD[1]),
        lambda path: save_arrays(path, GOOD[0] * 3, GOOD[1]),
        lambda path: save_arrays(path, GOOD[0], -GOOD[1]),
        lambda path: save_arrays(path, GOOD[0], GOOD[1] * np.inf),
        lambda path: save_arrays(path, GOOD[0], GOOD[1][0]),
        lambda path: save_arrays(path, GOOD[0], np.array([{}], object)),  # would have to be unpickled
    ],
)
def test_unusable_reflections_are_refused(tmp_path, harm):
    relabelled()[1].save(tmp_path)
    harm(tmp_path / "reflections.npz")
    with pytest.raises(InputError, match=r"reflections\.npz"):
        Reconstruction.load(tmp_path)


def test_reflections_round_trip(tmp_path):
    path = tmp_path / "reflections.npz"
    Reflections(torch.from_numpy(GOOD[0]), torch.from_numpy(GOOD[1])).save(path)
    loaded = Reflections.load(path, 20)
    assert np.array_equal(loaded.material, GOOD[0]) and np.array_equal(loaded.environment, GOOD[1])


def test_the_floor_is_kept_and_runs_of_earlier_versions_have_none(tmp_path):
    made = make()
    replace(made, bound=replace(made.bound, floor=-0.25)).save(tmp_path)
    assert Reconstruction.load(tmp_path).bound == replace(made.bound, floor=-0.25)
    path = tmp_path / "reconstruction.json"
    about = json.loads(path.read_text())
    del about["bound"]["floor"]
    path.write_text(json.dumps(about))
    assert Reconstruction.load(tmp_path).bound == made.bound


def test_how_much_is_relief_is_kept_and_unknown_in_runs_of_earlier_versions(tmp_path):
    replace(make(), relief=0.25).save(tmp_path)
    assert Reconstruction.load(tmp_path).relief == 0.25
    path = tmp_path / "reconstruction.json"
    about = json.loads(path.read_text())
    del about["relief"]
    path.write_text(json.dumps(about))
    assert Reconstruction.load(tmp_path).relief is None
    make().save(tmp_path)
    assert Reconstruction.load(tmp_path).relief is None
    for broken in (1.5, -0.1, float("nan"), "much"):
        path.write_text(json.dumps({**about, "relief": broken}))
        with pytest.raises(InputError, match=r"reconstruction\.json: not readable"):
            Reconstruction.load(tmp_path)


def test_the_brdf_of_the_materials_is_kept(tmp_path):
    given = replace(make(), brdf="irgs")
    given.save(tmp_path)
    loaded = Reconstruction.load(tmp_path)
    assert loaded.brdf == loaded.to("cpu").brdf == loaded.relabelled(given.gaussians.material, given.environment).brdf == "irgs"


def test_runs_of_earlier_versions_have_the_principled_brdf_and_unknown_ones_are_refused(tmp_path):
    make().save(tmp_path)
    path = tmp_path / "reconstruction.json"
    about = json.loads(path.read_text())
    assert about.pop("brdf") == "principled"
    path.write_text(json.dumps(about))
    assert Reconstruction.load(tmp_path).brdf == "principled"
    for other in ("disney", 3, ["irgs"], None):
        path.write_text(json.dumps({**about, "brdf": other}))
        with pytest.raises(InputError, match=r"reconstruction\.json: its materials belong to the BRDF .*principled, irgs"):
            Reconstruction.load(tmp_path)
