# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of a finished run in every state: result, baking, export, relighting."""

import time
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from blender_side import write_sphere_run
from irgspp.panels import export, relight, result
from panel_states import add_job, finished_run
from panel_states import settings as settings
from recording_layout import draw


def test_the_result_is_offered_then_shown(settings, run_folder):
    finished_run(run_folder)
    settings.run = str(run_folder)
    drawn = draw(result.IRGSPP_PT_result)
    assert drawn.buttons("irgspp.import_run")[0].values["directory"] == str(run_folder.resolve())
    assert "31.5 dB" in drawn.words
    assert bpy.ops.irgspp.import_run(directory=str(run_folder)) == {"FINISHED"}
    drawn = draw(result.IRGSPP_PT_result)
    assert "irgspp_source" in drawn.properties and "triangles, textures 128" in drawn.words
    settings.run = ""  # the selected object knows where it is from
    assert "irgspp_source" in draw(result.IRGSPP_PT_result).properties
    for panel in (result.IRGSPP_PT_bake, export.IRGSPP_PT_export, relight.IRGSPP_PT_relight):
        assert not hasattr(panel, "poll") or panel.poll(bpy.context)
        draw(panel)
    assert '["irgspp_albedo_scale"]' in draw(relight.IRGSPP_PT_relight).properties
    bpy.context.view_layer.objects.active = None  # and it is the only one there is
    assert "irgspp_source" in draw(result.IRGSPP_PT_result).properties
    bpy.data.objects.remove(next(thing for thing in bpy.data.objects if thing.type == "MESH"))
    assert draw(result.IRGSPP_PT_result).buttons("irgspp.import_run")[0].text == "Import Result"


def test_confidence_can_be_shown_where_it_is_known(settings, run_folder, tmp_path):
    for run, known in ((finished_run(write_sphere_run(tmp_path / "known", confidence=True)), True), (finished_run(run_folder), False)):
        settings.run = str(run)
        assert bpy.ops.irgspp.import_run(directory=str(run)) == {"FINISHED"}
        assert ("irgspp_show_confidence" in draw(result.IRGSPP_PT_result).properties) == known


@pytest.mark.parametrize("status", ["running", "failed", "cancelled", "broken"])
def test_a_run_that_is_not_finished(settings, tmp_path, status):
    settings.run = str(finished_run(tmp_path / "run", status=status))
    drawn = draw(result.IRGSPP_PT_result)
    assert drawn.words == result.UNFINISHED[status]
    assert not result.IRGSPP_PT_bake.poll(bpy.context) and not drawn.buttons("irgspp.import_run")


@pytest.mark.parametrize(
    ("kind", "panel"),
    [("bake", result.IRGSPP_PT_bake), ("export", export.IRGSPP_PT_export), ("render", relight.IRGSPP_PT_relight_files)],
)
def test_work_on_a_run_is_shown_where_it_was_started(settings, tmp_path, kind, panel):
    settings.run = str(finished_run(tmp_path / "run"))
    other = {"kind": kind, "title": "Another run's", "state": "running", "made": time.time() + 2}
    add_job(tmp_path, id="j0", data={"run": str(tmp_path / "other")}, **other)
    add_job(tmp_path, kind=kind, title="An old one", state="done", made=1.0, data={"run": str(tmp_path / "run")})
    assert not draw(panel).buttons("irgspp.job_cancel") and "Done" not in draw(panel).words
    job = add_job(tmp_path, id="j2", kind=kind, title="Its work", state="running", made=time.time(), data={"run": str(tmp_path / "run")})
    assert draw(panel).buttons("irgspp.job_cancel")[0].values == {"job": "j2"} and "Its work" in draw(panel).words
    job.state, job.error = "failed", "the disk is full"
    assert "the disk is full" in draw(panel).words and not draw(panel).buttons("irgspp.job_cancel")


