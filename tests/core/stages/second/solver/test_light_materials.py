# SPDX-License-Identifier: GPL-3.0-or-later
"""Light and materials of points: where metal is searched, which start counts, and errors where they cannot be solved."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import torch
from irgspp.core.errors import Cancelled, IrgsppError
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.second.solver import light_materials
from irgspp.core.stages.second.solver.multi_view_samples import MultiViewSamples

SETTINGS = with_overrides(Settings(), ["second.points=150", "second.rows=4"])


@dataclass
class Listener(Silent):
    """Progress that records messages."""

    messages: list[str] = field(default_factory=list)

    def message(self, text):
        self.messages.append(text)


class Found:
    """What a solver has found: metal everywhere or nowhere."""

    metal_gain = 0.7
    with_metal = 60.0  # total error with metal

    def __init__(self, metal):
        self.metallic = torch.full((10,), float(metal))

    def total_error(self):
        return self.with_metal if self.metallic.any() else 100.0


@pytest.fixture
def tried(monkeypatch):
    """Whether each solver searches for metal; each solver finds it everywhere if it may, with `Found.metal_gain`."""
    calls = []

    def solver(inputs, search_metal, progress):
        calls.append(search_metal)
        return Found(search_metal)

    monkeypatch.setattr(light_materials, "_solve_from_first_stage", solver)
    return calls


@pytest.mark.parametrize(
    ("masked", "glossy", "expected"),
    [
        (True, True, [True]),
        (True, False, [True, False]),  # the first stage would have found reflections on so much metal
        (False, False, [False]),
        (False, True, [True]),  # only if the user sets the materials
    ],
)
def test_what_may_be_metal(sphere, sphere_dataset, camera_ring, tried, masked, glossy, expected):
    make, surface = sphere
    listener = Listener()
    light_materials.solve_light_materials(make(glossy), surface, sphere_dataset(camera_ring(12, size=48), masked), SETTINGS, listener)
    assert tried == expected
    assert sum("none of it is metal" in text for text in listener.messages) == len(expected) - 1


@pytest.mark.parametrize(
    ("flash", "error", "words", "expected"),
    [
        (True, 88.0, "metal explains 12% of the error: none of it is metal", 0),
        (True, 82.0, "18% of the error: metal is kept", 1),
        (False, 88.0, "12% of the error: metal is kept", 1),
        (False, 96.0, "4% of the error: none of it is metal", 0),
    ],
)
def test_an_object_is_metal_only_by_clear_evidence(sphere, sphere_dataset, camera_ring, tried, monkeypatch, flash, error, words, expected):
    """A camera's flash makes an object look a little like metal."""
    make, surface = sphere
    monkeypatch.setattr(Found, "metal_gain", 0.15)
    monkeypatch.setattr(Found, "with_metal", error)
    monkeypatch.setattr(light_materials, "radiance_slope", lambda *_: 1.3 if flash else 0.0)
    listener = Listener()
    solved, _ = light_materials.solve_light_materials(make(True), surface, sphere_dataset(camera_ring(12, size=48)), SETTINGS, listener)
    assert tried == [True, False] and any(words in text for text in listener.messages)
    assert float(solved.metallic.mean()) == expected


@pytest.mark.parametrize(("flash", "clipped", "lit"), [(1.0, False, True), (0.7, False, True), (0.0, False, False), (1.0, True, False)])
def test_light_at_the_camera_is_told_by_samples_that_are_not_clipped(flash, clipped, lit):
    """Points of a sphere of random albedo, under a flash, or partly or all under a light from everywhere."""
    random, views = np.random.default_rng(0), 12
    normal = unit_vectors(random.normal(size=(400, 3))).repeat(views, 0)
    view = unit_vectors(normal + 0.8 * unit_vectors(random.normal(size=normal.shape)))
    radiance = (1 - flash + flash * (normal * view).sum(-1)) * random.uniform(0.2, 0.8, 400).repeat(views)
    place, towards, colour = (torch.tensor(part, dtype=torch.float32) for part in (normal[::views], view, np.stack([radiance] * 3, -1)))
    point = torch.arange(400).repeat_interleave(views)
    samples = MultiViewSamples(place, place, point, towards, colour, torch.full(colour.shape, clipped))
    assert light_materials._is_lit_from_camera(samples) is lit


def unit_vectors(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_metal_that_the_first_stage_found_too_is_not_doubted(sphere, sphere_dataset, camera_ring, tried, monkeypatch):
    make, surface = sphere
    monkeypatch.setattr(Found, "metal_gain", 0.15)
    dataset = sphere_dataset(camera_ring(12, size=48))
    metal = make(True).gaussians.select(slice(None))
    metal.material = torch.full_like(metal.material, 3.0)
    light_materials.solve_light_materials(replace(make(True), gaussians=metal), surface, dataset, SETTINGS, Listener())
    assert tried == [True]


@pytest.mark.parametrize("search_metal", [True, False])
def test_none_of_it_starts_as_metal_where_none_may_be(sphere, sphere_dataset, camera_ring, monkeypatch, search_metal):
    """Though the first stage took the object for metal."""
    make, surface = sphere
    metal = make(search_metal).gaussians.select(slice(None))
    metal.material = torch.full_like(metal.material, 3.0)

    def started(samples, transfer, roughness, metallic, *_):
        assert (metallic == float(search_metal)).all()
        raise Cancelled("seen")

    monkeypatch.setattr(light_materials, "LightMaterialSolver", started)
    dataset = sphere_dataset(camera_ring(12, size=48), search_metal)
    with pytest.raises(Cancelled, match="seen"):
        light_materials.solve_light_materials(replace(make(search_metal), gaussians=metal), surface, dataset, SETTINGS, Silent())


@pytest.mark.parametrize(("dark_error", "is_dark"), [(0.9, True), (0.98, False), (1.1, False)])
def test_what_both_starts_end_with_decides_whether_an_object_is_dark(sphere, sphere_dataset, camera_ring, monkeypatch, dark_error, is_dark):
    """A hammer with a steel head looked dark in the first steps, before its metal was known."""
    make, surface = sphere

    def started(solver, split, on_step, try_dark):
        if try_dark:
            solver.start_dark()
        return solver

    monkeypatch.setattr(light_materials, "run_solver", started)
    error = lambda self: dark_error if self.start_albedo < 0.5 else 1.0  # noqa: E731
    monkeypatch.setattr(light_materials.LightMaterialSolver, "total_error", error)
    listener = Listener()
    dataset = sphere_dataset(camera_ring(12, size=48))
    solved, _ = light_materials.solve_light_materials(make(True), surface, dataset, SETTINGS, listener)
    assert (solved.start_albedo < 0.5) == is_dark
    assert any("a dark object" in text for text in listener.messages) == is_dark


def test_too_few_views_are_one_clear_line(sphere, sphere_dataset, camera_ring):
    make, surface = sphere
    with pytest.raises(IrgsppError, match=r"only \d+ points .* three photographs") as error:
        light_materials.solve_light_materials(make(), surface, sphere_dataset(camera_ring(2, size=48)), SETTINGS, Silent())
    assert error.value.exit_status == 1 and "\n" not in str(error.value)
