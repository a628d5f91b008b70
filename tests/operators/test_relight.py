# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighting from Blender with the real worker: preview, F12 and `irgspp render` agree for any rotation of object, camera and light."""

import subprocess
from math import pi

import bpy
import numpy as np
import pytest
from blender_side import read_image
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.irgspp_addon.engine.process import engine_command, engine_environment
from irgspp.irgspp_addon.importer.run_frame import camera_of, frame_of, run_object, scene_camera
from irgspp.irgspp_addon.relight import session as relight_session
from mathutils import Matrix, Vector
from relighting import difference, image_pixels, lamp, mapping

TURN, MOVED = 50.0, 35.0  # degrees of the World's Mapping and of the object


def previewed(run, **options) -> np.ndarray:
    words = {"run": str(run), "eye": "camera", "samples": 64, "resolution": 64, **options}
    assert bpy.ops.irgspp.relight_preview(**words) == {"FINISHED"}
    return image_pixels()


def rendered(scene, tmp_path, name="f12") -> np.ndarray:
    scene.render.engine = "IRGSPP"
    scene.render.filepath = str(tmp_path / f"{name}.exr")
    bpy.ops.render.render(write_still=True)
    return read_image(tmp_path / f"{name}.exr", 4)


def by_command(run, tmp_path, light, *options) -> np.ndarray:
    """Render the view with `irgspp render`."""
    words = ["render", str(run), "--orbit", "1", "-o", str(tmp_path / "views"), "--environment", str(light), "--name", "x", *options]
    done = subprocess.run(engine_command(*words), capture_output=True, text=True, env=engine_environment(), check=False)
    assert done.returncode == 0, done.stderr
    return read_image(tmp_path / "views" / "orbit_000" / "rgba_x.exr", 4)


def move(run) -> None:
    """Turn, shrink and shift the object and the camera with it, so that the view stays the same but for the light."""
    step = Matrix.Translation((3, -2, 1)) @ Matrix.Rotation(np.radians(MOVED), 4, "Z") @ Matrix.Scale(0.4, 4)
    thing = run_object(bpy.context.scene, run)
    top = thing.parent or thing
    top.matrix_world = step @ top.matrix_world
    placed = step @ bpy.context.scene.camera.matrix_world
    bpy.context.scene.camera.matrix_world = Matrix.LocRotScale(placed.to_translation(), placed.to_quaternion(), None)
    bpy.context.view_layer.update()


def test_a_preview_is_what_the_command_renders(scene, relightable, tmp_path):
    """A rotated World or a moved object equals a rotated light of the command."""
    light, mesh = tmp_path / "lamp.exr", ("--backend", "mesh")
    before = previewed(relightable)
    assert difference(before, by_command(relightable, tmp_path, light, *mesh, "--samples", "64")) < 0.01
    mapping(scene).inputs["Rotation"].default_value = (0, 0, np.radians(TURN))
    turned = previewed(relightable)
    move(relightable)
    moved = previewed(relightable)
    assert difference(moved, by_command(relightable, tmp_path, light, *mesh, "--rotation", str(-TURN - MOVED))) < 0.01  # hq
    assert min(difference(before, turned), difference(turned, moved)) > 0.05


def test_views_are_rendered_under_the_world(scene, relightable, tmp_path):
    mapping(scene).inputs["Rotation"].default_value = (0.4, 0.2, 1.0)
    move(relightable)
    out = tmp_path / "out"
    words = {"run": str(relightable), "views": "1", "output": str(out), "samples": "64", "backend": "mesh"}
    assert bpy.ops.irgspp.render_views(**words) == {"FINISHED"}
    assert difference(previewed(relightable), read_image(out / "orbit_000" / "rgba_world.exr", 4)) < 0.01
    assert bpy.ops.irgspp.render_views(**words | {"use_world": False}) == {"FINISHED"}
    assert difference(previewed(relightable, use_world=False), read_image(out / "orbit_000" / "rgba.exr", 4)) < 0.01
    with pytest.raises(RuntimeError, match="no-such"):
        bpy.ops.irgspp.render_views(**words | {"views": str(tmp_path / "no-such")})