def test_relighting_shows_progress_and_errors(settings, run_folder, monkeypatch):
    finished_run(run_folder)
    settings.run = str(run_folder)
    drawn = draw(relight.IRGSPP_PT_relight)
    assert drawn.buttons("irgspp.relight_preview")[0].live and "world" in drawn.properties
    assert drawn.buttons("wm.context_set_enum")[0].values == {"data_path": "scene.render.engine", "value": "IRGSPP"}
    follower = SimpleNamespace(ended=False, failed=False, done=False, outdated=False, share=0.4, message="Refining, 40%")
    monkeypatch.setattr(relight, "follower_of", lambda channel: follower)
    drawn = draw(relight.IRGSPP_PT_relight)
    assert ("progress", 0.4, "Refining, 40%") in drawn.drawn
    assert drawn.buttons("irgspp.relight_stop") and not drawn.buttons("irgspp.relight_preview")
    follower.done = True
    assert ("progress", 1.0, "Up to date") in draw(relight.IRGSPP_PT_relight).drawn
    follower.failed, follower.message = True, "scene Scene: has no camera"
    assert "has no camera" in draw(relight.IRGSPP_PT_relight).words
    follower.ended = True
    drawn = draw(relight.IRGSPP_PT_relight)
    assert drawn.buttons("irgspp.relight_preview") and "has no camera" in drawn.words
    follower.outdated = True  # another engine was chosen: the error was about the one before
    assert "has no camera" not in draw(relight.IRGSPP_PT_relight).words
    bpy.context.scene.render.engine = "IRGSPP"
    assert "F12" in draw(relight.IRGSPP_PT_relight).words


def test_an_edited_mesh_is_baked_as_it_is(settings, run_folder):
    settings.run, settings.triangles = str(finished_run(run_folder)), 500
    drawn = draw(result.IRGSPP_PT_bake)
    assert drawn.buttons("irgspp.bake")[0].values["triangles"] == 500 and "A new mesh of at most 500 triangles" in drawn.words
    settings.edited_mesh = bpy.data.objects.new("edited", bpy.data.meshes.new("edited"))
    drawn = draw(result.IRGSPP_PT_bake)
    values = drawn.buttons("irgspp.bake")[0].values
    assert (values["mesh"], values["triangles"]) == ("edited", 0) and "edited mesh is baked as it is" in drawn.words


def test_quads_come_before_triangles_and_after_an_edited_mesh(settings, run_folder):
    settings.run, settings.triangles, settings.bake_quads = str(finished_run(run_folder)), 500, 3000
    drawn = draw(result.IRGSPP_PT_bake)
    values = drawn.buttons("irgspp.bake")[0].values
    assert (values["quads"], values["triangles"]) == (3000, 0) and "remeshed to about 3,000 quads" in drawn.words
    settings.edited_mesh = bpy.data.objects.new("edited", bpy.data.meshes.new("edited"))
    values = draw(result.IRGSPP_PT_bake).buttons("irgspp.bake")[0].values
    assert (values["mesh"], values["quads"], values["triangles"]) == ("edited", 0, 0)


def test_heights_are_baked_where_they_are_chosen(settings, run_folder):
    settings.run = str(finished_run(run_folder))
    assert draw(result.IRGSPP_PT_bake).buttons("irgspp.bake")[0].values["height"] is False
    settings.bake_height = True
    assert draw(result.IRGSPP_PT_bake).buttons("irgspp.bake")[0].values["height"] is True


def test_bits_are_those_of_the_last_bake_until_others_are_chosen(settings, run_folder):
    settings.run = str(finished_run(run_folder))
    assert draw(result.IRGSPP_PT_bake).buttons("irgspp.bake")[0].values["bits"] == "0"
    settings.texture_bits = "16"
    assert draw(result.IRGSPP_PT_bake).buttons("irgspp.bake")[0].values["bits"] == "16"


def test_tiles_are_those_of_the_last_bake_until_others_are_chosen(settings, run_folder):
    settings.run = str(finished_run(run_folder))
    assert draw(result.IRGSPP_PT_bake).buttons("irgspp.bake")[0].values["udim"] == 0
    settings.udim_tiles = 2
    drawn = draw(result.IRGSPP_PT_bake)
    assert "udim_tiles" in drawn.properties and drawn.buttons("irgspp.bake")[0].values["udim"] == 2


