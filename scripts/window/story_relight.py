# SPDX-License-Identifier: GPL-3.0-or-later
"""Story of relighting a finished run (run.py --run): HDRI thumbnail, dragged light, lamp, shadows, turn of the light, asset."""

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import bpy
import browsing
import comparison
import driver
import preview
import timing
from mathutils import Vector


def story() -> Iterator[float]:
    """Run the story."""
    work = Path(tempfile.mkdtemp(prefix="irgspp-story-"))
    run = Path(shutil.copytree(os.environ["IRGSPP_RUN"], work / "spot"))
    bpy.ops.wm.save_as_mainfile(filepath=str(work / "relight.blend"))
    browsing.open_panels("IRGSPP_PT_relight_files", "IRGSPP_PT_asset")
    timing.time_callbacks()
    yield from driver.open_sidebar("IRGS++")
    yield from browsing.engine_ready()
    with driver.override():
        bpy.ops.irgspp.import_run("INVOKE_DEFAULT", directory=str(run))
    yield from driver.wait(lambda: bpy.context.object and bpy.context.object.type == "MESH", 60)
    yield from compare_photograph()
    bpy.context.scene.irgspp.preview_resolution = 192
    yield from start_preview()
    yield from choose_thumbnail()
    yield from drag_light()
    yield from add_lamp()
    yield from cast_shadow()
    yield from catch_shadow()
    yield from turn_light(work / "turn")
    yield from mark_asset()
    shutil.rmtree(work, ignore_errors=True)


def compare_photograph() -> Iterator[float]:
    """Compare object and photograph through its camera: split under Standard, at the photograph's own colours, then faded."""
    thing, scene = bpy.context.object, bpy.context.scene
    yield 15.0  # shaders are compiled
    yield from browsing.press_button("irgspp.step_photograph", across=0.5)
    yield from driver.wait(lambda: scene.camera.name != "Camera", 5)
    with driver.override():
        bpy.ops.view3d.view_center_camera()
    scene.irgspp_border = 0.5
    yield 2.0
    driver.shot("70_split_under_agx")
    yield from browsing.press_button("irgspp.comparison_colours")
    assert scene.view_settings.view_transform == "Standard", scene.view_settings.view_transform
    yield 2.0
    comparison.check_left_half(driver.shot("70_split"))
    scene.irgspp_comparison = "fade"
    scene.irgspp_photograph = 0.5
    yield 2.0
    driver.shot("70_photograph_over_object")
    scene.irgspp_photograph, scene.irgspp_comparison, scene.irgspp_border = 0.0, "split", 0.0
    yield from browsing.press_button("irgspp.comparison_colours", part="restore=True")
    assert scene.view_settings.view_transform != "Standard" and not driver.view3d().spaces[0].shading.use_scene_world
    driver.shot("70_restored")
    space = driver.view3d().spaces[0]
    space.region_3d.view_perspective, space.shading.type = "PERSP", "SOLID"
    bpy.context.view_layer.objects.active = thing


def start_preview() -> Iterator[float]:
    """Start the preview beside the 3D View."""
    browsing.open_editor("IMAGE_EDITOR")
    yield 1.0
    yield from browsing.frame_selected()
    yield from browsing.press_button("irgspp.relight_preview")
    yield from preview.finished()
    driver.shot("71_preview")


def choose_thumbnail() -> Iterator[float]:
    """Choose one of Blender's HDRIs by its thumbnail."""
    unchanged = preview.pixels()
    yield from browsing.choose_hdri("72_thumbnails")
    yield from preview.updated(unchanged)
    driver.shot("73_other_hdri")
    driver.sidebar_shot("73_other_hdri_sidebar")


def drag_light() -> Iterator[float]:
    """Rotate the light by dragging the mouse, and confirm by a click."""
    controls = driver.extension_module("irgspp_addon.world.light_controls").light_controls
    before = controls(bpy.context.scene.world).rotation.default_value[2]
    yield from browsing.press_button("irgspp.rotate_light", across=0.825)
    place = driver.region()
    driver.move(place.x - 100, place.y + 300)
    yield 1.0
    driver.move(place.x - 300, place.y + 300)
    yield 1.0
    driver.shot("74_dragging")
    driver.click_here()
    yield 1.0
    rotation = controls(bpy.context.scene.world).rotation.default_value[2]
    assert abs(rotation - before) > 0.5, (before, rotation)
    yield from preview.updated()
    driver.shot("75_dragged")


