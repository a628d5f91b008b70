# SPDX-License-Identifier: GPL-3.0-or-later
"""Start on dense stereo: an open, textured bowl, which no silhouette shows to be hollow."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.datasets.visual_hull import visual_hull
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.dataset import PointCloud
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.first import stereo_initialization
from irgspp.core.stages.first.depth_evidence import DepthEvidence
from irgspp.core.stages.first.initialization import from_hull, initial_gaussians
from irgspp.core.stages.first.material_class import LOW_GLOSS, METAL
from irgspp.core.stages.first.start_selection import select_start
from irgspp.core.stages.first.start_trials import StartTrials
from irgspp.core.stages.first.stereo_initialization import from_stereo
from irgspp.core.stereo.fusion import OrientedPoints
from open_bowl import bowl, guessed_inside
from scipy.spatial import cKDTree

COUNT = 3000


@pytest.fixture(scope="module")
def dataset():
    return bowl()


@pytest.fixture(scope="module")
def start(dataset):
    return from_stereo(dataset, COUNT, 0, Silent())[-1].gaussians


class Decisions(Silent):
    """Progress that keeps the decisions."""

    def __init__(self):
        self.found = {}

    def decided(self, rule, on, evidence):
        self.found[rule] = on, evidence


def lid(gaussians):
    """Share of surfels far inside the bowl, where the hull closes it."""
    return float((gaussians.position.norm(dim=0) < 0.85).float().mean())


def test_stereo_opens_the_hollow_that_the_hull_closes(dataset, start):
    assert lid(from_hull(dataset, COUNT, np.random.default_rng(0))) > 0.1
    assert lid(start) < 0.02
    assert COUNT / 2 < start.count <= COUNT
    distance = (start.position.norm(dim=0) - 1).abs()
    assert float((distance < 0.04).float().mean()) > 0.9


def test_surfels_face_the_side_that_is_seen(dataset, start):
    points, normals = start.position.T.numpy(), start.normals().T.numpy()
    inner = (points[:, 2] < -0.3) & ((points * normals).sum(1) < 0)  # the inside of the bowl, which faces its middle
    assert inner.sum() > 0.2 * len(points)
    assert np.quantile(-(points * normals).sum(1)[inner], 0.2) > 0.85


def test_same_seed_same_start(dataset, start):
    again = from_stereo(dataset, COUNT, 0, Silent())[-1].gaussians
    assert all(a.equal(b) for a, b in zip(start.tensors().values(), again.tensors().values(), strict=True))


def test_hull_depth_is_where_the_rays_enter_and_leave(sphere_dataset, camera_ring):
    spheres = sphere_dataset(camera_ring(12))
    hull = visual_hull(spheres.train, spheres.bound)
    (enter, leave), camera = hull.depths([spheres.train[0].camera])[0], spheres.train[0].camera
    middle = camera.height // 2, camera.width // 2
    distance = np.linalg.norm(camera.centre)
    assert distance - 1 - 0.35 < enter[middle] <= distance - 1 + hull.step  # the hull of few views is larger than the sphere
    assert distance + 1 - hull.step <= leave[middle] < distance + 1 + 0.35
    assert enter[0, 0] == 0
    assert leave[0, 0] == 0


def test_without_masks_points_and_few_others_are_the_start():
    posed = bowl(masked=False)
    g = from_stereo(posed, COUNT, 0, Silent())[0].gaussians
    near = (g.position.norm(dim=0) - 1).abs() < 0.05
    assert int(near.sum()) > 0.3 * COUNT
    assert g.count <= COUNT


def test_textureless_object_has_no_stereo_start():
    assert from_stereo(bowl(textured=False, count=10, size=48), COUNT, 0, Silent()) is None


@pytest.mark.parametrize("turning", [False, True])
def test_brightness_counts_unless_the_light_turns(dataset, monkeypatch, turning):
    class Asked(Exception):
        pass

    def ask(views, nearest, farthest, points, settings, *_):
        assert (settings.brightness == 0) == turning
        raise Asked

    monkeypatch.setattr(stereo_initialization, "estimate_depth_maps", ask)
    views = [replace(view, light_rotation=np.eye(3)) for view in dataset.train] if turning else dataset.train
    with pytest.raises(Asked):
        from_stereo(replace(dataset, train=views), COUNT, 0, Silent())


def test_a_hollow_is_a_region_where_stereo_is_better(dataset):
    """The lid is given to stereo, the outside of the bowl, which the hull touches, may keep the hull."""
    settings = with_overrides(preset("draft"), [f"first.gaussians={COUNT}"])
    plain, progress = initial_gaussians(dataset, COUNT, np.random.default_rng(0)), Decisions()
    chosen = select_start(plain, StartTrials(dataset, settings, LOW_GLOSS), progress).gaussians
    on, evidence = progress.found["stereo"]
    assert on
    assert "% of the surfels" in evidence
    assert lid(plain) > 0.1
    assert lid(chosen) < 0.02


def same_depths(monkeypatch):
    """Take the hull's depths for stereo's."""

    def same(cls, views, bound, depths, *rest):
        return collect(views, bound, (depths[0], depths[0]), *rest)

    collect = DepthEvidence.collect
    monkeypatch.setattr(DepthEvidence, "collect", classmethod(same))


def test_an_object_without_a_better_region_has_no_stereo_start(dataset, monkeypatch):
    same_depths(monkeypatch)
    assert from_stereo(dataset, COUNT, 0, Silent()) == []


def test_few_better_regions_are_the_only_start(dataset, monkeypatch):
    names = lambda: [one.name for one in from_stereo(dataset, COUNT, 0, Silent())]  # noqa: E731
    assert names() == ["stereo by regions", "stereo everywhere"]
    monkeypatch.setattr(stereo_initialization, "MIN_REGION_SHARE", 1.0)
    assert names() == ["stereo by regions"]


def test_open_gaps_leave_out_the_hull_where_stereo_guesses_that_it_is_hollow(dataset, monkeypatch):
    monkeypatch.setattr(stereo_initialization, "estimate_depth_maps", guessed_inside)
    everywhere = lambda dataset, found, depth, other: (np.ones(len(found.points.position), bool), np.zeros(len(other), bool), 1.0)  # noqa: E731
    monkeypatch.setattr(stereo_initialization, "_regions", everywhere)
    for closed in from_stereo(dataset, COUNT, 0, Silent()):
        opened = closed.opened()
        assert opened.name == f"{closed.name} with open gaps"
        assert lid(closed.gaussians) > 0.1
        assert lid(opened.gaussians) < 0.2 * lid(closed.gaussians)
        assert opened.share > closed.share
        assert opened.gaussians.count <= COUNT


def guessed_by_half(views, *_):
    """Depth maps of stereo that guesses the inside of the bowl in every other view, and finds nothing there in the others."""
    maps = guessed_inside(views)
    return [replace(one, depth=np.where(one.support == 1, 0, one.depth)) if k % 2 else one for k, one in enumerate(maps)]


def test_gaps_stay_closed_where_only_half_of_the_views_look_through(dataset, monkeypatch):
    monkeypatch.setattr(stereo_initialization, "estimate_depth_maps", guessed_by_half)
    assert [closed.opened() for closed in from_stereo(dataset, COUNT, 0, Silent(), everywhere=True)] == [None]


def confirmed_inside(views, *_):
    """Exact depth maps of the bowl, with which other views agree everywhere."""
    return [replace(one, support=np.where(one.support == 1, 5, one.support)) for one in guessed_inside(views)]


def test_open_gaps_hold_all_that_stereo_found_there(dataset, monkeypatch):
    monkeypatch.setattr(stereo_initialization, "estimate_depth_maps", confirmed_inside)
    # Nowhere in the hollow do the photographs agree better at stereo's depth than at the lid, as where there is no texture.
    outside = lambda dataset, found, depth, other: (found.points.position[:, 2] > 0, np.ones(len(other), bool), 0.1)  # noqa: E731
    monkeypatch.setattr(stereo_initialization, "_regions", outside)
    (closed,) = from_stereo(dataset, COUNT, 0, Silent())
    inside = [float(((s.gaussians.position * s.gaussians.normals()).sum(0) < -0.85).float().mean()) for s in (closed, closed.opened())]
    assert lid(closed.gaussians) > 0.1 and lid(closed.opened().gaussians) < 0.02
    assert inside[1] > inside[0] + 0.2


def test_better_regions_that_are_no_pixel_off_the_hull_are_no_stereo_start(dataset, monkeypatch):
    settings = with_overrides(preset("draft"), [f"first.gaussians={COUNT}"])
    monkeypatch.setattr(stereo_initialization, "pixel_size", lambda dataset: 10.0)
    plain, progress = initial_gaussians(dataset, COUNT, np.random.default_rng(0)), Decisions()
    assert select_start(plain, StartTrials(dataset, settings, LOW_GLOSS), progress).gaussians is plain
    on, evidence = progress.found["stereo"]
    assert not on
    assert "in no region" in evidence


def test_share_is_that_of_the_surfels_on_points_of_stereo(dataset, monkeypatch):
    """Regions are divided at the middle: on one side all points are stereo's, on the other the hull's."""
    hull = visual_hull(dataset.train, dataset.bound).sample(COUNT, np.random.default_rng(0))[0]
    split = lambda dataset, found, depth, other: (found.points.position[:, 0] > 0, other[:, 0] <= 0, 0.5)  # noqa: E731
    monkeypatch.setattr(stereo_initialization, "_regions", split)
    start = from_stereo(dataset, COUNT, 0, Silent())[0]
    on_hull = cKDTree(hull).query(start.gaussians.position.T.numpy())[0] < 1e-6
    assert 0.3 < start.share < 0.8
    assert start.share == pytest.approx(1 - on_hull.mean(), abs=1e-3)


@pytest.mark.parametrize(("overrides", "material_class", "why"), [([], METAL, "reflections"), (["first.stereo=off"], LOW_GLOSS, "as set")])
def test_plain_start_without_a_trial(dataset, overrides, material_class, why):
    plain, progress = initial_gaussians(dataset, 100, np.random.default_rng(0)), Decisions()
    assert (
        select_start(plain, StartTrials(dataset, with_overrides(preset("draft"), overrides), material_class), progress).gaussians is plain
    )
    on, evidence = progress.found["stereo"]
    assert not on
    assert why in evidence


def test_few_photographs_keep_the_sparse_points():
    few = bowl(masked=False, count=5, size=32)
    few = replace(few, points=PointCloud(np.zeros((30, 3), np.float32), np.zeros((30, 3), np.float32)))
    plain, progress = initial_gaussians(few, 100, np.random.default_rng(0)), Decisions()
    assert select_start(plain, StartTrials(few, preset("draft"), LOW_GLOSS), progress).gaussians is plain
    assert "5 photographs" in progress.found["stereo"][1]


def test_false_points_before_a_textured_surface_start_no_surfels(monkeypatch):
    posed = bowl(masked=False)
    fuse = stereo_initialization.fuse_points

    def with_a_sheet(*arguments):
        points = fuse(*arguments)
        sheet = np.array([[0.05 * (i % 20) - 0.5, 0.05 * (i // 20) - 0.5, 0.9] for i in range(400)], np.float32)
        up, grey = np.tile(np.float32([0, 0, 1]), (400, 1)), np.full((400, 3), 0.5, np.float32)
        return points.joined(OrientedPoints(sheet, up, grey, np.ones(400, np.int32)))

    monkeypatch.setattr(stereo_initialization, "fuse_points", with_a_sheet)
    place = from_stereo(posed, COUNT, 0, Silent())[0].gaussians.position.T.numpy()
    on_sheet = (np.abs(place[:, :2]) < 0.5).all(1) & (np.abs(place[:, 2] - 0.9) < 0.02)
    assert on_sheet.sum() < 10
