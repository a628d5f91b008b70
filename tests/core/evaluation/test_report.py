# SPDX-License-Identifier: GPL-3.0-or-later
"""The report and the contact sheet, with a stand-in for the renderer that returns the ground truth."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.evaluation import cases, light_comparison, report
from irgspp.core.evaluation import contact_sheet as sheet
from irgspp.core.evaluation.light_comparison import PICTURES
from irgspp.core.evaluation.light_dependence import ROWS
from irgspp.core.evaluation.lpips import NO_LPIPS, Lpips
from irgspp.core.evaluation.protocols import PROTOCOLS, describe_protocol
from irgspp.core.progress.protocol import Silent
from irgspp.core.relight.relight_settings import RelightSettings
from markupsafe import escape
from PIL import Image

EDGES = {"tensoir": 27, "irgs": 33}  # dB left by the error of half-covered pixels, which these papers' protocols don't keep half covered


class Known:
    """Stand-in for a reconstruction in the dataset's own frame."""

    to_world, brdf = np.eye(4), "principled"

    def __init__(self, light):
        self.light = light

    def to(self, device):
        return self

    def environment_map(self):
        return self.light


@pytest.fixture
def known(demo, monkeypatch):
    """A renderer that returns the ground truth of the view with the given camera, under the given light; the dataset is not read again."""
    _, dataset, scene, _, predictions = demo

    def at(camera):
        (match,) = [p for v, p in zip(dataset.test, predictions, strict=True) if np.allclose(v.camera.to_world, camera.to_world)]
        return match

    class KnowingRelighter:
        """Renders images under other lights darker by a third unless the albedo's scale, which is 1, was applied."""

        rotations, lights = [], []  # what layers and images were asked for

        def __init__(self, brightness=0.67):
            self.brightness = brightness
            self.reconstruction, self.mesh = known, None

        def with_albedo_scale(self, scale):
            return self if scale is None else KnowingRelighter(float(np.mean(scale)))

        def surface(self, camera):
            return camera

        def gbuffer(self, camera, surface=None, light_rotation=None):
            self.rotations.append(light_rotation)
            return at(camera).buffers

        def relit(self, camera, light):
            self.lights.append(light.radiance.numpy())
            name = next((n for n, truth in scene.lights.items() if np.array_equal(light.radiance.numpy(), truth)), scene.train_light)
            relit = name != scene.train_light
            return torch.from_numpy(at(camera).relit[name] * self.brightness if relit else at(camera).shaded)

    monkeypatch.setattr(report, "open_relighter", lambda *_: KnowingRelighter())
    monkeypatch.setattr(cases, "load_dataset", lambda path, *_: {demo[0]: dataset}[path])
    monkeypatch.setattr(light_comparison, "load_run_cameras", lambda path: [])
    monkeypatch.setattr(light_comparison, "read_run", lambda run: {"dataset": str(demo[0])})
    monkeypatch.setattr(light_comparison, "light_dependence", lambda *_: np.ones((ROWS, 2 * ROWS)))
    known = Known(scene.lights["sky"])
    monkeypatch.setattr(report.Reconstruction, "load", lambda run: known)
    return KnowingRelighter()


def test_report_of_a_perfect_run(demo, known, tmp_path):
    found = report.evaluate(tmp_path / "run", demo[0], tmp_path / "out")
    measured = found["figures"]
    assert measured["nvs_psnr"] > 90 and measured["relight_psnr"] > 50 and measured["normal_mae"] < 0.1
    assert measured["albedo_psnr"] == measured["environment_psnr"] == measured["environment_psnr_constrained"] == 100
    assert measured["metallic_false_fraction"] == 0 and measured["environment_constrained"] == pytest.approx(1)
    assert np.allclose(found["albedo_scale"], 1) and len(found["views"]) == 6 and found["split"] == "test"
    assert json.loads((tmp_path / "out" / "report.json").read_text()) == found
    files = {"report.html", "report.json", *(f"{name}.png" for name in PICTURES)}
    assert {p.name for p in (tmp_path / "out").iterdir()} == files
    assert "Protocol plain: this program's own." in found["protocol"] and found["choices"]["name"] == "plain"
    assert any("albedo times 1.0000 1.0000 1.0000" in line for line in found["protocol"])
    lines = report.table(found).splitlines()
    assert any(re.fullmatch(r"normal_mae +0\.0\d+", line) for line in lines) and ["test", "views", "6"] in [line.split() for line in lines]
    assert lines[-len(found["protocol"]) :] == found["protocol"]


