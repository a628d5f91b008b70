# SPDX-License-Identifier: GPL-3.0-or-later
"""The object as an asset: details, catalogue, preview; appended, linked and overridden in another file it keeps textures and relights."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from blender_side import write_image
from irgspp.irgspp_addon.importer.asset_collection import collection_of
from irgspp.irgspp_addon.importer.asset_mark import CATALOGUES
from irgspp.irgspp_addon.importer.run_frame import run_object
from irgspp.irgspp_addon.importer.scene_builder import import_run
from irgspp.irgspp_addon.relight import session as relight_session
from irgspp.operators.asset_mark import IRGSPP_OT_mark_asset
from irgspp.panels import asset as asset_panel
from irgspp.panels import run_state
from mathutils import Vector
from recording_layout import RecordingLayout, draw
from relighting import image_pixels, lamp

DETAILS = {"author": "A. Person", "licence": "CC-BY 4.0", "description": "a ball", "tags": "ball, metal,, ball", "catalogue": "Toys/Balls"}


@pytest.fixture
def library(scene, relightable, tmp_path):
    """The scene saved as a library, with the object marked as asset."""
    folder = tmp_path / "library"
    folder.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "ball.blend"))
    assert bpy.ops.irgspp.mark_asset(run=str(relightable), kind="OBJECT", **DETAILS) == {"FINISHED"}
    bpy.ops.wm.save_mainfile()
    return folder / "ball.blend"


def loaded(library, **how) -> bpy.types.Object:
    """Load the library's only asset into an empty file."""
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(library), assets_only=True, **how) as (source, wanted):
        assert len(source.objects) == 1
        wanted.objects = source.objects
    (thing,) = wanted.objects
    return thing


def images_of(thing):
    return [node.image for node in thing.material_slots[0].material.node_tree.nodes if node.bl_idname == "ShaderNodeTexImage"]


def test_details_and_catalogue(library, relightable):
    thing = run_object(bpy.context.scene, relightable)
    asset = thing.asset_data
    assert (asset.author, asset.license, asset.description) == ("A. Person", "CC-BY 4.0", "a ball")
    assert [tag.name for tag in asset.tags] == ["ball", "metal"]
    catalogues = (library.parent / CATALOGUES).read_text()
    assert "VERSION 1" in catalogues and f"{asset.catalog_id}:Toys/Balls:Toys-Balls\n" in catalogues
    bpy.ops.irgspp.mark_asset(run=str(relightable), kind="OBJECT", tags="other", catalogue=" Toys / Balls ")
    assert (library.parent / CATALOGUES).read_text() == catalogues and [tag.name for tag in asset.tags] == ["other"]
    bpy.ops.irgspp.mark_asset(run=str(relightable), kind="OBJECT", catalogue="Toys/New")
    assert (library.parent / CATALOGUES).read_text().startswith(catalogues) and asset.catalog_id in (
        library.parent / CATALOGUES
    ).read_text()


def test_the_dialog_of_an_asset_begins_with_its_details(library, relightable):
    tool = SimpleNamespace()
    IRGSPP_OT_mark_asset.take_details(tool, run_object(bpy.context.scene, relightable))
    assert vars(tool) == {**DETAILS, "tags": "ball, metal", "kind": "OBJECT"}


def test_the_preview_is_the_relit_object(library, relightable):
    preview = run_object(bpy.context.scene, relightable).preview
    width, height = preview.image_size
    pixels = np.empty(width * height * 4, np.float32)
    preview.image_pixels_float.foreach_get(pixels)
    pixels = pixels.reshape(height, width, 4)
    assert (width, height) == (256, 256)
    assert pixels[128, 128, 3] > 0.95 and pixels[0, 0, 3] == 0 and 0.35 < (pixels[..., 3] > 0.5).mean() < 0.8  # it fills the image
    assert pixels[..., :3][pixels[..., 3] > 0.9].std() > 0.05


