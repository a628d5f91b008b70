# SPDX-License-Identifier: GPL-3.0-or-later
"""Story of a finished run (run.py --run): open it, bake and export, relight by a sky, write files, F12, Rendered shading."""

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import bpy
import browsing
import driver
import timing


def story() -> Iterator[float]:
    """Run the story."""
    work = Path(tempfile.mkdtemp(prefix="irgspp-story-"))
    run = Path(shutil.copytree(os.environ["IRGSPP_RUN"], work / "spot"))
    bpy.ops.wm.save_as_mainfile(filepath=str(work / "result.blend"))
    browsing.open_panels("IRGSPP_PT_bake", "IRGSPP_PT_relight_files")
    timing.time_callbacks()
    yield from driver.open_sidebar("IRGS++")
    yield from browsing.engine_ready()
    yield from open_run(run)
    yield from bake_again()
    yield from export(run)
    yield from relight_by_sky()
    yield from write_files(work)
    yield from render(work)
    yield from rendered_shading()
    yield from demo_and_cancel()
    shutil.rmtree(work, ignore_errors=True)


def demo_and_cancel() -> Iterator[float]:
    """Start the demonstration by its button and cancel it."""
    yield from browsing.press_button("irgspp.demo")
    yield 1.0
    driver.shot("59_demo_asked")
    job = yield from browsing.started_job()
    yield from driver.wait(lambda: job.finished or (job.phase in ("materials", "start", "first stage") and job.step), 300)
    yield 3.0
    driver.sidebar_shot("60_demo_running")
    yield from browsing.press_button("irgspp.job_cancel", across=0.7)
    yield from driver.wait(lambda: job.finished, 120)
    yield 1.5
    driver.sidebar_shot("61_demo_cancelled")
    assert job.state == "cancelled", job.state


def open_run(run: Path) -> Iterator[float]:
    """Open the run by File > Import > IRGS++ Run and the file browser."""
    yield from browsing.from_menu(45, "IRGS++ Run")
    yield from browsing.confirm_files("35_open_run", directory=run)
    yield from driver.wait(lambda: any(thing.type == "MESH" for thing in bpy.context.scene.objects), 60)
    yield from browsing.frame_selected()
    driver.shot("36_opened")


def bake_again() -> Iterator[float]:
    """Bake textures of another size."""
    bpy.context.scene.irgspp.texture_size = "1024"
    yield 1.0
    driver.sidebar_shot("37_bake_panel")
    yield from browsing.press_button("irgspp.bake")
    job = yield from browsing.started_job()
    yield 1.5
    driver.sidebar_shot("38_baking")
    yield from ended(job)
    driver.shot("39_baked")
    nodes = bpy.context.object.active_material.node_tree.nodes
    assert {tuple(node.image.size) for node in nodes if node.bl_idname == "ShaderNodeTexImage"} == {(1024, 1024)}


def export(run: Path) -> Iterator[float]:
    """Export an asset and a .blend file by their buttons."""
    driver.sidebar_shot("40_export_panel")
    for suffix in (".glb", ".blend"):
        yield from browsing.press_button("irgspp.export", part=suffix)
        folder = run.parent / f"for{suffix}"
        folder.mkdir()
        yield from browsing.confirm_files(f"41_export{suffix}", directory=folder, file=f"exported{suffix}")
        yield from driver.wait((folder / f"exported{suffix}").is_file, 120)
        yield from driver.wait(lambda: not driver.extension_module("irgspp_addon.jobs.queue").unfinished(), 30)
        yield 1.5
        driver.sidebar_shot(f"42_exported{suffix}")
        assert (folder / f"exported{suffix}").stat().st_size > 10_000
        yield from show_exported(folder)


def show_exported(folder: Path) -> Iterator[float]:
    """Press the button that shows an exported file, with a program in the place of the file manager, which notes what it is to show.

    Args:
        folder: of the exported file.
    """
    program, shown = folder / "xdg-open", folder / "shown.txt"
    program.write_text(f'#!/bin/sh\necho "$1" > {shown}\n')
    program.chmod(0o755)
    path = os.environ["PATH"]
    os.environ["PATH"] = f"{folder}{os.pathsep}{path}"
    yield from browsing.press_button("wm.path_open", part=str(folder))
    yield from driver.wait(shown.is_file, 10)
    os.environ["PATH"] = path
    assert shown.read_text().strip() == str(folder), shown.read_text()


def relight_by_sky() -> Iterator[float]:
    """Relight by a Sky Texture, which another Blender renders; the preview opens in a window of its own."""
    bpy.context.scene.world, sky = sky_world()
    yield from browsing.press_button("irgspp.relight_preview")
    follower = driver.extension_module("irgspp_addon.relight.live_image").follower_of(
        driver.extension_module("irgspp_addon.relight.preview").CHANNEL
    )
    yield 2.0
    driver.sidebar_shot("44_sky_coming")
    yield from driver.wait(lambda: follower.done or follower.failed, 180)
    yield 1.5
    driver.shot("45_sky")
    assert not follower.failed, follower.message
    sky.sun_rotation = 2.5
    yield from driver.wait(lambda: not follower.done, 60, step=0.02)
    yield from driver.wait(lambda: follower.done, 120)
    yield 1.0
    driver.shot("46_sky_turned")
    yield from browsing.close_other_windows()
    yield from browsing.press_button("irgspp.relight_stop")


