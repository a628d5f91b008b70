# SPDX-License-Identifier: GPL-3.0-or-later
"""Environment maps of Worlds: reading the image and rendering by another Blender agree; Worlds without light are errors."""

import bpy
import numpy as np
import pytest
from blender_side import read_image, write_image
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.environment_map import EnvironmentMap, reduced, texel_directions
from irgspp.irgspp_addon.world import world_light as module
from irgspp.irgspp_addon.world.fingerprint import fingerprint
from irgspp.irgspp_addon.world.light_to_world import bake_world, world_from_map
from irgspp.irgspp_addon.world.plain_world import plain_light
from irgspp.irgspp_addon.world.shader_nodes import node_tree
from irgspp.irgspp_addon.world.world_light import WorldBake, ask_world, save_light, world_light
from relighting import see_through
from sphere_run import axis_light

ROWS = 32


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_homefile(use_empty=True)
    module.forget()


@pytest.fixture
def world(tmp_path):
    """Return the scene's World, which has a smooth environment map."""
    world = bpy.context.scene.world = world_from_map(write_image(tmp_path / "light.exr", axis_light(ROWS)))
    return world


def node(world, kind):
    return next(node for node in world.node_tree.nodes if node.bl_idname == f"ShaderNode{kind}")


def rendered(world, rows=ROWS):
    bake = WorldBake(world, rows=rows)
    try:
        return bake.wait(120).texels
    finally:
        bake.close()


def datablocks():
    kinds = ("scenes", "objects", "cameras", "worlds", "images", "libraries")
    return {block.name for kind in kinds for block in getattr(bpy.data, kind)} - {"Render Result"}


def sky_world():
    world = bpy.data.worlds.new("sky")
    nodes, links = node_tree(world)
    sky, background, output = (nodes.new(f"ShaderNode{kind}") for kind in ("TexSky", "Background", "OutputWorld"))
    sky.sun_disc = False
    background.inputs["Strength"].default_value = 0.4
    links.new(sky.outputs[0], background.inputs["Color"])
    links.new(background.outputs[0], output.inputs["Surface"])
    return world


@pytest.mark.parametrize("rotation", [(0, 0, 0), (0, 0, 0.7), (0.3, -0.5, 2.0)])
@pytest.mark.parametrize("kind", ["POINT", "TEXTURE"])
def test_plain_worlds_are_read_as_they_render(world, rotation, kind):
    node(world, "Mapping").vector_type = kind
    node(world, "Mapping").inputs["Rotation"].default_value = rotation
    node(world, "Background").inputs["Strength"].default_value = 1.7
    light = plain_light(world)
    assert light is not None
    assert np.abs(light.image(ROWS) - rendered(world)).max() < 1e-4


