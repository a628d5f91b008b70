# SPDX-License-Identifier: GPL-3.0-or-later
"""Second stage: where metal is searched, and errors where it cannot be solved."""

import time
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import torch
from irgspp.core.errors import Cancelled, IrgsppError
from irgspp.core.kernels.trace import transmittance
from irgspp.core.progress.protocol import Silent
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.surface import Surface
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.second import solve as transport
from scipy.spatial import ConvexHull

SETTINGS = with_overrides(Settings(), ["second.points=150", "second.rows=4"])
SPHERE = Bound((0.0, 0.0, 0.0), 1.5)


@dataclass
class Listener(Silent):
    """Progress that records messages."""

    messages: list[str] = field(default_factory=list)

    def message(self, text):
        self.messages.append(text)


@pytest.fixture(scope="module")
def sphere(splat_sphere):
    """Function that makes a reconstruction of the unit sphere (glossy or not), and the surface."""
    splats = splat_sphere(3000, opacity=0.999)
    points = splats.position.T.double().numpy()
    faces = ConvexHull(points).simplices

    def make(glossy=False, background=None):
        return Reconstruction(splats, torch.ones(8, 16, 3), SPHERE, np.eye(4), glossy, background)

    return make, Surface(points, points, faces, 0.05)


class Found:
    """What a solver has found: metal everywhere or nowhere."""

    metal_gain = 0.7
    with_metal = 60.0  # total error with metal

    def __init__(self, metal):
        self.metallic = torch.full((10,), float(metal))

    @property
    def is_mostly_metal(self):
        return bool(self.metallic.all())

    def total_error(self):
        return self.with_metal if self.metallic.any() else 100.0


@pytest.fixture
def tried(monkeypatch):
    """Whether each solver searches for metal; each solver finds it everywhere if it may, with `Found.metal_gain`."""
    calls = []

    def solver(reconstruction, seen, transfer, tracer, settings, progress, search_metal):
        calls.append(search_metal)
        return Found(search_metal)

    monkeypatch.setattr(transport, "_solve_from_first_stage", solver)
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
    transport.solve_light_materials(make(glossy), surface, sphere_dataset(camera_ring(12, size=48), masked), SETTINGS, listener)
    assert tried == expected
    assert sum("none of it is metal" in text for text in listener.messages) == len(expected) - 1


def test_an_object_is_metal_only_by_clear_evidence(sphere, sphere_dataset, camera_ring, tried, monkeypatch):
    """A camera's flash makes an object look a little like metal."""
    make, surface = sphere
    monkeypatch.setattr(Found, "metal_gain", 0.15)
    dataset = sphere_dataset(camera_ring(12, size=48))
    cases = ((88.0, "metal explains 12% of the error: none of it is metal", 0), (70.0, "30% of the error: all of it is metal", 1))
    for error, words, expected in cases:
        monkeypatch.setattr(Found, "with_metal", error)
        tried.clear()
        listener = Listener()
        solved, _ = transport.solve_light_materials(make(True), surface, dataset, SETTINGS, listener)
        assert tried == [True, False] and any(words in text for text in listener.messages)
        assert float(solved.metallic.mean()) == expected
    metal = make(True).gaussians.select(slice(None))
    metal.material = torch.full_like(metal.material, 3.0)
    transport.solve_light_materials(replace(make(True), gaussians=metal), surface, dataset, SETTINGS, Listener())
    assert tried == [True, False, True]  # the first stage has found it, too


@pytest.mark.parametrize("search_metal", [True, False])
def test_none_of_it_starts_as_metal_where_none_may_be(sphere, sphere_dataset, camera_ring, monkeypatch, search_metal):
    """Though the first stage took the object for metal."""
    make, surface = sphere
    metal = make(search_metal).gaussians.select(slice(None))
    metal.material = torch.full_like(metal.material, 3.0)

    def started(samples, transfer, roughness, metallic, *_):
        assert (metallic == float(search_metal)).all()
        raise Cancelled("seen")

    monkeypatch.setattr(transport, "LightMaterialSolver", started)
    dataset = sphere_dataset(camera_ring(12, size=48), search_metal)
    with pytest.raises(Cancelled, match="seen"):
        transport.solve_light_materials(replace(make(search_metal), gaussians=metal), surface, dataset, SETTINGS, Silent())


