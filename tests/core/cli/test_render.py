# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of `irgspp render`: lights, cameras, samples; bad ones end with status 2 and one line."""

from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.cli.main import main
from irgspp.core.cli.parser import parser
from irgspp.core.cli.render import _cameras, _lights
from irgspp.core.errors import InputError
from irgspp.core.io.exr import read_exr
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.run_folder import RunFolder
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gaussians import Gaussians
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.schema import DataSettings, Settings


def parsed(*words):
    return parser().parse_args(["render", "run", "-o", "out", *words])


@pytest.fixture
def run(tmp_path, some_gaussians):
    """A run of arbitrary Gaussians, without a mesh."""
    folder = RunFolder.open(tmp_path / "run", Settings(), str(DEMO_DATA))
    folder.close()
    scene = Reconstruction(some_gaussians, torch.full((4, 8, 3), 0.5), Bound((0, 0, 0), 1.5), np.eye(4))
    scene.save(folder.path)
    return folder.path


@pytest.fixture
def some_gaussians():
    g = torch.Generator().manual_seed(0)
    shapes = {"position": (3,), "quaternion": (4,), "log_scale": (2,), "opacity": (), "sh": (16, 3), "material": (5,)}
    gaussians = Gaussians(**{name: torch.randn(*shape, 40, generator=g) * 0.4 for name, shape in shapes.items()})
    gaussians.log_scale -= 2
    return gaussians


def test_lights_and_their_options():
    assert _lights(parsed()) == []
    two = ("--environment", "a.exr", "--environment", "b.hdr")
    assert _lights(parsed(*two)) == [(Path("a.exr"), None, 0.0, 1.0), (Path("b.hdr"), None, 0.0, 1.0)]
    named = parsed(*two, "--name", "x", "--name", "y", "--rotation", "90", "--strength", "2", "--strength", "3")
    assert _lights(named) == [(Path("a.exr"), "x", 90.0, 2.0), (Path("b.hdr"), "y", 90.0, 3.0)]


@pytest.mark.parametrize(
    "words",
    [
        ["--name", "x"],
        ["--strength", "2"],
        ["--environment", "a.exr", "--environment", "b.exr", "--name", "x"],
        ["--environment", "a.exr", "--rotation", "1", "--rotation", "2"],
    ],
)
def test_lights_that_do_not_match(words):
    with pytest.raises(InputError, match=words[-2]):
        _lights(parsed(*words))


def test_some_frames_alone(run):
    scene = Reconstruction.load(run)
    around = ("--views", f"{DEMO_DATA}:test", "--orbit", "12")
    every = _cameras(parsed(*around), DataSettings(), scene)
    some = _cameras(parsed(*around, "--frames", "9..11, 2,0-2"), DataSettings(), scene)
    assert [name for name, _ in some] == [every[i][0] for i in (0, 1, 2, 9, 10, 11)]
    assert np.array_equal(some[3][1].to_world, every[9][1].to_world)
    with pytest.raises(InputError, match="--frames: 12: there are views 0 to 11"):
        _cameras(parsed(*around, "--frames", "3-12"), DataSettings(), scene)


@pytest.mark.parametrize("text", ["", "a", "-3", "5-3", "1,,2", "0-99999999999"])
def test_bad_lists_of_frames(text, capsys):
    assert main(["render", "run", "-o", "out", "--orbit", "3", f"--frames={text}"]) == 2
    assert "is not a list of frames" in capsys.readouterr().err


def test_cameras_of_a_dataset_or_around_it(run):
    scene = Reconstruction.load(run)
    views = _cameras(parsed("--views", f"{DEMO_DATA}:test"), DataSettings(), scene)
    around = _cameras(parsed("--views", f"{DEMO_DATA}:test", "--orbit", "7"), DataSettings(), scene)
    assert len(views) == 6 and len(around) == 7
    assert around[0][1].fx == views[0][1].fx
    with pytest.raises(InputError, match="--orbit"):
        _cameras(parsed(), DataSettings(), scene)
    with pytest.raises(InputError, match=r"cameras\.json"):  # of the run, where no dataset is named
        _cameras(parsed("--orbit", "7"), DataSettings(), scene)


def test_views_have_the_size_of_the_photographs(run):
    """The run was made from photographs of half their size; its views are rendered at the whole one, or at the size that is asked for."""
    scene, made_from = Reconstruction.load(run), DataSettings(resolution=32)
    command = ("--views", f"{DEMO_DATA}:test")
    sizes = [
        {(camera.width, camera.height) for _, camera in _cameras(parsed(*command, *words), made_from, scene)}
        for words in ((), ("--resolution", "48"), ("--resolution", "100"))
    ]
    assert sizes == [{(64, 64)}, {(48, 48)}, {(100, 100)}]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--samples", "0"], "samples"),
        (["--backend", "mesh"], "mesh.ply"),
        (["--orbit", "0"], "--orbit"),
        (["--resolution", "8"], "from 16 to 16384"),
        (["--environment", "missing.hdr"], "missing.hdr"),
        (["--environment", "missing.hdr", "--strength", "-1"], "strength"),
        (["--albedo-scale", "1", "2"], "3 arguments"),
        (["--albedo-scale", "1", "2", "-3"], "albedo-scale"),
        (["--sampling", "random"], "stratified"),
    ],
)
def test_bad_usage(run, tmp_path, capsys, words, complaint):
    assert main(["render", str(run), "--views", f"{DEMO_DATA}:test", "-o", str(tmp_path / "out"), *words]) == 2
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_options_reach_the_images(run, tmp_path, capsys):
    """The same view by default, brighter albedo, and stratified: three different images of the same coverage."""
    images = []
    for i, words in enumerate(([], ["--albedo-scale", "2", "2", "2"], ["--sampling", "stratified"])):
        out = tmp_path / str(i)
        command = ["render", str(run), "--views", str(DEMO_DATA), "--orbit", "1", "-o", str(out), "--layers", "rgba"]
        assert main([*command, "--samples", "8", "--no-denoise", *words]) == 0
        images.append(read_exr(out / "orbit_000" / "rgba.exr"))
    assert capsys.readouterr().out.split() == [str(tmp_path / str(i)) for i in range(3)]
    for other in images[1:]:
        np.testing.assert_array_equal(images[0]["A"], other["A"])
        assert not np.array_equal(images[0]["R"], other["R"])
    assert images[1]["R"].mean() > 1.2 * images[0]["R"].mean()
