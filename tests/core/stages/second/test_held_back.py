# SPDX-License-Identifier: GPL-3.0-or-later
"""Views that judge a refinement are left out of what comes before it."""

import pytest
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.second import solve as module
from irgspp.core.stages.second.held_back import MIN_VIEWS, held_back, without_held_back


def test_one_of_sixteen_views_is_held_back_and_one_of_fewer():
    assert not held_back(MIN_VIEWS - 1).any()
    for count, expected in ((MIN_VIEWS, [4]), (10, [5]), (16, [8]), (48, [8, 24, 40])):
        assert held_back(count).nonzero().flatten().tolist() == expected


def test_the_other_views_keep_their_order(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(10, size=16))
    expected = [view for number, view in enumerate(dataset.train) if number != 5]
    assert all(one is other for one, other in zip(without_held_back(dataset).train, expected, strict=True))
    assert len(dataset.train) == 10


@pytest.mark.parametrize(("words", "seen"), [([], 9), (["iterations=0"], 10), (["iterations=0", "solver=closed+joint"], 9)])
def test_the_solver_sees_held_back_views_only_where_nothing_is_refined(sphere, sphere_dataset, camera_ring, monkeypatch, words, seen):
    make, surface = sphere

    def stop(reconstruction, surface, dataset, *_):
        assert len(dataset.train) == seen
        raise Cancelled("enough")

    monkeypatch.setattr(module, "solve_light_materials", stop)
    settings = with_overrides(Settings(), [f"second.{word}" for word in words])
    with pytest.raises(Cancelled, match="enough"):
        module.solve_in_closed_form(make(), surface, sphere_dataset(camera_ring(10, size=16)), settings, Silent())


def test_normals_and_painting_do_not_see_them_either(sphere, sphere_dataset, camera_ring, monkeypatch):
    make, surface = sphere
    dataset, counts = sphere_dataset(camera_ring(10, size=16)), []

    class Solver:
        is_all_metal = False

    def improve(reconstruction, surface, solver, tracer, dataset, *_):
        counts.append(len(dataset.train))
        return reconstruction, surface, None

    def paint(reconstruction, surface, views, *_, **options):
        counts.append(len(views))
        raise Cancelled("enough")

    monkeypatch.setattr(module, "solve_light_materials", lambda *_: (Solver, None))
    monkeypatch.setattr(module, "improve_normals", improve)
    monkeypatch.setattr(module, "assign_materials", paint)
    with pytest.raises(Cancelled, match="enough"):
        module.solve_in_closed_form(make(), surface, dataset, Settings(), Silent())
    assert counts == [9, 9]
