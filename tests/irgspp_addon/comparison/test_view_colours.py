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
