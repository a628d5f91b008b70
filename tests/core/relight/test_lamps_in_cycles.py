# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps of a Blender scene light the relighter's images as they light those of Cycles: radiometry, falloff, shadows, light bounced once."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.relight.primary_hits import PrimaryHits
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.relight.relighter import Relighter
from irgspp.core.scene.mesh import Mesh
from scripts_folder import scripts_on_path

pytest.importorskip("blender_side")  # before bpy: it gives this process a folder of its own for the user files of Blender
bpy = pytest.importorskip("bpy")
from irgspp.irgspp_addon.world.scene_lamps import is_lamp, scene_lamps  # noqa: E402
from mathutils import Vector  # noqa: E402

SAMPLES = 128  # per pixel, of both
BLACK = np.zeros((8, 16, 3), np.float32)
LAMPS = {
    "sun": ("SUN", (2.0, -1.0, 3.0), {"energy": 3.0, "angle": 0.3}),
    "sharp sun": ("SUN", (2.0, -1.0, 3.0), {"energy": 3.0, "angle": 0.0}),
    "point": ("POINT", (0.9, -0.9, 1.6), {"energy": 80.0, "shadow_soft_size": 0.2, "use_soft_falloff": False}),
    "soft point": ("POINT", (0.9, -0.9, 1.6), {"energy": 80.0, "shadow_soft_size": 0.2}),
    "sharp point": ("POINT", (0.9, -0.9, 1.6), {"energy": 80.0, "shadow_soft_size": 0.0}),
    "spot": ("SPOT", (0.8, -0.8, 2.0), {"energy": 200.0, "shadow_soft_size": 0.1, "spot_size": 0.7, "spot_blend": 0.4}),
    "area": ("AREA", (1.0, -1.0, 1.6), {"energy": 60.0, "shape": "RECTANGLE", "size": 0.6, "size_y": 0.3}),
    "disk": ("AREA", (1.0, -1.0, 1.6), {"energy": 60.0, "shape": "DISK", "size": 0.5, "spread": 1.2}),
    "near area": ("AREA", (0.0, 0.0, 1.4), {"energy": 20.0, "size": 1.0, "color": (1.0, 0.5, 0.2)}),
}


@pytest.fixture(scope="module")
def known():
    """Scene of known geometry in Cycles, and its module."""
    with scripts_on_path() as script:
        module = script("cycles_comparison.known_scene")
        yield SimpleNamespace(module=module, cycles=module.CyclesScene(BLACK))


def place_lamp(scene, kind, place, values):
    """Add a lamp that shines on the middle of the scene, in place of the former one."""
    for old in [thing for thing in scene.objects if thing.type == "LIGHT"]:
        bpy.data.objects.remove(old)
    data = bpy.data.lights.new("lamp", kind)
    for name, value in values.items():
        setattr(data, name, value)
    thing = bpy.data.objects.new("lamp", data)
    scene.collection.objects.link(thing)
    thing.location = place
    thing.rotation_euler = (Vector(place) - Vector((0.0, 0.0, 0.4))).to_track_quat("Z", "Y").to_euler()
    bpy.context.view_layer.update()


def mesh_of(module, sphere, square) -> Mesh:
    """The scene as one triangle mesh."""
    vertices, quads = module._sphere_mesh(128)
    half, n = module.HALF, len(vertices)
    corners = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], n + np.array([[0, 1, 2], [0, 2, 3]])])
    normals = np.concatenate([(vertices - [0, 0, module.HEIGHT]) / module.RADIUS, np.tile([0.0, 0.0, 1.0], (4, 1))])
    rows = np.repeat(np.array([[*s.albedo, s.roughness, s.metallic] for s in (sphere, square)], np.float32), [n, 4], 0)
    points = np.concatenate([vertices, corners]).astype(np.float32)
    uvs = np.zeros((n + 4, 2), np.float32)
    return Mesh(points, normals.astype(np.float32), uvs, faces.astype(np.int32), rows[:, :3], rows[:, 3], rows[:, 4])


