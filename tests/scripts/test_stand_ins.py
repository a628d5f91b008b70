# SPDX-License-Identifier: GPL-3.0-or-later
"""Stand-ins for published datasets: each is read as the dataset that it stands in for, photographs without masks show a table."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import warm_engine
from irgspp.core.datasets.load import load_dataset
from irgspp.core.shading.environment_lookup import texel_directions
from scripts_folder import SCRIPTS, scripts_on_path
from written_formats import source as source

with scripts_on_path():
    import stand_ins
    from reproduction.scenes import find_scenes
    from scenes.catalogue import SCENES
    from stand_in.kinds import KINDS
    from stand_in.lights import RECIPES, write_light

WORDS = ("--kinds", "glossy-real", "--resolution", "20", "--train", "7", "--test", "2", "--samples", "2", "--light-height", "8")


@pytest.mark.parametrize("name", KINDS)
def test_each_kind_is_read_as_what_it_stands_in_for(name, source, tmp_path):
    kind = KINDS[name]
    path, _ = kind.write(source, tmp_path / name)
    data = load_dataset(path)
    assert data.format == name and len(data.train) + len(data.test) == len(source.train) + len(source.test)
    assert set(kind.scenes.values()) <= set(SCENES) and set(kind.lights) <= set(RECIPES) and len(kind.scenes) == 2
    (tmp_path / name / "stand_in.json").write_text("{}")
    found = [scene for scene in find_scenes(tmp_path) if not scene.trouble]
    assert [(scene.format, scene.stand_in) for scene in found] == [(name, True)]


def run(out: Path) -> subprocess.CompletedProcess:
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(out.parent), "OMP_WAIT_POLICY": "PASSIVE"}
    words = [warm_engine.engine(sys.executable), str(SCRIPTS / "stand_ins.py"), "-o", str(out), *WORDS]
    return subprocess.run(words, capture_output=True, text=True, env=environment, check=False)


def test_rendered_stand_ins_are_kept_and_missing_ones_made(tmp_path):
    out = tmp_path / "out"
    done = run(out)
    assert done.returncode == 0, done.stderr
    folder = out / "glossy-real"
    assert json.loads((folder / "stand_in.json").read_text())["scenes"] == {"monkey": "monkey", "vase": "vase"}
    for scene in ("monkey", "vase"):
        data = load_dataset(folder / scene)
        assert data.format == "glossy-real" and all(view.alpha is None for view in data.train)
        corner = np.stack([view.colour[[0, 0, -1, -1], [0, -1, 0, -1]] for view in data.train])
        assert corner.std() > 0.02  # the pattern of the table
        points = data.points.position
        assert (np.linalg.norm(points, axis=1) > 1.5).any() and (np.linalg.norm(points, axis=1) < 1).any()
    kept = (folder / "monkey" / "meta_info.txt").stat().st_mtime_ns
    for file in sorted((folder / "vase").rglob("*"), reverse=True):
        file.unlink() if file.is_file() else file.rmdir()
    (folder / "vase").rmdir()
    assert run(out).returncode == 0
    assert (folder / "monkey" / "meta_info.txt").stat().st_mtime_ns == kept and load_dataset(folder / "vase").format == "glossy-real"


def test_lights_are_turned_and_tinted(tmp_path):
    from irgspp.core.io.exr import read_exr_rgb

    plain, turned = (read_exr_rgb(write_light(name, tmp_path, 32)) for name in ("sunset", "fireplace"))
    direction = texel_directions(32, 64).numpy()
    suns = [direction.reshape(-1, 3)[pixels.sum(-1).argmax()] for pixels in (plain, turned)]
    azimuth = [np.degrees(np.arctan2(d[1], d[0])) for d in suns]
    assert (azimuth[1] - azimuth[0]) % 360 == pytest.approx(150, abs=6)
    assert np.allclose(turned.sum((0, 1)) / plain.sum((0, 1)), RECIPES["fireplace"][2], rtol=1e-3)


def test_an_unknown_kind_is_refused_in_one_line(tmp_path, capsys):
    assert stand_ins.main(["-o", str(tmp_path), "--kinds", "tensoir,nerf"]) == 2
    assert "unknown kind nerf; use tensoir" in capsys.readouterr().err and not list(tmp_path.iterdir())
