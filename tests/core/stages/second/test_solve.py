# SPDX-License-Identifier: GPL-3.0-or-later
"""Second stage: the order of its steps, and what its solver setting chooses."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.errors import Cancelled
from irgspp.core.kernels.trace import transmittance
from irgspp.core.progress.protocol import Silent
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.second import solve as transport

SETTINGS = with_overrides(Settings(), ["second.points=150", "second.rows=4"])


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
            return transport.SecondStageResult(result, 0.5, surface) if name == "closed" else (result, 0.5)

        return solve

    first, results = make(), {name: make() for name in ("closed", "joint", "refined")}
    monkeypatch.setattr(transport, "solve_in_closed_form", stand_in("closed", results["closed"]))
    monkeypatch.setattr(transport, "optimise_jointly", stand_in("joint", results["joint"]))
    monkeypatch.setattr(transport, "refine_jointly", stand_in("refined", results["refined"]))
    dataset = sphere_dataset(camera_ring(2, size=16))
    settings = with_overrides(SETTINGS, [f"second.solver={solver}"])
    deadline = time.monotonic() + 100
    result = transport.solve_second_stage(first, surface, dataset, settings, Silent(), deadline)
    assert called == expected and result.reconstruction is results[expected[-1]] and result.schedule_scale == 0.5
    assert result.surface is (surface if solver == "closed" else None)  # the surface of moved surfels is another one
    assert deadlines[-1] == deadline
    if len(expected) == 2:
        assert deadlines[0] == pytest.approx(deadline - 50, abs=1)  # half of what is left


def test_materials_are_assigned_by_the_pixels_that_turned_surfels_cover(sphere, sphere_dataset, camera_ring, monkeypatch):
    make, surface = sphere
    traced, relief = [], np.ones(len(surface.vertices))

    def turn(reconstruction, surface, solver, tracer, *_):
        g = reconstruction.gaussians
        turned = replace(g, log_scale=g.log_scale - 3.0)  # as far as rays go, like surfels seen from the side
        traced.append(tracer)
        return replace(reconstruction, gaussians=turned), surface, relief

    def stop(gaussians, surface, views, tracer, *_, **options):
        traced.append(tracer)
        assert options["relief"] is relief
        raise Cancelled("enough")

    def solved(reconstruction, *_):
        return SimpleNamespace(is_all_metal=False), SecondaryTracer(reconstruction)

    monkeypatch.setattr(transport, "solve_light_materials", solved)
    monkeypatch.setattr(transport, "improve_normals", turn)
    monkeypatch.setattr(transport, "assign_materials", stop)
    with pytest.raises(Cancelled):
        transport.solve_in_closed_form(make(), surface, sphere_dataset(camera_ring(12, size=48), False), SETTINGS, Silent())
    ahead = torch.tensor([[0.0, 0.1, 4.0]]), torch.tensor([[0.0, 0.0, -1.0]])
    before, after = (float(tracer.look(*ahead)[0]) for tracer in traced)
    assert before < 0.05 and after > 0.5
