# SPDX-License-Identifier: GPL-3.0-or-later
"""Image files of views: rotated and scaled lights, premultiplied and straight alpha, cameras in a run's world frame."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.io.exr import read_exr, rgb_channels, write_exr
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.progress.protocol import Silent
from irgspp.core.relight.render_views import Light, cameras_of, load_lamps, load_light, render_views, split_of, write_rgba
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.gbuffer import GBuffer
from irgspp.core.scene.lamps import Lamp, lamp_records
from irgspp.core.settings.schema import DataSettings
from irgspp.core.shading.environment_lookup import rotate
from irgspp.core.shading.procedural_lights import map_directions
from PIL import Image

CAMERA = Camera(6, 4, 5.0, 5.0, 3.0, 2.0, np.eye(4))


def buffers(alpha):
    shape = (4, 6)
    rng = np.random.default_rng(1)
    colour = rng.random((*shape, 3), np.float32)
    normal = np.broadcast_to(np.float32([0, 0, 1]), (*shape, 3))
    alphas, depth = np.full(shape, alpha, np.float32), np.full(shape, 2.0, np.float32)
    return GBuffer(CAMERA, alphas, depth, normal, colour, colour / 2, *rng.random((2, *shape), np.float32))


def test_light_turns_counter_clockwise_seen_from_above():
    """A lamp at +X (azimuth 0) rotated by 90 degrees is at +Y."""
    d = map_directions(32, 64)
    lamp = np.exp(20 * (d[..., :1] - 1))
    turned = rotate(lamp, 90)
    brightest = d.reshape(-1, 3)[turned.reshape(-1).argmax()]
    assert brightest @ [0, 1, 0] > 0.99


@given(st.floats(-720, 720))
def test_turning_keeps_the_light_and_can_be_undone_by_whole_turns(degrees):
    light = np.random.default_rng(0).random((4, 8, 3))
    np.testing.assert_allclose(rotate(light, degrees).sum(1), light.sum(1))
    np.testing.assert_allclose(rotate(light, degrees + 360), rotate(light, degrees), atol=1e-9)


def test_load_light(tmp_path):
    path = tmp_path / "city.exr"
    write_exr(path, rgb_channels(np.full((4, 8, 3), 0.5, np.float32)))
    light = load_light(path, rotation=45, strength=3)
    assert light.name == "city"
    np.testing.assert_allclose(light.image, 1.5)
    assert load_light(path, "other").name == "other"
    for wrong in ({"strength": -1.0}, {"strength": np.inf}, {"rotation": np.nan}):
        with pytest.raises(InputError, match="strength"):
            load_light(path, **wrong)
    with pytest.raises(InputError, match=r"none\.exr"):
        load_light(tmp_path / "none.exr")


def test_light_that_had_to_be_repaired_is_told(tmp_path):
    path = tmp_path / "broken.exr"
    image = np.full((4, 8, 3), 0.5, np.float32)
    image[0, 0, 0] = np.nan
    write_exr(path, rgb_channels(image))
    listener = Listener()
    light = load_light(path, progress=listener)
    assert "broken.exr: 1 texel is not a number" in listener.said
    assert np.isfinite(light.image).all()


class Listener(Silent):
    """Progress that records what it is told."""

    said = ""

    def message(self, text):
        self.said += text


class FakeRelighter:
    """Relighter that records its calls."""

    device = "cpu"

    reconstruction = SimpleNamespace(environment_map=lambda: np.full((2, 4, 3), 7, np.float32), confidence=None)

    def __init__(self, layers=None):
        self.asked, self.layers = [], layers

    def surface(self, camera):
        return camera

    def gbuffer(self, camera, surface):
        return self.layers

    def relit(self, surface, light, lamps=()):
        self.asked.append((surface, float(light.radiance[0, 0, 0])))
        return torch.full((4, 6, 4), 0.25)


def test_rgba_is_premultiplied_in_exr_and_straight_in_png(tmp_path):
    alpha = np.linspace(0, 1, 24, dtype=np.float32).reshape(4, 6, 1)
    colour = np.broadcast_to(np.float32([0.5, 0.2, 0.9]), (4, 6, 3))
    write_rgba(tmp_path / "rgba", np.concatenate([colour * alpha, alpha], -1))
    exr = read_exr(tmp_path / "rgba.exr")
    np.testing.assert_allclose(exr["G"], 0.2 * alpha[..., 0], atol=1e-6)
    png = np.asarray(Image.open(tmp_path / "rgba.png"), np.float32) / 255
    seen = alpha[..., 0] > 0.1
    np.testing.assert_allclose(decode_srgb(png[..., :3])[seen], colour[seen], atol=0.01)
    np.testing.assert_allclose(png[..., 3], alpha[..., 0], atol=0.003)


def test_views_are_written_with_their_layers(tmp_path):
    lights = [Light(name, np.full((2, 4, 3), level, np.float32)) for name, level in (("city", 1), ("night", 2))]
    relighter = FakeRelighter(buffers(0.5))
    render_views(relighter, [("r_000", CAMERA), ("r_001", CAMERA)], tmp_path, Silent(), lights=lights)
    images = [f"rgba_{light}.{kind}" for light in ("city", "night") for kind in ("exr", "png")]
    expected = ["albedo.exr", "depth.exr", "material.exr", "normal.exr", "radiance.exr", *images]
    for view in ("r_000", "r_001"):
        assert sorted(p.name for p in (tmp_path / view).iterdir()) == expected
    assert relighter.asked == [(CAMERA, 1.0), (CAMERA, 2.0)] * 2
    truth = buffers(0.5)
    radiance, material = read_exr(tmp_path / "r_000" / "radiance.exr"), read_exr(tmp_path / "r_000" / "material.exr")
    np.testing.assert_allclose(radiance["B"], truth.radiance[..., 2] * 0.5)
    np.testing.assert_allclose(radiance["A"], 0.5)
    np.testing.assert_allclose(material["G"], truth.metallic)
    np.testing.assert_allclose(read_exr(tmp_path / "r_000" / "albedo.exr")["R"], truth.albedo[..., 0])
    np.testing.assert_allclose(read_exr(tmp_path / "r_000" / "depth.exr")["Z"], 2)


def test_recovered_light_is_the_default(tmp_path):
    relighter = FakeRelighter()
    render_views(relighter, [("a", CAMERA)], tmp_path, Silent(), layers=("rgba",))
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["rgba.exr", "rgba.png"]
    assert relighter.asked == [(CAMERA, 7.0)]


def test_confidence_is_written_where_it_is_known(tmp_path):
    known = np.random.default_rng(2).random((4, 6, 3), np.float32)
    for confidence, expected in ((known, ["confidence.exr", "depth.exr"]), (None, ["depth.exr"])):
        folder = tmp_path / str(len(expected))
        relighter = FakeRelighter(replace(buffers(0.5), confidence=confidence))
        render_views(relighter, [("a", CAMERA)], folder, Silent(), layers=("confidence", "depth"))
        assert sorted(p.name for p in (folder / "a").iterdir()) == expected
    written = read_exr(tmp_path / "2" / "a" / "confidence.exr")
    np.testing.assert_allclose(np.stack([written[c] for c in "RGB"], -1), known)


def test_missing_confidence_is_told(tmp_path):
    for layers, told in ((("confidence", "depth"), True), (("depth",), False)):
        listener = Listener()
        render_views(FakeRelighter(buffers(0.5)), [("a", CAMERA)], tmp_path, listener, layers=layers)
        assert ("no confidence.exr" in listener.said) == told


def test_layers_are_zero_where_nothing_is(tmp_path):
    render_views(FakeRelighter(buffers(1e-4)), [("a", CAMERA)], tmp_path, Silent(), layers=("normal", "depth"))
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["depth.exr", "normal.exr"]
    assert not read_exr(tmp_path / "a" / "depth.exr")["Z"].any()
    assert not read_exr(tmp_path / "a" / "normal.exr")["B"].any()


def test_rendering_refuses_and_stops(tmp_path):
    with pytest.raises(InputError, match="gloss"):
        render_views(FakeRelighter(), [("a", CAMERA)], tmp_path, Silent(), layers=("gloss",))
    with pytest.raises(InputError, match="same name"):
        render_views(FakeRelighter(), [("a", CAMERA)], tmp_path, Silent(), lights=[Light("x", np.ones((2, 4, 3)))] * 2)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="can't be created"):
        render_views(FakeRelighter(), [("a", CAMERA)], tmp_path / "file", Silent())
    progress = Silent()
    progress.cancelled = True
    with pytest.raises(Cancelled):
        render_views(FakeRelighter(buffers(1.0)), [("a", CAMERA), ("b", CAMERA)], tmp_path, progress, layers=("depth",))
    assert (tmp_path / "a" / "depth.exr").exists()
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("d", ("d", None)),
        ("d:train", ("d", "train")),
        ("C:\\d", ("C:\\d", None)),
        ("C:\\d:test", ("C:\\d", "test")),
        ("C:/d", ("C:/d", None)),
    ],
)
def test_split_of(text, expected):
    assert split_of(text) == (Path(expected[0]), expected[1])


def test_split_that_is_none():
    with pytest.raises(InputError, match="DATASET:train"):
        split_of("d:val")


def test_cameras_come_into_the_world_of_the_run(tmp_path):
    """A point of the dataset's frame projects to the same pixel in a run that rotated, scaled and moved that frame."""
    rng = np.random.default_rng(2)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    run_to_world = np.eye(4)
    run_to_world[:3, :3], run_to_world[:3, 3] = 2.5 * turn, [1, 2, 3]
    points = rng.normal(size=(10, 3))
    inside = points @ run_to_world[:3, :3].T + run_to_world[:3, 3]
    plain, placed = (cameras_of(DEMO_DATA, "all", DataSettings(), world) for world in (np.eye(4), run_to_world))
    assert len(plain) == 46
    for (name, before), (same, after) in zip(plain, placed, strict=True):
        assert name == same
        pixels, depth = before.project(points)
        np.testing.assert_allclose(after.project(inside)[0], pixels, atol=1e-6)
        np.testing.assert_allclose(after.project(inside)[1], 2.5 * depth, atol=1e-6)


def test_lamps_are_read_from_a_file(tmp_path):
    file = tmp_path / "lamps.json"
    lamps = (Lamp("sun", emission=(1.0, 2.0, 3.0), radius=0.1), Lamp("area", size=(1.0, 2.0), shadow=False))
    file.write_text(json.dumps(lamp_records(lamps)))
    assert load_lamps(file) == lamps
    file.write_text("[{")
    with pytest.raises(InputError, match=r"lamps\.json: the lamps can't be read"):
        load_lamps(file)
    with pytest.raises(InputError, match="can't be read"):
        load_lamps(tmp_path / "gone.json")