def test_a_picture_of_one_s_own(scene, relightable, tmp_path):
    write_image(tmp_path / "own.exr", lamp())
    words = {"run": str(relightable), "catalogue": "", "kind": "OBJECT"}
    assert bpy.ops.irgspp.mark_asset(picture=str(tmp_path / "own.exr"), **words) == {"FINISHED"}
    assert run_object(scene, relightable).preview.is_image_custom
    with pytest.raises(RuntimeError, match="no such file"):
        bpy.ops.irgspp.mark_asset(picture=str(tmp_path / "gone.png"), **words)


def test_appended_it_is_complete(library, relightable):
    thing = loaded(library)
    bpy.context.scene.collection.objects.link(thing)
    assert thing.asset_data.author == "A. Person" and len(images_of(thing)) >= 4
    assert all(image.packed_file is not None and image.size[0] == 32 for image in images_of(thing))


def test_the_collection_has_levels_and_hulls_and_no_cameras(scene, relightable, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "ball.blend"))
    thing = run_object(scene, relightable)
    thing.location.x += 2
    words = {"run": str(relightable), "lods": True, "collision": True, **DETAILS, "catalogue": ""}
    for _ in range(2):  # marking again replaces the parts
        assert bpy.ops.irgspp.mark_asset(**words) == {"FINISHED"}
    collection = collection_of(thing)
    meshes = sorted(part.name for part in collection.all_objects if part.type == "MESH")
    hulls = [name for name in meshes if name.startswith("UCX_ball_LOD0_")]
    assert hulls and [*hulls, "ball_LOD0", "ball_LOD1", "ball_LOD2"] == meshes
    assert all(bpy.data.objects[name].hide_viewport != (name == "ball_LOD0") for name in meshes)
    assert not [part for part in collection.all_objects if part.type == "CAMERA"] and [t for t in scene.objects if t.type == "CAMERA"]
    np.testing.assert_allclose(collection.instance_offset, thing.matrix_world.translation, atol=1e-6)
    for name in hulls:
        bpy.data.objects[name].hide_viewport = False
    bounds = [np.concatenate([corners_of(bpy.data.objects[name]) for name in names]) for names in (hulls, [thing.name])]
    np.testing.assert_allclose(bounds[0].min(0), bounds[1].min(0), atol=0.1)
    np.testing.assert_allclose(bounds[0].max(0), bounds[1].max(0), atol=0.1)
    import_run(relightable)
    assert not [part for part in collection.all_objects if part.type == "CAMERA"]
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "ball.blend"), assets_only=True) as (source, wanted):
        assert not source.objects
        wanted.collections = source.collections
    (appended,) = wanted.collections
    bpy.context.scene.collection.children.link(appended)
    full = next(part for part in appended.all_objects if part.name == "ball_LOD0")
    assert appended.asset_data.author == "A. Person" and appended.preview.image_size[0] == 256
    assert all(image.packed_file is not None and image.size[0] == 32 for image in images_of(full))
    assert run_object(bpy.context.scene, relightable) == full


def corners_of(thing) -> np.ndarray:
    bpy.context.view_layer.update()
    return np.array([thing.matrix_world @ Vector(corner) for corner in thing.bound_box])


def test_one_asset_at_a_time(scene, relightable):
    thing = run_object(scene, relightable)
    for kind, others in (("OBJECT", False), ("COLLECTION", True), ("OBJECT", False)):
        bpy.ops.irgspp.mark_asset(run=str(relightable), kind=kind, catalogue="")
        assert (thing.asset_data is None, collection_of(thing).asset_data is None) == (others, not others)
    thing.users_collection[0].objects.unlink(thing)
    scene.collection.objects.link(thing)
    with pytest.raises(RuntimeError, match="not in the collection of its import"):
        bpy.ops.irgspp.mark_asset(run=str(relightable), catalogue="")