def test_f12_is_the_preview(scene, relightable, tmp_path):
    scene.irgspp.relight_samples = 64
    scene.render.film_transparent = True
    shown = previewed(relightable)
    whole = rendered(scene, tmp_path)
    assert difference(whole, shown) < 1e-3
    scene.render.film_transparent = False
    opaque = rendered(scene, tmp_path)
    assert np.allclose(opaque[..., 3], 1)
    camera = scene_camera(scene, bpy.context.evaluated_depsgraph_get(), whole.shape[1], whole.shape[0], frame_of(None))
    behind = whole[..., 3] == 0
    from irgspp.irgspp_addon.world.plain_world import plain_light

    assert np.allclose(opaque[behind, :3], plain_light(scene.world).radiance(camera.rays())[behind], rtol=1e-3, atol=1e-3)


def test_f12_says_what_it_leaves_out(scene, relightable, tmp_path, capfd):
    scene.irgspp.relight_samples, scene.render.resolution_percentage = 1, 25
    rendered(scene, tmp_path)
    assert "Not drawn" not in capfd.readouterr().out
    bpy.ops.mesh.primitive_cube_add()
    rendered(scene, tmp_path)
    assert "Not drawn: 1 object. IRGS++ draws one reconstruction" in capfd.readouterr().out


def add_lamps() -> None:
    """Add a sun, a point, a spot and an area lamp about the object, which is where `move` has taken it."""
    bpy.ops.object.empty_add()
    bpy.context.object.name = "lamps"
    root = bpy.context.object
    for kind, energy, place in (("SUN", 2, (3, -2, 4)), ("POINT", 150, (-2, 2, 2)), ("SPOT", 400, (2, 2, 3)), ("AREA", 80, (-1, -3, 1))):
        bpy.ops.object.light_add(type=kind)
        lamp = bpy.context.object
        lamp.data.energy, lamp.parent = energy, root
        lamp.location, lamp.rotation_euler = place, Vector(place).to_track_quat("Z", "Y").to_euler()
    bpy.context.view_layer.update()


def test_lamps_are_those_of_cycles(scene, relightable, tmp_path):
    """The moved and scaled sphere under four lamps and a dim World: previews, F12, files and Cycles agree."""
    move(relightable)
    add_lamps()
    thing = run_object(scene, relightable)
    top = thing.parent or thing
    bpy.data.objects["lamps"].matrix_world = Matrix.Translation(top.matrix_world.to_translation())
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.1
    bpy.context.view_layer.update()
    scene.irgspp.relight_samples, scene.render.film_transparent = 128, True
    shown, final = previewed(relightable, samples=128), rendered(scene, tmp_path)
    assert difference(final, shown) < 1e-3
    out = tmp_path / "files"
    words = {"run": str(relightable), "views": "1", "output": str(out), "samples": "128", "backend": "mesh"}
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.device = 128, False, "CPU"
    scene.render.filepath = str(tmp_path / "cycles.exr")
    bpy.ops.render.render(write_still=True)
    theirs = read_image(tmp_path / "cycles.exr", 4)
    solid = (final[..., 3] > 0.999) & (theirs[..., 3] > 0.999)
    assert solid.sum() > 300
    error = (final - theirs)[solid][:, :3]
    psnr = -10 * np.log10((error.astype(float) ** 2).mean() / theirs[solid].max() ** 2)
    means = final[solid][:, :3].mean() / theirs[solid][:, :3].mean() - 1
    print(f"lamps: PSNR {psnr:.1f} dB, means {means:+.4f}, pixels {np.abs(error).mean() / theirs[solid].mean():.4f}")
    assert psnr > 32 and abs(means) < 0.03  # of Principled's coat, and of the mesh, whose triangles are large
    without = previewed(relightable, samples=128, use_lamps=False)
    assert without[..., :3].mean() < 0.5 * shown[..., :3].mean()
    assert bpy.ops.irgspp.render_views(**words) == {"FINISHED"}
    mean = read_image(out / "orbit_000" / "rgba_world.exr", 4)[..., :3].mean()  # of its own camera, lamps about it
    assert np.isclose(mean, shown[..., :3].mean(), rtol=0.3)