def exact_surface(module, view, inner, query, sphere, square) -> PrimaryHits:
    """The points that the inner pixels see, exactly."""
    index = np.flatnonzero(inner)
    ray = view.rays().reshape(-1, 3)[index].astype(np.float64)
    on_sphere = module.first_hits(view).reshape(-1)[index] == 2
    eye = view.centre - np.array([0.0, 0.0, module.HEIGHT])
    a, b, c = (ray**2).sum(-1), ray @ eye, eye @ eye - module.RADIUS**2
    depth = np.where(on_sphere, (-b - np.sqrt(np.maximum(b * b - a * c, 0))) / a, -view.centre[2] / ray[:, 2])
    point = view.centre + depth[:, None] * ray
    normal = np.where(on_sphere[:, None], (point - [0, 0, module.HEIGHT]) / module.RADIUS, [0.0, 0.0, 1.0])
    rows = np.where(on_sphere[:, None], *(np.array([[*s.albedo, s.roughness, s.metallic]]) for s in (sphere, square)))
    tensors = [torch.from_numpy(v.astype(np.float32)) for v in (ray, -ray / np.sqrt(a)[:, None], point, depth, normal, rows)]
    ray, seen, point, depth, normal, rows = tensors
    ones = torch.ones(len(index))
    coverage = torch.from_numpy(inner.astype(np.float32))
    materials = (rows[:, :3].contiguous(), rows[:, 3].contiguous(), rows[:, 4].contiguous(), ones)
    surface = PrimaryHits(view, torch.from_numpy(index), ray, seen, point, depth, normal, *materials, coverage, point)
    return dataclasses.replace(surface, origin=point + 1e-4 * normal)


def both(known, lamp, bounces, sphere, square):
    """Return our radiance and Cycles', (P, 3) each, at the inner pixels."""
    module, scene = known.module, known.cycles.scene
    place_lamp(scene, *LAMPS[lamp])
    view = module.camera(48)
    inner = module.inner_pixels(module.first_hits(view), 1)
    theirs = known.cycles.render(view, sphere, square, bounces, SAMPLES)[inner][:, :3]
    query = MeshQuery(mesh_of(module, sphere, square), 1.0)
    gaussians = SimpleNamespace(opacity=torch.zeros(1), log_scale=torch.zeros(2, 1), materials=lambda: torch.zeros(5, 1))
    reconstruction = SimpleNamespace(gaussians=gaussians, environment=torch.zeros(1), brdf="principled")
    settings = RelightSettings(samples=SAMPLES, denoise="off", indirect=bounces > 0)
    relighter = Relighter(reconstruction, query, settings)  # type: ignore[arg-type]
    surface = exact_surface(module, view, inner, query, sphere, square)
    lamps = scene_lamps(scene.objects, None)
    estimate = relighter.reflected(surface, prepare_light(BLACK), lamps)
    return (estimate.diffuse + estimate.specular).numpy(), theirs


def assert_alike(ours, theirs, means: float, pixels: float, psnr: float) -> None:
    """Compare the means, the pixels' mean relative difference, and the PSNR at the brightest value of Cycles as peak, in dB."""
    error = ours.astype(np.float64) - theirs
    measured = -10 * np.log10((error**2).mean() / theirs.max() ** 2)
    found = (abs(ours.mean() / theirs.mean() - 1), np.abs(error).mean() / theirs.mean(), measured)
    print("means {:.4f} pixels {:.4f} PSNR {:.1f}".format(*found))
    assert found[0] < means and found[1] < pixels and found[2] > psnr, found


@pytest.mark.parametrize("lamp", LAMPS)
def test_direct_light_of_metals(known, lamp):
    """Both BRDFs are equal for metals, so that what is left is noise."""
    surface = known.module.Surface
    ours, theirs = both(known, lamp, 0, surface((0.8, 0.6, 0.4), 0.5, 1.0), surface((0.5, 0.6, 0.7), 0.5, 1.0))
    assert_alike(ours, theirs, 0.005, 0.04, 40)


