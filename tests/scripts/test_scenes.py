# SPDX-License-Identifier: GPL-3.0-or-later
"""The small scenes are of the kinds that they stand for, and the built-in scenes' shapes are closed and within their radius."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from irgspp.core.datasets.load import load_dataset
from irgspp.core.evaluation.ground_truth import load_scene_truth, load_truth
from small_scenes import NAMES, SCENES, small_scene

ROOT = Path(__file__).resolve().parents[2]
SHAPES = """
import json, sys
sys.path.insert(0, sys.argv[1])
import bpy  # before bmesh
import bmesh, numpy as np
from scenes import catalogue, cycles_ground_truth, print_scene, relief_scene
smaller = {"relief": lambda: relief_scene.build_relief_scene(5), "print": lambda: print_scene.build_print_scene(128, 64)}
builders = {**catalogue.SCENES, **smaller}
shapes = {}
for name, build in builders.items():
    things = build()
    corners = cycles_ground_truth.world_triangles(bpy.context.scene)
    shape, open_edges = bmesh.new(), 0
    for thing in things[:1]:
        shape.from_mesh(thing.data)
    shapes[name] = {
        "things": len(things),
        "radius": float(np.linalg.norm(corners.reshape(-1, 3), axis=-1).max()),
        "open": sum(len(edge.link_faces) != 2 for edge in shape.edges),
        "volume": shape.calc_volume(signed=True),
    }
print("SHAPES", json.dumps(shapes))
"""


@pytest.fixture(scope="module")
def shapes(tmp_path_factory):
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path_factory.mktemp("blender"))}
    words = [sys.executable, "-c", SHAPES, str(ROOT / "scripts")]
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.rpartition("SHAPES ")[2])


def test_built_in_scenes_fit_the_cameras_and_their_surfaces_are_closed(shapes):
    assert {"demo", "low-gloss", "glossy", "print", "thin", "vase", "glazed-vase", *NAMES} == set(shapes)
    assert all(shape["radius"] < 1.3 for shape in shapes.values())
    for name in (*NAMES, "print", "thin", "vase", "glazed-vase"):
        assert shapes[name]["open"] == 0 and shapes[name]["volume"] > (0.05 if name == "thin" else 0.3), name
    assert shapes["bowl"]["things"] == 4 and shapes["relief"]["things"] == 1


@pytest.mark.parametrize("name", NAMES)
def test_small_scenes_have_all_layers(name):
    dataset = load_dataset(small_scene(name))
    scene = load_scene_truth(small_scene(name), dataset.to_world)
    assert (len(dataset.train), len(dataset.test), len(scene.lights)) == (20, 4, 2)
    assert scene.points is not None and len(scene.points[0]) == 1000
    for view in dataset.test:
        truth = load_truth(view, scene, dataset.to_world)
        assert truth.object.mean() > 0.1 and set(truth.relit) == {"sunset"}
        assert np.isfinite(truth.depth[truth.object]).all() and np.isfinite(truth.normal[truth.object]).all()
        bright = view.colour[view.alpha > 0.99].mean()
        assert 0.05 < bright < 0.8


def test_small_scenes_are_small():
    for name in NAMES:
        assert sum(file.stat().st_size for file in small_scene(name).rglob("*") if file.is_file()) < 300_000
    assert {path.name for path in SCENES.iterdir() if path.is_dir()} == set(NAMES)


def test_views_from_above_alone_see_into_the_bowl():
    dataset = load_dataset(small_scene("bowl"))
    scene = load_scene_truth(small_scene("bowl"), dataset.to_world)
    fractions = []
    for view in sorted(dataset.test, key=lambda view: -view.camera.centre[2]):
        truth = load_truth(view, scene, dataset.to_world)
        axis = (view.camera.centre + truth.depth[..., None] * view.camera.rays().astype(float)) * [1, 1, 0]
        inwards = (truth.normal * axis).sum(-1) < -0.05
        fractions.append((inwards & truth.object).sum() / truth.object.sum())
    assert fractions[0] > 0.3 and fractions[-1] == 0.0


def test_pits_of_the_relief_lie_inside_the_visual_hull():
    dataset = load_dataset(small_scene("relief"))
    scene = load_scene_truth(small_scene("relief"), dataset.to_world)
    points = scene.points[0]
    nearest = np.full(len(points), np.inf)  # distance to the background in any view
    for view in dataset.train:
        pixel, depth = view.camera.project(points)
        away = cv2.distanceTransform((view.alpha > 0.5).astype(np.uint8), cv2.DIST_L2, 5)
        column, row = np.clip(pixel, 0, np.array(away.shape[::-1]) - 1).astype(int).T
        nearest = np.minimum(nearest, away[row, column] * depth / view.camera.fx)
    assert (nearest > 0.1).mean() > 0.08 and nearest.max() > 0.25  # the stone's radius is 1.2
