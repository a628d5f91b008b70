# SPDX-License-Identifier: GPL-3.0-or-later
"""A project that is moved keeps its links, and a result has one owner wherever its folder is."""

import json
import shutil
from pathlib import Path

import bpy
import irgspp
import pytest
from irgspp.irgspp_addon.importer.run_root import run_of
from irgspp.panels import result, run_state
from recording_layout import draw


@pytest.fixture
def project(tmp_path, run_folder):
    """A project folder with photographs and a finished run in it, and the extension registered."""
    bpy.ops.wm.read_homefile(use_empty=True)
    irgspp.register()
    folder = tmp_path / "project"
    shutil.copytree(run_folder.parent / "photographs", folder / "photos")
    shutil.copytree(run_folder, folder / "photos_irgspp")
    cameras = json.loads((folder / "photos_irgspp" / "cameras.json").read_text())
    for camera in cameras:
        camera["picture"] = str(folder / "photos" / Path(camera["picture"]).name)
    (folder / "photos_irgspp" / "cameras.json").write_text(json.dumps(cameras))
    (folder / "photos_irgspp" / "run.json").write_text('{"status": "done", "training": {}, "skipped": [], "dataset": "x"}')
    run_state._known.clear()
    yield folder
    irgspp.unregister()


def counts() -> tuple[int, ...]:
    data = bpy.data
    return tuple(map(len, (data.objects, data.meshes, data.cameras, data.collections, data.worlds, data.materials, data.images)))


def saved(project: Path) -> tuple[int, ...]:
    """Import the run, save the file, and return the numbers of datablocks."""
    settings = bpy.context.scene.irgspp
    settings.dataset, settings.inspected = str(project / "photos"), '{"rows": [], "warnings": []}'
    assert bpy.ops.irgspp.import_run(directory=str(project / "photos_irgspp")) == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "scene.blend"))
    return counts()


def opened(place: Path) -> bpy.types.Object:
    """Open the file and return the object of the run."""
    bpy.ops.wm.open_mainfile(filepath=str(place / "scene.blend"))
    run_state.resolved.cache_clear()
    return next(thing for thing in bpy.context.scene.objects if thing.type == "MESH")


def test_a_moved_project_finds_its_run_and_photographs(project, tmp_path, capfd):
    before = saved(project)
    place = tmp_path / "elsewhere" / "renamed"
    shutil.move(project, place)
    thing = opened(place)
    printed = capfd.readouterr()
    assert "Unable to pack" not in printed.out + printed.err  # packed textures are not looked for at their old place
    settings = bpy.context.scene.irgspp
    assert run_of(thing) == (place / "photos_irgspp").resolve()
    assert settings.dataset_path() == place / "photos" and settings.run_path() == place / "photos_irgspp" and settings.inspected
    backgrounds = [camera.data.background_images[0].image for camera in bpy.context.scene.objects if camera.type == "CAMERA"]
    assert len(backgrounds) == 3 and all(Path(bpy.path.abspath(image.filepath)).parent == place / "photos" for image in backgrounds)
    assert draw(result.IRGSPP_PT_result).buttons("irgspp.import_run")[0].text == "Import Again"
    bpy.ops.irgspp.import_run(directory=str(place / "photos_irgspp"))
    assert counts() == before


def test_a_copied_project_belongs_to_its_copy(project, tmp_path):
    saved(project)
    shutil.copytree(project, tmp_path / "copy")
    assert run_of(opened(tmp_path / "copy")) == (tmp_path / "copy" / "photos_irgspp").resolve()
    assert run_of(opened(project)) == (project / "photos_irgspp").resolve()


def test_a_blend_file_that_moved_alone_keeps_its_links(project, tmp_path):
    saved(project)
    (tmp_path / "alone").mkdir()
    shutil.move(project / "scene.blend", tmp_path / "alone" / "scene.blend")
    assert run_of(opened(tmp_path / "alone")) == (project / "photos_irgspp").resolve()
    assert bpy.context.scene.irgspp.dataset_path() == project / "photos"


@pytest.mark.parametrize("saved_before", [True, False])
def test_linked_images_are_relative(project, tmp_path, saved_before):
    """Textures, light and photographs, whether the file was saved before the import or only afterwards."""
    if saved_before:
        bpy.ops.wm.save_as_mainfile(filepath=str(project / "scene.blend"))
    bpy.ops.irgspp.import_run(directory=str(project / "photos_irgspp"), pack=False)
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "scene.blend"))
    shutil.move(project, tmp_path / "elsewhere")
    opened(tmp_path / "elsewhere")
    assert len(bpy.data.images) == 8
    for image in bpy.data.images:
        assert image.filepath.startswith("//") and image.packed_file is None
        assert Path(bpy.path.abspath(image.filepath)).is_file() and image.size[0] > 0


def test_a_file_that_moved_alone_finds_linked_images(project, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "scene.blend"))
    bpy.ops.irgspp.import_run(directory=str(project / "photos_irgspp"), pack=False)
    bpy.ops.wm.save_mainfile()
    (tmp_path / "elsewhere").mkdir()
    shutil.move(project / "scene.blend", tmp_path / "elsewhere" / "scene.blend")
    opened(tmp_path / "elsewhere")
    assert all(Path(bpy.path.abspath(image.filepath)).is_file() and image.size[0] > 0 for image in bpy.data.images)


def test_a_run_that_moved_alone_is_said_to_be_gone_and_gets_one_owner(project, tmp_path):
    before = saved(project)
    shutil.move(project / "photos_irgspp", tmp_path / "other_name")
    run_state._known.clear()
    thing = opened(project)
    bpy.context.view_layer.objects.active = thing
    drawn = draw(result.IRGSPP_PT_result)
    assert "is not there any more" in drawn.words and drawn.buttons("irgspp.import_run")
    thing.location.x = 2.0
    bpy.ops.irgspp.import_run(directory=str(tmp_path / "other_name"))
    assert counts() == before and run_of(thing) == (tmp_path / "other_name").resolve() and thing.location.x == 2.0


def test_another_run_is_not_taken_for_one_that_is_gone(project, run_folder):
    saved(project)
    shutil.copytree(run_folder, project / "second")
    (project / "second" / "reconstruction.json").write_text(json.dumps({"bound": {"centre": [1, 0, 0]}, "to_world": [1.0] * 16}))
    shutil.rmtree(project / "photos_irgspp")
    first = next(thing for thing in bpy.context.scene.objects if thing.type == "MESH")
    bpy.ops.irgspp.import_run(directory=str(project / "second"))
    assert run_of(first) == project / "photos_irgspp" and len([t for t in bpy.context.scene.objects if t.type == "MESH"]) == 2
