# SPDX-License-Identifier: GPL-3.0-or-later
"""Datasets rendered from a scene agree with the scene's materials, light and geometry."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import warm_engine
from irgspp.core.datasets.load import load_dataset
from irgspp.core.evaluation.ground_truth import load_scene_truth, load_truth
from scripts_folder import script as script

ROOT = Path(__file__).resolve().parents[2]
SCENE = """
import bpy, sys
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
bpy.ops.mesh.primitive_uv_sphere_add(radius=0.5, location=(1, 2, 3), segments=64, ring_count=32)
bpy.ops.object.shade_smooth()
material = bpy.data.materials.new('plain')
material.use_nodes = True
inputs = material.node_tree.nodes['Principled BSDF'].inputs
inputs['Base Color'].default_value = (0.2, 0.4, 0.6, 1)
inputs['Roughness'].default_value, inputs['Metallic'].default_value = 0.7, 0.25
bpy.context.object.data.materials.append(material)
world = bpy.context.scene.world = bpy.data.worlds.new('grey')
world.use_nodes = True
world.node_tree.nodes['Background'].inputs['Color'].default_value = (0.5, 0.25, 0.125, 1)
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
"""


def run(*arguments: object, cwd: Path) -> subprocess.CompletedProcess:
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(cwd), "OMP_WAIT_POLICY": "PASSIVE"}
    command = [warm_engine.engine(sys.executable), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    assert run("-c", SCENE, folder / "ball.blend", cwd=folder).returncode == 0
    numbers = {"resolution": 40, "train": 3, "test": 2, "samples": 16, "light-height": 16, "points": 200}
    options = ["--relight", "studio", *(word for name, value in numbers.items() for word in (f"--{name}", value))]
    done = run(ROOT / "scripts" / "render_dataset.py", folder / "ball.blend", "-o", folder / "out", *options, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "out"


def test_layers_are_the_scenes_own_values(rendered):
    dataset = load_dataset(rendered)
    scene = load_scene_truth(rendered, dataset.to_world)
    assert list(scene.lights) == ["world", "studio"]
    assert np.allclose(scene.lights["world"], [0.5, 0.25, 0.125], atol=1e-3)
    centre = dataset.to_world[:3, :3] @ [1, 2, 3] + dataset.to_world[:3, 3]
    size = np.cbrt(np.linalg.det(dataset.to_world[:3, :3]))
    for view in dataset.test:
        truth = load_truth(view, scene, dataset.to_world)
        inside = truth.object
        assert inside.sum() > 100
        assert np.allclose(truth.albedo[inside], [0.2, 0.4, 0.6], atol=2e-3)
        assert np.allclose(truth.roughness[inside], 0.7, atol=2e-3) and np.allclose(truth.metallic[inside], 0.25, atol=2e-3)
        point = view.camera.centre + truth.depth[inside][:, None] * view.camera.rays().astype(float)[inside] - centre
        assert np.allclose(np.linalg.norm(point, axis=-1), 0.5 * size, atol=4e-3 * size)
        assert ((truth.normal[inside] * point).sum(-1) > 0.99 * 0.5 * size).all()


def test_a_grey_furnace_shows_no_more_light_than_there_is(rendered):
    dataset = load_dataset(rendered)
    for view in dataset.train:
        core = view.colour[view.alpha > 0.99]
        assert len(core) > 100
        # Every reflected ray sees the same light: radiance stays between diffuse albedo times it and all of it.
        assert (core[:, 0] < 0.74).all() and (core[:, 0] > 0.3).all()
        assert core.std(0).max() < 0.05


def test_surface_samples_lie_on_the_surface(rendered):
    with np.load(rendered / "surface_points.npz") as data:
        assert len(data["points"]) > 100
        away = data["points"] - np.array([1, 2, 3])
        assert np.allclose(np.linalg.norm(away, axis=-1), 0.5, atol=3e-3)
        assert ((data["normals"] * away).sum(-1) > 0.49).all()


def test_description_names_the_lights(rendered):
    meta = json.loads((rendered / "meta.json").read_text())
    assert (meta["train_light"], meta["relights"], meta["resolution"]) == ("world", ["studio"], [40, 40])
    assert not list(rendered.rglob("*.part*"))


def test_bad_input_ends_with_status_2_and_one_line(rendered, script, capsys):
    done = run(ROOT / "scripts" / "render_dataset.py", "-o", rendered, cwd=rendered.parent)
    assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1
    new = rendered.parent / "new"
    assert script("render_dataset").main(["no_such.blend", "-o", str(new)]) == 2
    assert capsys.readouterr().err == "no_such.blend: no such file\n"
    assert not new.exists()