def test_page_is_self_contained(demo, known, tmp_path):
    report.evaluate(tmp_path, demo[0])
    html = (tmp_path / "evaluation" / "report.html").read_text()
    sources = re.findall(r"(?:src|href)='([^']{5})", html)
    assert len(sources) > 6 * 12 and set(sources) == {"data:"}
    for name in (*demo[2].lights, "Relit images: albedo times", "true normal", "photograph", "r_005"):
        assert name == "sky" or name in html


def test_page_shows_the_error_by_confidence(demo, known, tmp_path):
    found = report.evaluate(tmp_path, demo[0])
    curve = [{"confidence": 0.2, "error": 0.08}, {"confidence": 0.9, "error": 0.02}]
    page = report.page(found | {"calibration": {"albedo": curve}}, {})
    assert re.findall(r"height: ([0-9.]+)%", page) == ["100.0", "25.0"]
    assert "albedo: confidence 0.20, error 0.0800 to confidence 0.90, error 0.0200" in page
    assert "<h2>Confidence</h2>" not in report.page(found | {"calibration": {}}, {})


def test_page_and_folder_show_the_light(demo, known, tmp_path):
    report.evaluate(tmp_path, demo[0], views=1)
    html, folder = (tmp_path / "evaluation" / "report.html").read_text(), tmp_path / "evaluation"
    row = html.split("<h2>Light</h2>")[1].split("<h2>")[0]
    assert "<div class='row wide'>" in row
    for caption in ("recovered light", "true light", "orange: too bright", "100% of the sphere", "2 x the mean"):
        assert caption in row
    with Image.open(folder / "light_recovered.png") as ours, Image.open(folder / "light_true.png") as true:
        assert ours.size == true.size == demo[2].lights["sky"].shape[1::-1] and np.array_equal(np.asarray(ours), np.asarray(true))
    assert "Constrained part of the light" in html


def test_pictures_of_an_earlier_report_do_not_stay(demo, known, tmp_path, monkeypatch):
    report.evaluate(tmp_path, demo[0], views=1)
    monkeypatch.setattr(cases, "load_scene_truth", lambda *_: replace(demo[2], train_light=None))
    found = report.evaluate(tmp_path, demo[0], views=1)
    left = {p.stem for p in (tmp_path / "evaluation").glob("*.png")}
    assert left == set(PICTURES) - {"light_true", "light_difference"} and "environment_psnr" not in found["figures"]


def test_page_escapes_names(demo, known, tmp_path):
    found = report.evaluate(tmp_path, demo[0])
    _, dataset, _, truths, predictions = demo
    shown = {dataset.test[0].name: (predictions[0], truths[0])}
    assert "<script>" not in report.page(found | {"run": "<script>"}, shown)