def test_a_mapping_of_90_degrees_moves_y_to_x(world):
    node(world, "Mapping").inputs["Rotation"].default_value = (0, 0, np.pi / 2)
    image, source = plain_light(world).image(ROWS), axis_light(ROWS)
    assert np.allclose(image[:, ROWS], source[:, ROWS // 2], atol=0.02)  # +X in the middle sees the texel of +Y, a quarter from the left
    assert np.allclose(plain_light(world).radiance(np.array([[1.0, 0, 0]])), source[ROWS // 2, ROWS // 2], atol=0.03)


def test_eight_bit_images_are_decoded_as_cycles_does(tmp_path, world):
    image = bpy.data.images.new("bytes", 2 * ROWS, ROWS)
    pixels = np.ones((ROWS, 2 * ROWS, 4), np.float32)
    pixels[..., :3] = np.clip(axis_light(ROWS), 0, 1)
    image.pixels.foreach_set(pixels.reshape(-1))
    image.filepath_raw, image.file_format = str(tmp_path / "light.png"), "PNG"
    image.save()
    node(world, "TexEnvironment").image = bpy.data.images.load(str(tmp_path / "light.png"))
    assert np.abs(plain_light(world).image(ROWS) - rendered(world)).max() < 1e-4


def test_packed_and_relative_images(tmp_path, world):
    before = plain_light(world).image(ROWS)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    image = node(world, "TexEnvironment").image
    image.filepath = "//light.exr"
    module.forget()
    assert np.array_equal(plain_light(world).image(ROWS), before)
    assert np.abs(rendered(world) - before).max() < 1e-4
    image.pack()
    (tmp_path / "light.exr").unlink()
    assert np.array_equal(plain_light(world).image(ROWS), before)
    assert np.abs(rendered(world) - before).max() < 1e-4


def test_colours_and_worlds_without_nodes(world):
    world.node_tree.links.remove(node(world, "Background").inputs["Color"].links[0])
    node(world, "Background").inputs["Color"].default_value = (0.2, 0.4, 0.8, 1)
    node(world, "Background").inputs["Strength"].default_value = 3
    assert np.allclose(plain_light(world).image(4), [0.6, 1.2, 2.4])
    assert np.abs(rendered(world, 4) - [0.6, 1.2, 2.4]).max() < 1e-4
    if bpy.app.version < (5, 0, 0):
        world.use_nodes, world.color = False, (0.1, 0.2, 0.3)
        assert np.allclose(plain_light(world).image(4), [0.1, 0.2, 0.3])
    world.node_tree.nodes.clear()
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    assert not plain_light(world).image(4).any() and not rendered(world, 4).any()


def test_mixed_worlds_are_rendered(world):
    """The World mixes 0.7 of an image and 0.3 of a colour."""
    nodes, links = world.node_tree.nodes, world.node_tree.links
    mix, colour = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeBackground")
    colour.inputs["Color"].default_value, mix.inputs[0].default_value = (0.2, 0.4, 0.8, 1), 0.3
    links.new(node(world, "Background").outputs[0], mix.inputs[1])
    links.new(colour.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], node(world, "OutputWorld").inputs["Surface"])
    node(world, "Mapping").inputs["Rotation"].default_value = (0, 0, np.pi)
    assert plain_light(world) is None
    expected = 0.7 * np.roll(axis_light(ROWS), ROWS, 1) + 0.3 * np.array([0.2, 0.4, 0.8])
    assert np.abs(rendered(world) - expected).max() < 1e-4


def test_skies_are_rendered_as_a_camera_sees_them(tmp_path):
    """A perspective render of the same sky differs from the environment map by interpolation alone."""
    scene = bpy.context.scene
    scene.world = sky_world()
    assert plain_light(scene.world) is None
    light = EnvironmentMap(rendered(scene.world, 512))
    camera = Camera(24, 16, 30.0, 30.0, 12.0, 8.0, look_at((-1.0, 0.4, -0.9)))  # upwards: the horizon has an edge
    see_through(scene, camera, "up")
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.filter_width = 1, False, 0.01
    scene.world.cycles.sampling_method = "NONE"  # nothing is lit
    scene.render.filepath = str(tmp_path / "view.exr")
    bpy.ops.render.render(write_still=True)
    seen = read_image(tmp_path / "view.exr")
    assert seen.std() > 0.01
    assert np.abs(light.radiance(camera.rays()) - seen).max() < 1e-4 * seen.max()


def test_a_world_is_rendered_once(world):
    scene = bpy.context.scene
    scene.world = sky_world()
    bake = ask_world(scene.world)
    assert isinstance(bake, WorldBake) and bake.poll() is None
    light = bake.wait(120)
    bake.close()
    assert ask_world(scene.world) is light
    node(scene.world, "TexSky").location = (500, 0)
    assert ask_world(scene.world) is light
    node(scene.world, "TexSky").sun_elevation += 0.2
    again = ask_world(scene.world)
    assert isinstance(again, WorldBake)
    again.close()


def test_rendering_does_not_change_the_scene(world, tmp_path):
    bpy.ops.mesh.primitive_cube_add()
    scene = bpy.context.scene
    before = datablocks()
    rendered(world, 8)
    bake_world(scene, tmp_path / "baked.exr", 8)
    assert datablocks() == before
    assert bpy.context.scene == scene and bpy.context.object.select_get() and bpy.context.object.mode == "OBJECT"
    assert scene.world == world and scene.render.engine != "CYCLES"


def test_fingerprints_depend_on_ramps_curves_groups_and_links(world):
    tree, seen = world.node_tree, [fingerprint(world)]
    ramp, curves = tree.nodes.new("ShaderNodeValToRGB"), tree.nodes.new("ShaderNodeRGBCurve")
    seen.append(fingerprint(world))
    ramp.color_ramp.elements[0].color = (0.3, 0, 0, 1)
    seen.append(fingerprint(world))
    curves.mapping.curves[0].points[0].location.y = 0.4
    seen.append(fingerprint(world))
    tree.links.new(node(world, "TexEnvironment").outputs[0], curves.inputs["Color"])
    seen.append(fingerprint(world))
    group = bpy.data.node_groups.new("inner", "ShaderNodeTree")
    tree.nodes.new("ShaderNodeGroup").node_tree = group
    seen.append(fingerprint(world))
    group.nodes.new("ShaderNodeValue").outputs[0].default_value = 0.7
    seen.append(fingerprint(world))
    group.nodes[0].outputs[0].default_value = 0.8
    seen.append(fingerprint(world))
    assert len(set(seen)) == len(seen), [seen.index(one) for one in seen]


def test_worlds_without_light_are_errors(world, tmp_path):
    with pytest.raises(InputError, match="has no World"):
        world_light(None)
    node(world, "TexEnvironment").image = None
    with pytest.raises(InputError, match="has no image"):
        world_light(world)
    image = node(world, "TexEnvironment").image = bpy.data.images.load(str(write_image(tmp_path / "gone.exr", axis_light(4))))
    (tmp_path / "gone.exr").unlink()
    image.reload()
    with pytest.raises(InputError, match=r"gone.*can't be read"):
        world_light(world)


def test_a_failing_render_is_an_error(monkeypatch, tmp_path):
    broken = tmp_path / "broken.py"
    broken.write_text("raise SystemExit('no light today')")
    monkeypatch.setattr(module, "LAUNCHER", broken)
    bpy.context.scene.world = sky_world()
    with pytest.raises(IrgsppError, match=r"World sky: could not be rendered .*no light today"):
        world_light(bpy.context.scene.world)


def test_light_maps_as_files(tmp_path):
    light = EnvironmentMap(axis_light(ROWS))
    save_light(light, tmp_path / "light.exr", ROWS)
    save_light(light, tmp_path / "light.npy", ROWS)
    assert np.array_equal(read_image(tmp_path / "light.exr"), axis_light(ROWS))
    assert np.array_equal(np.load(tmp_path / "light.npy"), axis_light(ROWS))
    with pytest.raises(InputError, match=r"\.exr or \.npy"):
        save_light(light, tmp_path / "light.jpg", ROWS)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["light.exr", "light.npy"]


def test_resizing_preserves_energy():
    texels = np.zeros((64, 128, 3), np.float32)
    texels[20, 77] = 1000  # a sun of one texel
    turned = EnvironmentMap(texels, np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), 2.0)
    angle = [-np.diff(np.cos(np.arange(rows + 1) * np.pi / rows))[:, None, None] * np.pi / rows for rows in (16, 64)]
    assert np.isclose((turned.image(16) * angle[0]).sum(), 2 * (texels * angle[1]).sum(), rtol=1e-3)
    assert np.array_equal(reduced(texels, 4), EnvironmentMap(texels).image(16))
    assert np.allclose(EnvironmentMap(texels).radiance(texel_directions(64)), texels, atol=1e-3)
