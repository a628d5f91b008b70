# SPDX-License-Identifier: GPL-3.0-or-later
"""Traced Gaussians and meshes that Cycles path-traces give the same image."""

import numpy as np
import pytest
from irgspp.core.shading.procedural_lights import studio_light
from PIL import Image
from scripts_folder import scripts_on_path

pytest.importorskip("bpy")
LIMIT = 0.03  # mean relative difference of a pixel, the noise of both included


@pytest.fixture(scope="module")
def script():
    with scripts_on_path() as script:
        yield script("cycles_comparison.compare")


@pytest.fixture(scope="module")
def light():
    return studio_light(64, 128)


@pytest.fixture(scope="module")
def cycles(script, light):
    return script.CyclesScene(light)


def differences(script, cycles, light, case, samples, cycles_samples):
    numbers = {"size": 24, "splats": 8000, "samples": samples, "cycles-samples": cycles_samples}
    args = script.arguments([word for name, value in numbers.items() for word in (f"--{name}", str(value))])
    direct, bounced = script.compare(case, cycles, light, args)
    assert (direct.bounces, bounced.bounces) == (0, 1)
    return direct, bounced


@pytest.mark.parametrize(
    ("case", "samples", "cycles_samples"), [("diffuse", 128, 256), ("metal", 512, 2048), ("metal on diffuse", 256, 512)]
)
def test_same_models_agree(script, cycles, light, case, samples, cycles_samples):
    for difference in differences(script, cycles, light, case, samples, cycles_samples):
        assert difference.relative < LIMIT and abs(difference.signed) < 0.005, difference.row()


def test_coated_diffuse_differs_by_what_the_coat_reflects(script, cycles, light):
    """Principled takes from its diffuse lobe what its specular one reflects, about 5 % here; with the same taken from ours they agree."""
    for difference in differences(script, cycles, light, "dielectric", 128, 256):
        assert 0.03 < difference.signed < 0.07, difference.row()
    for difference in differences(script, cycles, light, "dielectric, 1-E_s", 128, 256):
        assert difference.relative < LIMIT and abs(difference.signed) < 0.01, difference.row()


def test_table_and_images(script, tmp_path, capsys):
    few = ["--size", "12", "--splats", "3000", "--samples", "16", "--cycles-samples", "4"]
    assert script.main(["diffuse", "-o", str(tmp_path), *few]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("diffuse ")]
    assert len(lines) == 2 and "direct" in lines[0] and "one bounce" in lines[1]
    for name in ("diffuse_0.png", "diffuse_1.png"):
        ours, theirs, apart = np.split(np.asarray(Image.open(tmp_path / name)).astype(int), 3, axis=1)
        assert ours.max() > 100 and abs(ours - theirs).mean() < 10 and apart.any()