@pytest.mark.parametrize("name", [name for name in PROTOCOLS if name != "plain"])
def test_report_of_a_perfect_run_by_each_protocol(demo, known, tmp_path, name):
    found = report.evaluate(tmp_path / "run", demo[0], tmp_path / "out", protocol=name, views=3, samples=8)
    measured, how = found["figures"], PROTOCOLS[name]
    assert list(found["views"]) == [demo[1].test[i].name for i in (0, 2, 5)]
    psnr = "psnr_ldr" if how.radiance else "psnr"
    least = EDGES.get(name, 45)
    assert measured[f"nvs_{psnr}"] > least and measured["normal_mae"] < 0.1 and measured["albedo_psnr"] > 90
    if how.relit_scaled:
        assert measured[f"relight_{psnr}"] > least  # the renderer of these tests is too dark where no scale is taken
    else:
        assert "relight_psnr_scaled" in measured or how.radiance
    if how.scale_free:
        assert measured["normal_cosine"] < 1e-5 and measured["depth_si_mse"] < 1e-12
        assert found["albedo_scale"] is None
    shown = report.table(found)
    html = (tmp_path / "out" / "report.html").read_text()
    for line in (*describe_protocol(how), "Only 3 of the 6 test views, evenly spread: published tables are of all.", NO_LPIPS):
        assert line in shown and escape(line) in html and line in found["protocol"]
    assert "8 samples per pixel" in shown