def test_animated_lamps(scene, relightable, tmp_path):
    """The preview follows a lamp that the animation moves, and F12 renders each frame with its values."""
    add_lamps()
    sun = next(thing for thing in scene.objects if thing.type == "LIGHT" and thing.data.type == "SUN")
    for frame, energy in ((1, 0.0), (3, 20.0)):
        sun.data.energy = energy
        sun.data.keyframe_insert("energy", frame=frame)
    images = []
    for frame in (1, 3):
        scene.frame_set(frame)
        images.append((previewed(relightable), rendered(scene, tmp_path)))
    scene.frame_set(1)
    assert images[1][0].mean() > 1.3 * images[0][0].mean() and images[1][1].mean() > 1.3 * images[0][1].mean()


def test_border_percentage_and_pixel_aspect(scene, relightable, tmp_path):
    scene.irgspp.relight_samples = 16
    scene.render.film_transparent = True
    whole = rendered(scene, tmp_path)
    height, width = whole.shape[:2]
    border = (0.3, 0.8, 0.1, 0.7)
    scene.render.use_border = True
    scene.render.border_min_x, scene.render.border_max_x, scene.render.border_min_y, scene.render.border_max_y = border
    left, right, bottom, top = (int(f * size) for f, size in zip(border, (width, width, height, height), strict=True))
    inside = whole[height - top : height - bottom, left:right]
    framed = rendered(scene, tmp_path)
    assert framed.shape == whole.shape
    assert difference(framed[height - top : height - bottom, left:right], inside) < 0.03  # another shift of the samples
    framed[height - top : height - bottom, left:right] = 0
    assert not framed.any()
    scene.render.use_crop_to_border = True
    assert difference(rendered(scene, tmp_path), inside) < 0.03
    scene.render.use_border, scene.render.resolution_percentage = False, 200
    large = rendered(scene, tmp_path)
    assert large.shape[:2] == (2 * height, 2 * width)
    assert difference(large.mean((0, 1)), whole.mean((0, 1))) < 0.04  # splats are wider than a pixel, and few
    scene.render.resolution_percentage, scene.render.pixel_aspect_x = 100, 2.0
    wide = rendered(scene, tmp_path)  # the same width of the world in pixels twice as wide: half as high a part of it
    assert wide[..., 3].sum() > 1.5 * whole[..., 3].sum()


@pytest.mark.parametrize("index", range(3))
def test_cameras_come_back_as_they_were(scene, relightable, index):
    """Intrinsics through Blender's own projection, pixels of any shape, and through the frame of a moved object."""
    from irgspp.irgspp_addon.importer.cameras import look_through

    expected = load_run_cameras(relightable / "cameras.json")[index].camera
    cameras = sorted((o for o in scene.objects if o.type == "CAMERA" and o.name != "eye"), key=lambda o: o.name[-1])
    look_through(scene, cameras[index])
    thing = run_object(scene, relightable)
    thing.parent.matrix_world = Matrix.Translation((3, -2, 1)) @ Matrix.Rotation(0.6, 4, (1, 2, 3)) @ Matrix.Scale(0.4, 4)
    bpy.context.view_layer.update()
    frame = frame_of(thing)
    found = frame.camera(scene_camera(scene, bpy.context.evaluated_depsgraph_get(), expected.width, expected.height, frame))
    for name in ("fx", "fy", "cx", "cy"):
        assert np.isclose(getattr(found, name), getattr(expected, name), atol=1e-3), name
    assert np.allclose(found.to_world, expected.to_world, atol=1e-4)


def test_parallel_projection_is_seen_from_far_away(scene, relightable):
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 4.0
    frame = frame_of(run_object(scene, relightable))
    camera = scene_camera(scene, bpy.context.evaluated_depsgraph_get(), 80, 60, frame)
    pixels, _ = camera.project(frame.centre + camera.to_world[:3, :3].T[[0, 0, 1]] * [[0.0], [1.0], [1.0]])
    assert np.allclose(pixels[1] - pixels[0], [20, 0], atol=0.05) and np.allclose(pixels[2] - pixels[0], [0, -20], atol=0.05)
    projection = scene.camera.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=80, y=60)
    same = camera_of(scene.camera.matrix_world, projection, 80, 60, frame)
    assert np.allclose(same.to_world, camera.to_world)