@pytest.mark.parametrize("lamp", ["sun", "sharp point", "spot", "near area"])
def test_direct_light_of_dielectrics(known, lamp):
    """Gloss and the diffuse lobe below it are those of Principled, so that what is left is noise."""
    surface = known.module.Surface
    ours, theirs = both(known, lamp, 0, surface((0.8, 0.3, 0.2), 0.5), surface((0.5, 0.6, 0.7), 0.6))
    assert_alike(ours, theirs, 0.015, 0.04, 38)


@pytest.mark.parametrize("lamp", ["sun", "sharp point", "area"])
def test_light_that_is_reflected_once(known, lamp):
    surface = known.module.Surface
    surfaces = (surface((0.9, 0.4, 0.3), 0.8), surface((0.8, 0.8, 0.9), 0.8))
    direct, theirs_direct = both(known, lamp, 0, *surfaces)
    ours, theirs = both(known, lamp, 1, *surfaces)
    assert_alike(ours, theirs, 0.03, 0.04, 34)
    bounced = float((ours - direct).mean())
    assert bounced == pytest.approx(float((theirs - theirs_direct).mean()), rel=0.08) and bounced > 0.02 * ours.mean()


def test_values_of_lamps(known):
    """Exposure, temperature, power per size, nodes with an Emission, the scale of an object: Cycles' rules; other nodes are left out."""
    scene = known.cycles.scene
    surfaces = (known.module.Surface((0.8, 0.6, 0.4), 0.5, 1.0), known.module.Surface((0.5, 0.6, 0.7), 0.5, 1.0))
    optional = {"exposure": 1.5, "normalize": False, "use_temperature": True, "temperature": 3000.0}  # attributes of Blender 4.5
    data = bpy.data.lights.new("probe", "POINT")
    extra = {name: value for name, value in optional.items() if hasattr(data, name)}
    LAMPS["values"] = ("POINT", (0.9, -0.9, 1.6), {"energy": 20.0, "shadow_soft_size": 0.2, **extra})
    assert_alike(*both(known, "values", 0, *surfaces), 0.005, 0.04, 40)
    place_lamp(scene, "AREA", (1.0, -1.0, 1.6), {"energy": 60.0, "size": 0.5})
    thing = next(thing for thing in scene.objects if thing.type == "LIGHT")
    thing.scale = (2.0, 0.5, 1.0)
    bpy.context.view_layer.update()
    (stretched,) = scene_lamps(scene.objects, None)
    assert stretched.size == pytest.approx((1.0, 0.25)) and stretched.emission[0] == pytest.approx(60 / np.pi / 0.25)
    thing.data.use_nodes = True
    emission = next(node for node in thing.data.node_tree.nodes if node.bl_idname == "ShaderNodeEmission")
    emission.inputs["Strength"].default_value = 0.5
    (half,) = scene_lamps(scene.objects, None)
    assert half.emission[0] == pytest.approx(30 / np.pi / 0.25)
    thing.data.node_tree.links.new(thing.data.node_tree.nodes.new("ShaderNodeLightFalloff").outputs[0], emission.inputs["Strength"])
    assert scene_lamps(scene.objects, None) == () and not is_lamp(thing)


def test_light_linking(known):
    """A lamp lights the objects of its receiver collection alone, and only those of its blocker collection cast shadows."""
    scene = known.cycles.scene
    place_lamp(scene, *LAMPS["sun"])
    thing = next(thing for thing in scene.objects if thing.type == "LIGHT")
    sphere, square = known.cycles.sphere, known.cycles.square
    linked = bpy.data.collections.new("linked")
    linked.objects.link(sphere)
    thing.light_linking.receiver_collection = linked
    assert len(scene_lamps(scene.objects, sphere)) == 1 and not scene_lamps(scene.objects, square)
    linked.collection_objects[0].light_linking.link_state = "EXCLUDE"
    assert len(scene_lamps(scene.objects, square)) == 1 and not scene_lamps(scene.objects, sphere)
    thing.light_linking.receiver_collection, thing.light_linking.blocker_collection = None, linked
    assert scene_lamps(scene.objects, square)[0].shadow and not scene_lamps(scene.objects, sphere)[0].shadow
