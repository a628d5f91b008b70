# SPDX-License-Identifier: GPL-3.0-or-later
"""The plane that catches the object's shadow: added under its foot, known to IRGS++ and Cycles, removable, and safe against undo."""

import bpy
import numpy as np
import pytest
from irgspp.irgspp_addon.importer.run_frame import run_object
from irgspp.irgspp_addon.relight.ground import added_plane, ground_height
from irgspp.irgspp_addon.relight.left_out import left_out
from irgspp.irgspp_addon.relight.world_follower import changes
from irgspp.panels import relight
from panel_states import finished_run
from recording_layout import RecordingLayout


@pytest.fixture
def thing(default_scene, run_folder):
    """The sphere, moved and scaled, in the default scene without its cube."""
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    bpy.ops.irgspp.import_run(directory=str(run_folder))
    finished_run(run_folder)
    thing = run_object(default_scene, run_folder)
    thing.scale, thing.location = (2.0, 2.0, 2.0), (3.0, 0.0, 5.0)
    bpy.context.view_layer.update()
    return thing


def drawn():
    layout = RecordingLayout()
    relight.draw_shadow_catcher(layout, bpy.context)
    return layout


def test_it_lies_under_the_foot_and_is_part_of_the_image(thing, run_folder):
    scene = bpy.context.scene
    assert drawn().buttons("irgspp.shadow_catcher")[0].text == "Add Shadow-Catcher Plane"
    assert bpy.ops.irgspp.shadow_catcher(run=str(run_folder)) == {"FINISHED"}
    bpy.context.view_layer.update()
    plane, corners = added_plane(scene), np.array([thing.matrix_world @ vertex.co for vertex in thing.data.vertices])
    assert plane.is_shadow_catcher and plane.location.z == pytest.approx(corners[:, 2].min(), abs=1e-5)
    assert tuple(plane.location.xy) == pytest.approx(tuple((corners.min(0) + corners.max(0))[:2] / 2), abs=1e-5)
    assert plane.dimensions.x > 4 * thing.dimensions.x
    assert ground_height(scene, scene.objects, thing) == pytest.approx(plane.location.z, abs=1e-5)
    changes.note()
    assert left_out(scene, bpy.context.view_layer, run_folder) == ""
    assert drawn().buttons("irgspp.shadow_catcher")[0].values == {"remove": True}


def test_only_eevee_says_that_it_shows_the_plane(thing, run_folder):
    bpy.ops.irgspp.shadow_catcher(run=str(run_folder))
    scene = bpy.context.scene
    assert ("EEVEE renders the plane" in drawn().words) == scene.render.engine.startswith("BLENDER_EEVEE")
    scene.render.engine = "CYCLES"
    assert "EEVEE" not in drawn().words


def test_adding_again_moves_it_and_importing_again_keeps_it(thing, run_folder):
    scene = bpy.context.scene
    bpy.ops.irgspp.shadow_catcher(run=str(run_folder))
    thing.location.z += 1.0
    bpy.context.view_layer.update()
    before = added_plane(scene).location.z
    bpy.ops.irgspp.shadow_catcher(run=str(run_folder))
    bpy.ops.irgspp.import_run(directory=str(run_folder))
    planes = [one for one in scene.objects if "irgspp_ground" in one]
    assert len(planes) == 1 and planes[0].location.z == pytest.approx(before + 1.0, abs=1e-5)


def test_it_is_removed_and_comes_back_by_undo(thing, run_folder):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.irgspp.shadow_catcher(run=str(run_folder))
    bpy.ops.ed.undo_push(message="added")
    assert bpy.ops.irgspp.shadow_catcher(remove=True) == {"FINISHED"}
    assert added_plane(bpy.context.scene) is None and "Shadow Catcher" not in bpy.data.meshes
    bpy.ops.ed.undo_push(message="removed")
    bpy.ops.ed.undo()
    assert added_plane(bpy.context.scene) is not None
    bpy.ops.ed.undo()
    assert added_plane(bpy.context.scene) is None
    with pytest.raises(RuntimeError, match="has no such plane"):
        bpy.ops.irgspp.shadow_catcher(remove=True)
