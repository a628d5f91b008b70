# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures and metrics of the recovered light next to the true one."""

from pathlib import Path

import numpy as np
import pytest
from irgspp.core.errors import InputError
from irgspp.core.evaluation import light_comparison
from irgspp.core.evaluation.light_comparison import PICTURES, compare_lights
from irgspp.core.evaluation.light_dependence import ROWS
from irgspp.core.shading.procedural_lights import sky_light

LOWER = np.arange(ROWS) >= ROWS // 2


class Lit:
    """Stand-in for a reconstruction with a light."""

    to_world = np.eye(4)

    def __init__(self, light):
        self.light = light

    def environment_map(self):
        return self.light


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run folder whose photographs depend on the upper half of the light alone."""
    (tmp_path / "cameras.json").write_text("[]")
    monkeypatch.setattr(light_comparison, "read_run", lambda path: {"dataset": str(path / "photos")})
    dependence = np.repeat(np.where(LOWER, 0.0, 2.0)[:, None], 2 * ROWS, 1)
    monkeypatch.setattr(light_comparison, "light_dependence", lambda *_: dependence)
    return tmp_path


def test_what_the_photographs_do_not_constrain_does_not_count(run):
    truth = sky_light(64, 128) + 0.05
    light = 0.5 * truth
    light[36:] *= 4  # a wrong guess below the horizon
    found = compare_lights(run, Lit(light), truth)
    assert found.figures["environment_psnr_constrained"] > 60 > 30 > found.figures["environment_psnr"]
    assert found.figures["environment_constrained"] == pytest.approx(0.5, abs=0.06)
    assert "0.1 times" in found.description and "the object hides" in found.description


def test_pictures_show_the_maps_alike_and_where_they_differ(run):
    truth = np.full((32, 64, 3), 0.4)
    light = truth.copy()
    light[:8, :32], light[:8, 32:] = 0.8, 0.1
    found = compare_lights(run, Lit(2 * light), truth)
    assert np.allclose(found.recovered, light * (found.recovered[20, 0] / 0.4), rtol=1e-6)  # one scale
    pictures = {name: image for name, (_, image) in found.pictures().items()}
    assert tuple(pictures) == PICTURES and all(image.shape == (32, 64, 4) and image.max() <= 1 for image in pictures.values())
    brighter, darker = pictures["light_difference"][2, 5], pictures["light_difference"][2, 50]
    assert brighter[0] > brighter[2] + 0.2 and darker[2] > darker[0] + 0.2  # orange, blue
    same = compare_lights(run, Lit(3 * truth), truth).pictures()
    assert np.allclose(same["light_recovered"][1], same["light_true"][1], atol=1e-6)
    assert same["light_difference"][1][..., :3].max() < 0.03
    rows = (pictures["light_constrained"] == pictures["light_recovered"]).all(-1).mean(1)
    assert (rows[:14] == 1).all() and (rows[18:] < 0.2).all()
    assert np.allclose(pictures["light_confidence"][..., :3], found.confidence[..., None])
    assert found.error[2, 50] == found.error.max() > found.error[2, 5] > 4 * found.error[20, 5]
    assert pictures["light_dependence"][3].mean() > 0.8 > 0.3 > pictures["light_dependence"][28, :, :3].mean()


def test_without_a_true_light_the_recovered_one_is_shown(run):
    found = compare_lights(run, Lit(sky_light(32, 64)), None)
    assert set(found.figures) == {"environment_constrained"} and found.true is None and found.error is None
    assert tuple(found.pictures()) == tuple(name for name in PICTURES if name not in ("light_true", "light_difference"))


def test_lights_are_compared_on_the_grid_of_the_protocol(run):
    found = compare_lights(run, Lit(sky_light(32, 64)), sky_light(64, 128), (16, 32))
    assert found.recovered.shape == found.true.shape == (16, 32, 3) and found.part.shape == (16, 32)


def test_surroundings_come_from_the_capture_of_the_run(run, monkeypatch):
    asked = []
    monkeypatch.setattr(light_comparison, "light_dependence", lambda *words: asked.append(words[2]) or np.ones((ROWS, 2 * ROWS)))
    monkeypatch.setattr(light_comparison, "parse_dataset", lambda folder, _: Parsed(folder))
    assert "surfaces around" not in compare_lights(run, Lit(sky_light(32, 64)), None).description
    (run / "capture").mkdir()
    (run / "capture" / "surroundings.npz").touch()
    assert "surfaces around" in compare_lights(run, Lit(sky_light(32, 64)), None).description
    assert asked == [None, run / "capture"]


class Parsed:
    """Stand-in for a captured dataset in the frame of the run; its surroundings are their folder."""

    to_world = np.eye(4)

    def __init__(self, folder: Path):
        self.folder, self.surroundings = folder, self

    def moved(self, similarity):
        assert np.array_equal(similarity, np.eye(4))
        return self.folder


def test_a_run_without_cameras_is_refused(run):
    (run / "cameras.json").unlink()
    with pytest.raises(InputError, match=r"cameras\.json"):
        compare_lights(run, Lit(sky_light(32, 64)), None)