def test_the_world_as_a_light_map(scene, tmp_path):
    mapping(scene).inputs["Rotation"].default_value = (0, 0, pi)
    assert bpy.ops.irgspp.world_to_map(filepath=str(tmp_path / "map.exr"), height=64) == {"FINISHED"}
    assert np.abs(read_image(tmp_path / "map.exr") - np.roll(lamp(), 64, 1)).max() < 1e-4
    with pytest.raises(RuntimeError, match=r"\.exr or \.npy"):
        bpy.ops.irgspp.world_to_map(filepath=str(tmp_path / "map.png"))


def test_ground_shadow_is_that_of_cycles(scene, relightable, tmp_path):
    """The shadow of the moved sphere on the ground at its foot is in the alpha, as on a shadow catcher of Cycles."""
    move(relightable)
    thing = run_object(scene, relightable)
    foot = min((thing.matrix_world @ vertex.co).z for vertex in thing.data.vertices)
    centre = thing.matrix_world.to_translation()
    bpy.ops.object.light_add(type="SUN", rotation=(0.6, 0.3, 0.0))
    bpy.context.object.data.energy, bpy.context.object.data.angle = 2.0, 0.3
    scene.irgspp.relight_samples, scene.render.film_transparent = 128, True
    without = rendered(scene, tmp_path)
    scene.irgspp.ground_shadow = True
    switched = rendered(scene, tmp_path)
    assert difference(previewed(relightable, samples=128), switched) < 1e-3
    bpy.ops.mesh.primitive_plane_add(size=20, location=(centre.x, centre.y, foot))
    bpy.context.object.is_shadow_catcher = True
    scene.irgspp.ground_shadow = False
    ours = rendered(scene, tmp_path)
    assert difference(ours, switched) < 0.02
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.device = 128, False, "CPU"
    scene.render.filepath = str(tmp_path / "cycles.exr")
    bpy.ops.render.render(write_still=True)
    theirs = read_image(tmp_path / "cycles.exr", 4)
    ground = without[..., 3] == 0
    apart = np.abs(ours[..., 3] - theirs[..., 3])[ground]
    print(f"ground shadow: mean {apart.mean():.4f}, largest {apart.max():.3f}, alpha up to {ours[..., 3][ground].max():.2f}")
    assert ours[..., 3][ground].max() > 0.5 and apart.mean() < 0.02 and np.quantile(apart, 0.99) < 0.15
    assert np.allclose(ours[ground][:, :3], 0)


def test_scripts_get_exceptions(scene, relightable, tmp_path, monkeypatch):
    """The last test here, since it ends the worker that the others share."""
    ask = {"run": str(relightable), "eye": "camera"}
    with pytest.raises(RuntimeError, match="not a finished run"):
        bpy.ops.irgspp.relight_preview(run=str(tmp_path))
    if not [area for window in bpy.context.window_manager.windows for area in window.screen.areas if area.type == "VIEW_3D"]:
        with pytest.raises(RuntimeError, match="no 3D View"):
            bpy.ops.irgspp.relight_preview(run=str(relightable), eye="view")
    camera, scene.camera = scene.camera, None
    with pytest.raises(RuntimeError, match="has no camera"):
        bpy.ops.irgspp.relight_preview(**ask)
    scene.camera = camera
    camera.data.type = "PANO"
    with pytest.raises(RuntimeError, match="panoramic"):
        bpy.ops.irgspp.relight_preview(**ask)
    scene.render.engine = "IRGSPP"
    with pytest.raises(RuntimeError, match="panoramic"):
        bpy.ops.render.render()
    camera.data.type = "PERSP"
    world, scene.world = scene.world, None
    with pytest.raises(RuntimeError, match="no World"):
        bpy.ops.irgspp.relight_preview(**ask)
    assert not bpy.ops.irgspp.world_to_map.poll()
    scene.world = world
    with pytest.raises(RuntimeError, match="no file is named"):
        bpy.ops.irgspp.world_to_map()
    relight_session.close_all()
    monkeypatch.setenv("IRGSPP_PYTHON", "/no/such/python")
    with pytest.raises(RuntimeError, match="/no/such/python"):
        bpy.ops.irgspp.relight_preview(**ask)
    with pytest.raises(RuntimeError, match="/no/such/python"):
        bpy.ops.render.render()