def sky_world() -> tuple[bpy.types.World, bpy.types.Node]:
    """Return a World with a Sky Texture, and its node."""
    world = browsing.new_world("Sky")
    nodes = world.node_tree.nodes
    sky = nodes.new("ShaderNodeTexSky")
    background = next(node for node in nodes if node.bl_idname == "ShaderNodeBackground")
    background.inputs["Strength"].default_value = 0.1
    world.node_tree.links.new(sky.outputs["Color"], background.inputs["Color"])
    return world, sky


def write_files(work: Path) -> Iterator[float]:
    """Write the World as a light map, and photographed views relit."""
    driver.sidebar_shot("47_files_panel")
    yield from browsing.press_button("irgspp.world_to_map")
    yield from browsing.confirm_files("48_world_map", directory=work, file="sky.exr")
    yield from driver.wait(lambda: (work / "sky.exr").is_file(), 60)
    yield 1.0
    driver.shot("49_world_map_written")
    yield from browsing.press_button("irgspp.render_views")
    job = yield from browsing.started_job()
    yield from driver.wait(lambda: job.finished or job.step > 1, 200)
    yield 1.0
    driver.sidebar_shot("50_views_rendering")
    with driver.override():
        bpy.ops.irgspp.job_cancel(job=job.id)
    yield from ended(job)
    driver.shot("51_views_stopped")


def render(work: Path) -> Iterator[float]:
    """Render by IRGS++ as the scene's render engine: F12 to its end, and cancelled by Esc."""
    yield from browsing.press_button("wm.context_set_enum")
    assert bpy.context.scene.render.engine == "IRGSPP"
    for tab in ("WORLD", "MATERIAL", "RENDER"):
        yield from browsing.show_properties(tab)
        driver.shot(f"51_properties_{tab.lower()}")
    scene = bpy.context.scene
    bpy.context.view_layer.objects.active = next(thing for thing in scene.objects if thing.type == "CAMERA" and thing.parent)
    scene.camera = bpy.context.view_layer.objects.active
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 800, 800, 50
    yield 1.0
    ends: list[str] = []
    bpy.app.handlers.render_complete.append(lambda *_: ends.append("complete"))
    bpy.app.handlers.render_cancel.append(lambda *_: ends.append("cancel"))
    yield from browsing.from_menu(126, "Render Image")
    yield 2.0
    driver.shot("52_f12_begun")
    yield from driver.wait(lambda: ends, 200)
    yield 2.0
    driver.shot("53_f12_done")
    assert ends == ["complete"], ends
    bpy.data.images["Render Result"].save_render(str(driver.OUTPUT / "f12.png"))
    scene.irgspp.relight_samples = 4096
    ends.clear()
    yield from browsing.close_other_windows()  # they have the keyboard
    yield from browsing.from_menu(126, "Render Image")
    yield 4.0
    driver.shot("54_f12_before_escape")
    driver.key("Escape")  # the render's window has the keyboard
    yield from driver.wait(lambda: ends, 30)
    yield 2.0
    driver.shot("55_f12_escaped")
    assert ends == ["cancel"], ends
    scene.irgspp.relight_samples = 32
    yield from browsing.close_other_windows()


def rendered_shading() -> Iterator[float]:
    """Show the Rendered shading of the 3D View by IRGS++."""
    driver.view3d().spaces[0].shading.type = "RENDERED"
    yield 2.0
    follow = driver.extension_module("irgspp_addon.relight.live_image")
    view = next(iter(driver.extension_module("irgspp_addon.relight.render_engine")._viewports.values()))
    yield from driver.wait(lambda: (f := follow.follower_of(view.channel)) is not None and (f.done or f.failed), 120)
    yield 2.0
    driver.shot("56_rendered")
    with driver.override():
        bpy.ops.view3d.view_orbit(angle=0.7, type="ORBITRIGHT")
    yield from driver.wait(lambda: not follow.follower_of(view.channel).done, 10, step=0.02)
    yield 0.5
    driver.shot("57_rendered_turning")
    yield from driver.wait(lambda: follow.follower_of(view.channel).done, 60)
    yield 1.0
    driver.shot("58_rendered_turned")
    bpy.context.scene.objects["Light"].hide_set(False)
    yield 2.0
    driver.shot("58_rendered_with_a_lamp")


def ended(job) -> Iterator[float]:
    """Wait until a job has ended and the panels show it."""
    yield from driver.wait(lambda: job.finished, 300)
    yield 1.5
    assert not (job.state == "failed" or (job.error and job.state == "done")), (job.state, job.error)


driver.run_story(story)