def test_each_size_up_to_the_bake_has_a_button(settings, run_folder):
    settings.run = str(finished_run(run_folder, textures={"size": 1024, "baked": 4096}))
    drawn = draw(result.IRGSPP_PT_result).buttons("irgspp.bake")
    assert [(one.text, one.values["size"]) for one in drawn] == [("1k", 1024), ("2k", 2048), ("4k", 4096)]
    assert all(one.values["run"] == str(run_folder) for one in drawn)


@pytest.mark.parametrize("state", [{}, {"textures": {"size": 1024, "baked": 1024}}, {"textures": {"size": 512, "why": "as set"}}])
def test_a_bake_without_smaller_sizes_has_no_buttons(settings, tmp_path, state):
    settings.run = str(finished_run(tmp_path / "run", **state))
    assert not draw(result.IRGSPP_PT_result).buttons("irgspp.bake")


def test_no_triangles_are_said_to_keep_the_mesh(settings, run_folder):
    settings.run = str(finished_run(run_folder))
    drawn = draw(result.IRGSPP_PT_bake)
    assert drawn.buttons("irgspp.bake")[0].values["triangles"] == 0 and "0 triangles: the mesh stays as it is" in drawn.words
    for properties in (settings.bl_rna.properties, bpy.ops.irgspp.bake.get_rna_type().properties):
        assert properties["triangles"].name == "Max Triangles" and "0 keeps the mesh" in properties["triangles"].description


def test_folder_contact_sheet_and_exported_file_are_at_hand(settings, tmp_path):
    run = finished_run(tmp_path / "run")
    settings.run = str(run)
    drawn = draw(result.IRGSPP_PT_result)
    assert drawn.buttons("wm.path_open")[0].values == {"filepath": str(run)} and not drawn.buttons("irgspp.show_image")
    (run / "contact_sheet.png").touch()
    assert draw(result.IRGSPP_PT_result).buttons("irgspp.show_image")[0].values == {"filepath": str(run / "contact_sheet.png")}
    (tmp_path / "out").mkdir()
    file = tmp_path / "out" / "spot.glb"
    add_job(tmp_path, kind="export", state="done", made=time.time(), data={"run": str(run), "file": str(file)})
    assert not draw(export.IRGSPP_PT_export).buttons("wm.path_open")  # it was deleted meanwhile
    file.touch()
    (show,) = draw(export.IRGSPP_PT_export).buttons("wm.path_open")
    assert (show.text, show.values) == ("Show spot.glb", {"filepath": str(tmp_path / "out")})


def test_export_offers_each_format_what_it_can_have(settings, tmp_path):
    run = finished_run(tmp_path / "run")
    settings.run = str(run)
    settings.export_lods, settings.export_textures, settings.export_normal_map = True, "beside", "directx"
    drawn = draw(export.IRGSPP_PT_export)
    assert {"export_lods", "export_collision", "export_textures", "export_normal_map"} <= set(drawn.properties)
    values = {Path(button.values["filepath"]).suffix: button.values for button in drawn.buttons("irgspp.export")}
    assert list(values) == [".glb", ".usdc", ".usdz", ".fbx", ".obj", ".blend", ".ply", ".exr"]
    assert {suffix for suffix in values if values[suffix]["lods"]} == {".glb", ".usdc", ".usdz", ".fbx", ".obj", ".blend"}
    assert {suffix for suffix in values if values[suffix]["textures"] == "beside"} == {".usdc", ".fbx", ".obj", ".blend"}
    assert {suffix for suffix in values if values[suffix]["normal_map"] == "directx"} == {".fbx", ".obj"}
    settings.export_occlusion = True
    values = {Path(button.values["filepath"]).suffix: button.values for button in draw(export.IRGSPP_PT_export).buttons("irgspp.export")}
    assert {suffix for suffix in values if values[suffix]["occlusion"]} == {".glb", ".usdc", ".fbx", ".obj", ".blend"}
    assert all(words["as_placed"] for words in values.values())
    settings.export_textures, settings.export_as_placed = "packed", False
    values = {Path(button.values["filepath"]).suffix: button.values for button in draw(export.IRGSPP_PT_export).buttons("irgspp.export")}
    assert {suffix for suffix in values if values[suffix]["textures"] == "packed"} == {".glb", ".usdz", ".fbx", ".blend"}
    assert not any(words["as_placed"] for words in values.values())