def add_lamp() -> Iterator[float]:
    """Add a lamp on the side that is seen, which lights the object in the preview too."""
    before, view = preview.pixels(), driver.view3d().spaces[0].region_3d
    place = view.view_location + view.view_rotation @ Vector((0.0, 0.0, 3.0))
    with driver.override():
        bpy.ops.object.light_add(type="AREA", location=place, rotation=view.view_rotation.to_euler())
    bpy.context.object.data.energy, bpy.context.object.data.color = 300.0, (1.0, 0.3, 0.1)
    yield from preview.updated(before)
    driver.shot("76_lamp")
    after = preview.pixels()
    assert after[..., 0].sum() > 1.1 * before[..., 0].sum(), "the lamp does not light the object"


def cast_shadow() -> Iterator[float]:
    """Switch the ground shadow on by its button."""
    before = preview.pixels()
    yield from browsing.press_button("ground_shadow", across=0.5)
    assert bpy.context.scene.irgspp.ground_shadow
    yield from preview.updated(before)
    driver.shot("77_ground_shadow")
    assert preview.pixels()[..., 3].sum() > before[..., 3].sum() + 100, "the image has no shadow"


def catch_shadow() -> Iterator[float]:
    """Replace the ground shadow by the shadow-catcher plane, which Cycles knows too, and remove it in the end."""
    scene, shadowed = bpy.context.scene, preview.pixels()
    added_plane = driver.extension_module("irgspp_addon.relight.ground").added_plane  # Blender calls lamps shadow catchers, too
    scene.irgspp.ground_shadow = False
    yield from preview.updated(shadowed)
    before = preview.pixels()
    yield from browsing.press_button("irgspp.shadow_catcher")
    yield from driver.wait(lambda: added_plane(scene) is not None, 10)
    yield from preview.updated(before)
    driver.shot("77_shadow_catcher")
    assert preview.pixels()[..., 3].sum() > before[..., 3].sum() + 100, "the plane catches no shadow"
    yield from browsing.press_button("irgspp.relight_stop")
    caught = rendered_alpha("77_cycles_shadow_catcher")
    yield from browsing.press_button("irgspp.shadow_catcher", part="remove=True")
    yield from driver.wait(lambda: added_plane(scene) is None, 10)
    assert caught > rendered_alpha("77_cycles_without") + 50, "the plane catches no shadow in Cycles"


def rendered_alpha(name: str) -> float:
    """Render the scene by Cycles into an image file, and return the sum of its alpha over all pixels.

    Args:
        name: name of the image.
    """
    scene = bpy.context.scene
    engine, render = scene.render.engine, scene.render
    render.engine, render.film_transparent, render.filepath = "CYCLES", True, str(driver.OUTPUT / f"{name}.png")
    render.resolution_x = render.resolution_y = 160
    scene.cycles.samples, scene.cycles.use_denoising, render.image_settings.color_mode = 16, False, "RGBA"
    bpy.ops.render.render(write_still=True)
    render.engine, render.film_transparent = engine, False
    image = bpy.data.images.load(render.filepath)
    alpha = float(comparison.pixels(image)[..., 3].sum())
    bpy.data.images.remove(image)
    return alpha


def turn_light(folder: Path) -> Iterator[float]:
    """Render one turn of the light by its button."""
    scene = bpy.context.scene
    scene.frame_end, scene.render.filepath = 4, f"{folder}/"
    scene.render.resolution_x = scene.render.resolution_y = 128
    yield from browsing.press_button("irgspp.render_animation", part="turn=True")
    animation = driver.extension_module("irgspp_addon.relight.animation").animation
    yield from driver.wait(lambda: animation().finished >= 1 or animation().error, 120, step=0.02)
    yield 0.1
    driver.sidebar_shot("78_turning")
    yield from driver.wait(lambda: animation().ended, 120)
    assert not animation().error, animation().error
    files = sorted(folder.glob("*.png"))
    assert len(files) == 4, files
    yield 1.0
    driver.sidebar_shot("79_turned")


def mark_asset() -> Iterator[float]:
    """Mark the object's collection as an asset by its button and the dialog."""
    yield from browsing.press_button("irgspp.mark_asset")
    yield 1.0
    driver.shot("80_asset_asked")
    driver.key("Return")
    thing = next(thing for thing in bpy.context.scene.objects if thing.type == "MESH" and thing.name != "Cube")
    yield from driver.wait(lambda: any(one.asset_data is not None for one in thing.users_collection), 60)
    yield 1.0
    driver.sidebar_shot("81_asset")


driver.run_story(story)