def test_an_overridden_instance_of_the_collection_relights(scene, relightable, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "ball.blend"))
    bpy.ops.irgspp.mark_asset(run=str(relightable), catalogue="")
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "ball.blend"), assets_only=True, link=True) as (source, wanted):
        wanted.collections = source.collections
    scene = bpy.context.scene
    wanted.collections[0].override_hierarchy_create(scene, bpy.context.view_layer, do_fully_editable=True)
    thing = run_object(scene, relightable)
    assert thing.override_library is not None
    lens = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(lens)
    scene.camera, lens.location = lens, (0, 0, 6)
    words = {"eye": "camera", "samples": 8, "resolution": 48, "use_world": False}
    assert bpy.ops.irgspp.relight_preview(run=str(relightable), **words) == {"FINISHED"}
    assert image_pixels()[..., 3].max() > 0.9


@pytest.mark.parametrize("packed", [True, False])
def test_linked_and_overridden_it_relights(library, relightable, packed):
    if not packed:
        bpy.ops.irgspp.import_run(directory=str(relightable), pack=False)
        bpy.ops.file.make_paths_relative()
        bpy.ops.wm.save_mainfile()
    linked = loaded(library, link=True, relative=False)
    scene = bpy.context.scene
    assert all(image.size[0] == 32 for image in images_of(linked))
    linked_root = linked.override_hierarchy_create(scene, bpy.context.view_layer)
    thing = linked_root if linked_root.type == "MESH" else run_object(scene, relightable)
    assert thing.override_library is not None and run_object(scene, relightable) == thing
    scene.world = bpy.data.worlds.new("grey")
    scene.world.color = (0.5, 0.5, 0.5)
    lens = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(lens)
    scene.camera, lens.location = lens, (0, 0, 6)
    words = {"eye": "camera", "samples": 8, "resolution": 48}
    assert bpy.ops.irgspp.relight_preview(run=str(relightable), **words) == {"FINISHED"}
    shown = image_pixels().copy()
    assert shown[..., 3].max() > 0.9
    thing.location.x += 0.5
    bpy.context.view_layer.update()
    bpy.ops.irgspp.relight_preview(run=str(relightable), **words)
    assert np.abs(image_pixels() - shown).max() > 0.1
    with pytest.raises(RuntimeError, match="linked from another file"):
        bpy.ops.irgspp.mark_asset(run=str(relightable), catalogue="")


def test_errors_and_missing_engine(scene, relightable, tmp_path, monkeypatch, capfd):
    run = str(relightable)
    with pytest.raises(RuntimeError, match="has not been saved"):
        bpy.ops.irgspp.mark_asset(run=run)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    with pytest.raises(RuntimeError, match="without colons"):
        bpy.ops.irgspp.mark_asset(run=run, catalogue="a:b")
    (tmp_path / CATALOGUES).mkdir()
    with pytest.raises(RuntimeError, match="can't be read or written"):
        bpy.ops.irgspp.mark_asset(run=run)
    relight_session.close_all()
    monkeypatch.setenv("IRGSPP_PYTHON", "/no/such/python")
    assert bpy.ops.irgspp.mark_asset(run=run, catalogue="") == {"FINISHED"}
    assert "The preview is Blender's own" in capfd.readouterr().out


def test_the_dialog_asks_for_the_details_alone(scene):
    layout = RecordingLayout()
    IRGSPP_OT_mark_asset.draw(
        SimpleNamespace(layout=layout, kind="COLLECTION", bl_rna=bpy.ops.irgspp.mark_asset.get_rna_type()), bpy.context
    )
    assert layout.properties == ["kind", "lods", "collision", "author", "licence", "description", "tags", "catalogue", "picture"]


def test_the_panel(scene, relightable):
    run_state._known.clear()
    bpy.context.view_layer.objects.active = run_object(scene, relightable)
    assert asset_panel.IRGSPP_PT_asset.poll(bpy.context)
    assert draw(asset_panel.IRGSPP_PT_asset).buttons("irgspp.mark_asset")
    bpy.ops.irgspp.mark_asset(run=str(relightable), author="A. Person", catalogue="")
    assert "A. Person" in draw(asset_panel.IRGSPP_PT_asset).words
    scene.irgspp.export_lods = True
    (mark,) = draw(asset_panel.IRGSPP_PT_asset).buttons("irgspp.mark_asset")
    assert mark.values["lods"] and not mark.values["collision"]