@pytest.mark.parametrize(("dark_error", "is_dark"), [(0.9, True), (1.1, False)])
def test_what_both_starts_end_with_decides_whether_an_object_is_dark(sphere, sphere_dataset, camera_ring, monkeypatch, dark_error, is_dark):
    """A hammer with a steel head looked dark in the first steps, before its metal was known."""
    make, surface = sphere

    def started(solver, split, on_step, try_dark):
        if try_dark:
            solver.start_dark()

    monkeypatch.setattr(transport, "run_solver", started)
    error = lambda self: dark_error if self.start_albedo < 0.5 else 1.0  # noqa: E731
    monkeypatch.setattr(transport.LightMaterialSolver, "total_error", error)
    listener = Listener()
    dataset = sphere_dataset(camera_ring(12, size=48))
    solved, _ = transport.solve_light_materials(make(True), surface, dataset, SETTINGS, listener)
    assert (solved.start_albedo < 0.5) == is_dark
    assert any("a dark object" in text for text in listener.messages) == is_dark


def test_too_few_views_are_one_clear_line(sphere, sphere_dataset, camera_ring):
    make, surface = sphere
    with pytest.raises(IrgsppError, match=r"only \d+ points .* three photographs") as error:
        transport.solve_light_materials(make(), surface, sphere_dataset(camera_ring(2, size=48)), SETTINGS, Silent())
    assert error.value.exit_status == 1 and "\n" not in str(error.value)


def test_a_backdrop_is_part_of_the_light_but_hides_what_is_behind(sphere):
    """Surfels outside the bound: rays from the surface pass them, but they hide the surface from a camera behind them."""
    make, _ = sphere
    wall = make().gaussians.select(slice(None))
    wall.position = 3 * wall.position  # a shell around the sphere
    wall.log_scale = wall.log_scale + np.log(3)
    both = make().gaussians.joined(wall)
    origin = torch.tensor([[0.0, 0.0, 1.1], [1.1, 0.0, 0.0]])
    direction = torch.nn.functional.normalize(origin, dim=1)
    for background, free in ((None, 0.0), (torch.ones(4, 8, 3), 1.0)):
        tracer = SecondaryTracer(replace(make(), gaussians=both, background=background))
        passed, radiance = tracer.look(origin, direction)
        assert torch.allclose(passed, torch.full((2,), free), atol=0.02)
        assert torch.allclose(radiance, torch.full((2, 3), 0.5 * (1 - free)), atol=0.02)
        assert float(transmittance(tracer.tree, origin, direction).max()) < 0.02


@pytest.mark.parametrize(("solver", "expected"), [("closed", ["closed"]), ("joint", ["joint"]), ("closed+joint", ["closed", "refined"])])
def test_the_setting_chooses_the_solver(sphere, sphere_dataset, camera_ring, monkeypatch, solver, expected):
    make, surface = sphere
    called, deadlines = [], []

    def stand_in(name, result):
        def solve(start, *rest):
            called.append(name)
            deadlines.append(next(one for one in rest if isinstance(one, float)))
            return result, 0.5

        return solve

    first, results = make(), {name: make() for name in ("closed", "joint", "refined")}
    monkeypatch.setattr(transport, "solve_in_closed_form", stand_in("closed", results["closed"]))
    monkeypatch.setattr(transport, "optimise_jointly", stand_in("joint", results["joint"]))
    monkeypatch.setattr(transport, "refine_jointly", stand_in("refined", results["refined"]))
    dataset = sphere_dataset(camera_ring(2, size=16))
    settings = with_overrides(SETTINGS, [f"second.solver={solver}"])
    deadline = time.monotonic() + 100
    result, scale = transport.solve_second_stage(first, surface, dataset, settings, Silent(), deadline)
    assert called == expected and result is results[expected[-1]] and scale == 0.5
    assert deadlines[-1] == deadline
    if len(expected) == 2:
        assert deadlines[0] == pytest.approx(deadline - 50, abs=1)  # half of what is left


def test_materials_are_assigned_by_the_pixels_that_turned_surfels_cover(sphere, sphere_dataset, camera_ring, tried, monkeypatch):
    make, surface = sphere
    traced = []

    def turn(reconstruction, surface, solver, tracer, *_):
        g = reconstruction.gaussians
        turned = replace(g, log_scale=g.log_scale - 3.0)  # as far as rays go, like surfels seen from the side
        traced.append(tracer)
        return replace(reconstruction, gaussians=turned), surface

    def stop(gaussians, surface, views, tracer, *_, **options):
        traced.append(tracer)
        raise Cancelled("enough")

    monkeypatch.setattr(transport, "improve_normals", turn)
    monkeypatch.setattr(transport, "assign_materials", stop)
    with pytest.raises(Cancelled):
        transport.solve_in_closed_form(make(), surface, sphere_dataset(camera_ring(12, size=48), False), SETTINGS, Silent())
    ahead = torch.tensor([[0.0, 0.1, 4.0]]), torch.tensor([[0.0, 0.0, -1.0]])
    before, after = (float(tracer.look(*ahead)[0]) for tracer in traced)
    assert before < 0.05 and after > 0.5