def test_the_renderer_is_as_asked_and_the_report_says_so(demo, known, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(report, "open_relighter", lambda *words: asked.append(words[2:]) or known)
    relight = RelightSettings(sampling="stratified", denoise="off", indirect=False, conserving=False)
    found = report.evaluate(tmp_path, demo[0], views=1, samples=8, relight=relight, backend="gaussian", device="cpu")
    assert asked == [("gaussian", replace(relight, samples=8))]
    words = "8 samples per pixel, gaussian backend, not denoised, strata of the hemisphere, without indirect light, Lambertian diffuse lobe"
    assert f"Shaded and relit images: {words}." in found["protocol"]
    monkeypatch.setattr(Known, "brdf", "irgs")  # of the run
    found = report.evaluate(tmp_path, demo[0], views=1, samples=8, device="cpu")
    assert any(line.startswith("Shaded and relit") and line.endswith(", IRGS' BRDF.") for line in found["protocol"])


def test_as_many_views_are_relit_as_the_protocol_says(demo, known, tmp_path, monkeypatch):
    monkeypatch.setitem(PROTOCOLS, "glossy", replace(PROTOCOLS["glossy"], relit_views=2))
    views = report.evaluate(tmp_path, demo[0], protocol="glossy", samples=8)["views"]
    assert [any(figure.startswith("relight") for figure in row) for row in views.values()] == [True, True, False, False, False, False]


def test_photographs_under_other_lights_are_what_relit_images_are_compared_with(demo, known, tmp_path, monkeypatch):
    """The demo's relit ground truth serves as photographs under other lights."""
    _, dataset, _, truths, _ = demo
    novel = []
    for light in ("studio", "sunset"):
        for view, truth in list(zip(dataset.test, truths, strict=True))[:3]:
            novel.append(replace(view, light=light, colour=truth.relit[light] / np.maximum(truth.alpha, 1e-6)[..., None]))
    monkeypatch.setattr(cases, "load_novel_views", lambda *_: novel)
    found, (first, _, third) = report.evaluate(tmp_path, demo[0], views=2, samples=8), [view.name for view in dataset.test[:3]]
    assert list(found["views"])[2:] == [f"{light}_{name}" for light in ("studio", "sunset") for name in (first, third)]
    assert "4 of 6 views are photographs under other lights" in found["protocol"][-2]
    row = found["views"][f"sunset_{third}"]
    assert row["relight_sunset_psnr"] > 50 and not [figure for figure in row if figure.startswith(("nvs", "radiance"))]
    assert "2 test views and 4 under other lights" in (tmp_path / "evaluation" / "report.html").read_text()
    lines = [line.split() for line in report.table(found).splitlines()]
    assert ["test", "views", "2"] in lines and ["views", "under", "other", "lights", "4"] in lines


def test_lpips_of_a_file_is_in_the_table(demo, known, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "find_lpips", lambda file, *_: Lpips(file.name, lambda a, b: torch.tensor(0.125)))
    found = report.evaluate(tmp_path, demo[0], lpips=tmp_path / "metric.pt", views=1)
    names = ("nvs", "radiance", "relight", "relight_studio", "albedo")
    assert all(found["figures"][f"{name}_lpips"] == 0.125 for name in names) and "LPIPS: metric.pt." in found["protocol"]


def test_cancelling_leaves_no_report(demo, known, tmp_path):
    class Stop(Silent):
        def step(self, done, **figures):
            self.cancelled = done >= 2

    with pytest.raises(Cancelled):
        report.evaluate(tmp_path, demo[0], progress=Stop())
    assert not list(tmp_path.iterdir())


def test_report_that_can_not_be_written(demo, known, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file"):
        report.evaluate(tmp_path, demo[0], tmp_path / "file")


def test_contact_sheet_shows_each_view_under_each_heading(demo, known, tmp_path):
    sheet.contact_sheet(demo[1], known, tmp_path / "sheet.png", Silent(), rows=3)
    with Image.open(tmp_path / "sheet.png") as image:
        pixels = np.asarray(image.convert("RGB"), float) / 255
    pitch = sheet.TILE + sheet.GAP
    assert pixels.shape == (sheet.HEADER + 3 * pitch, sheet.GAP + len(sheet.COLUMNS) * pitch, 3)
    tiles = [[pixels[sheet.HEADER + r * pitch :, sheet.GAP + c * pitch :][: sheet.TILE, : sheet.TILE] for c in range(9)] for r in range(3)]
    for row in tiles:
        assert np.abs(row[0] - row[1]).mean() < 0.01  # photograph and a perfect reconstruction of it
        assert np.abs(row[0] - row[2]).mean() < 0.01  # and its materials under its light
        assert np.abs(row[0] - row[3]).mean() > 0.02
        assert np.array_equal(row[4][..., 0], row[4][..., 2])  # roughness is grey
    assert np.abs(tiles[0][0] - tiles[1][0]).mean() > 0.02
    assert [p.name for p in tmp_path.iterdir()] == ["sheet.png"]


QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # turn about +Z, from the world to the frame of the light


@pytest.mark.parametrize("what", ["contact sheet", "evaluation"])
def test_photographs_are_shown_under_the_light_as_it_was_turned(demo, known, tmp_path, monkeypatch, what):
    dataset = replace(demo[1], test=[replace(view, light_rotation=QUARTER) for view in demo[1].test])
    monkeypatch.setattr(cases, "load_dataset", lambda *_: dataset)
    if what == "contact sheet":
        sheet.contact_sheet(dataset, known, tmp_path / "sheet.png", Silent(), rows=1)
    else:
        report.evaluate(tmp_path, demo[0], tmp_path / "report")
    light = known.reconstruction.environment_map()
    assert known.rotations and all(rotation is not None and np.allclose(rotation, QUARTER) for rotation in known.rotations)
    np.testing.assert_allclose(known.lights[0], np.roll(light, light.shape[1] // 4, 1), rtol=1e-3, atol=1e-4)


def test_cancelling_leaves_no_contact_sheet(demo, known, tmp_path):
    progress = Silent()
    progress.cancelled = True
    with pytest.raises(Cancelled):
        sheet.contact_sheet(demo[1], known, tmp_path / "sheet.png", progress)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("width", "height"), [(64, 64), (1600, 900), (900, 1600), (300, 3000), (5, 3)])
def test_tiles_keep_the_shape_of_the_image(width, height):
    w, h = sheet.tile_size(width, height, sheet.TILE)
    assert w <= sheet.TILE and h <= 1.5 * sheet.TILE + 0.5
    assert w == sheet.TILE or h == round(1.5 * sheet.TILE)
    assert w / h == pytest.approx(width / height, rel=0.04)


def test_views_are_spread_over_the_dataset(demo):
    train = demo[1].train
    assert cases.spread_views(train, 3) == [train[0], train[20], train[-1]]
    assert cases.spread_views(train[:2], 4) == train[:2]
