# SPDX-License-Identifier: GPL-3.0-or-later
"""The colours of the comparison are those of photographs, and the artist's own come back."""

import blender_side  # noqa: F401  (before bpy)
import bpy
import pytest
from irgspp.irgspp_addon.comparison import view_colours


@pytest.fixture
def scene():
    bpy.ops.wm.read_homefile(use_empty=True)
    return bpy.context.scene


def test_view_settings_come_back(scene):
    view = scene.view_settings
    view.view_transform, view.look, view.exposure = "AgX", "AgX - Punchy", 1.5
    assert not view_colours.are_plain(scene) and not view_colours.kept_transform(scene)
    view_colours.make_plain(scene)
    assert (view.view_transform, view.look, view.exposure) == ("Standard", "None", 0)
    assert view_colours.are_plain(scene) and view_colours.kept_transform(scene) == "AgX"
    view_colours.make_plain(scene)  # twice keeps the artist's own
    view_colours.restore(scene)
    assert (view.view_transform, view.look, view.exposure) == ("AgX", "AgX - Punchy", 1.5)
    assert not view_colours.kept_transform(scene)


def test_settings_chosen_since_are_not_replaced_by_the_panel(scene):
    scene.view_settings.view_transform = "AgX"
    view_colours.make_plain(scene)
    scene.view_settings.view_transform = "Filmic"
    assert not view_colours.kept_transform(scene)
    view_colours.make_plain(scene)
    view_colours.restore(scene)
    assert scene.view_settings.view_transform == "Filmic"


def test_standard_needs_nothing(scene):
    scene.view_settings.view_transform = "Standard"
    view_colours.make_plain(scene)
    assert view_colours.are_plain(scene) and not view_colours.kept_transform(scene)


@pytest.fixture
def shading():
    """Return the shading of the 3D View of a new file, in Material Preview."""
    bpy.ops.wm.read_factory_settings()
    (area,) = [area for area in bpy.context.window_manager.windows[0].screen.areas if area.type == "VIEW_3D"]
    area.spaces.active.shading.type = "MATERIAL"
    return area.spaces.active.shading


def test_the_studio_light_comes_back(shading):
    scene = bpy.context.scene
    assert not shading.use_scene_world
    view_colours.make_plain(scene)
    assert shading.use_scene_world
    view_colours.make_plain(scene)
    view_colours.restore(scene)
    assert not shading.use_scene_world and view_colours.LIT not in scene


def test_the_world_stays_where_it_was_seen_before_or_chosen_since(shading):
    scene = bpy.context.scene
    shading.use_scene_world = True
    view_colours.make_plain(scene)
    view_colours.restore(scene)
    assert shading.use_scene_world
    shading.use_scene_world = False
    view_colours.make_plain(scene)
    scene.world = bpy.data.worlds.new("HDRI")
    view_colours.restore(scene)
    assert shading.use_scene_world
