# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender as a module, imported before any test; a relightable run, and a scene with it."""

from pathlib import Path

import blender_side
import bpy
import pytest
from irgspp.core.relight.orbit import orbit
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.core.scene.dataset import Bound
from irgspp.irgspp_addon.importer.scene_builder import import_run
from irgspp.irgspp_addon.relight import live_image as relight_follow
from irgspp.irgspp_addon.world.light_to_world import world_from_map
from irgspp.panels import registration
from relighting import lamp, see_through


@pytest.fixture(scope="session")
def relightable(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of a sphere with Gaussians."""
    folder = tmp_path_factory.mktemp("relit") / "ball"
    blender_side.in_engine(Path(blender_side.__file__).with_name("relight_run.py"), folder)
    return folder


@pytest.fixture(scope="package")
def warm():
    """The registered extension; relighting workers stay loaded from test to test. Tests that need it come last, see `tests/conftest.py`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IRGSPP_PYTHON", blender_side.warm())
        bpy.ops.wm.read_homefile(use_empty=True)
        registration.register()
        yield
        registration.unregister()


@pytest.fixture
def default_scene():
    """Blender's default scene with the extension registered."""
    bpy.ops.wm.read_homefile()
    registration.register()
    yield bpy.context.scene
    registration.unregister()


@pytest.fixture
def scene(warm, relightable, tmp_path):
    """The sphere, seen by the camera of `irgspp render --orbit 1`, under a light with a lamp."""
    bpy.ops.wm.read_homefile(use_empty=True)
    import_run(relightable)
    scene = bpy.context.scene
    scene.world = world_from_map(blender_side.write_image(tmp_path / "lamp.exr", lamp()))
    ((_, camera),) = orbit(1, [placed.camera for placed in load_run_cameras(relightable / "cameras.json")], Bound((0, 0, 0), 1.3))
    see_through(scene, camera, "eye")
    scene.render.image_settings.color_mode = "RGBA"
    yield scene
    relight_follow.stop_all()
