# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension is installed from its zip, registered, used, and removed without traces."""

import importlib.util
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import addon_utils
import bpy
import pytest
from blender_side import ENGINE

ROOT = Path(__file__).resolve().parents[2]
MODULE = "bl_ext.user_default.irgspp"


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    spec = importlib.util.spec_from_file_location("build_extension", ROOT / "scripts" / "build_extension.py")
    assert spec and spec.loader
    build_extension = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(build_extension)
    return build_extension.build(tmp_path_factory.mktemp("dist"))


@pytest.fixture
def extension(archive):
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=str(archive), repo="user_default", enable_on_install=True, overwrite=True)
    assert MODULE in bpy.context.preferences.addons
    yield sys.modules[MODULE]
    addon_utils.disable(MODULE, default_set=True)


def test_zip_holds_the_package_and_nothing_else(archive):
    names = zipfile.ZipFile(archive).namelist()
    packed = {"blender_manifest.toml", "__init__.py", "LICENSE", "core/demo_data/meta.json", "irgspp_addon/importer/scene_builder.py"}
    packed |= {f"irgspp_addon/pictures/{name}.png" for name in ("draft", "balanced", "high")}
    assert packed <= set(names)
    top = {name.split("/")[0] for name in names}
    assert not top & {"tests", "scripts", "typings", ".venv", ".git", ".ci", "docs", "dist"}
    assert not [name for name in names if name.endswith((".pyc", ".zip", ".part"))]


def test_versions_agree():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (manifest["version"], manifest["id"]) == (project["version"], project["name"])


def test_enabling_brings_operator_menu_and_preferences(extension):
    assert bpy.ops.irgspp.import_run.get_rna_type().name == "Import IRGS++ Run"
    assert bpy.context.preferences.addons[MODULE].preferences.engine_python == ""
    drawn = [f.__module__ for f in bpy.types.TOPBAR_MT_file_import._dyn_ui_initialize()]
    assert drawn.count(f"{MODULE}.operators.import_run") == 1
    # Blender warns if an extension adds top-level modules.
    inside = extension.__path__[0]
    ours = {name for name, module in sys.modules.items() if str(getattr(module, "__file__", None) or "").startswith(inside)}
    assert ours and not [name for name in ours if not name.startswith(MODULE)]


def test_disabling_removes_everything(extension):
    for _ in range(2):
        addon_utils.disable(MODULE, default_set=False)
        assert not hasattr(bpy.types, "IRGSPP_OT_import_run")
        assert not [f for f in bpy.types.TOPBAR_MT_file_import._dyn_ui_initialize() if "irgspp" in f.__module__]
        assert addon_utils.enable(MODULE, default_set=False) is not None
        assert hasattr(bpy.types, "IRGSPP_OT_import_run")


def test_import_operator(extension, run_folder):
    assert bpy.ops.irgspp.import_run(directory=str(run_folder), material="attributes", as_photographed=True) == {"FINISHED"}
    (mesh,) = [o for o in bpy.context.scene.objects if o.type == "MESH"]
    assert mesh.active_material.name == "sphere"
    assert bpy.context.scene.world.name == "sphere light"
    assert bpy.context.view_layer.objects.active is mesh and list(bpy.context.selected_objects) == [mesh]


def test_import_operator_reports_a_folder_that_is_not_a_run(extension, tmp_path):
    with pytest.raises(RuntimeError, match=r"cameras\.json: can't be read"):
        bpy.ops.irgspp.import_run(directory=str(tmp_path))
    with pytest.raises(RuntimeError, match="none is chosen"):
        bpy.ops.irgspp.import_run()


def test_command_line_runs_the_engine_of_the_extension(extension, capfd, monkeypatch):
    engine = sys.modules[f"{MODULE}.irgspp_addon.engine.process"]
    assert engine.engine_python() == ENGINE
    assert engine.run_engine(["devices", "--json"]) == 0
    assert '"cpu"' in capfd.readouterr().out
    assert engine.run_engine(["inspect", "/no/such/folder"]) == 2
    monkeypatch.setenv("IRGSPP_PYTHON", "/no/such/python")
    assert engine.run_engine(["devices"]) == 2
    assert "irgspp: " in (errors := capfd.readouterr().err) and "/no/such/python" in errors


def test_launcher_runs_its_own_folder_under_any_name(archive, tmp_path):
    """The launcher runs the code of its own folder, not another package of the same name, and keeps its modules off the path."""
    folder = tmp_path / "another-name"
    zipfile.ZipFile(archive).extractall(folder)
    (folder / "probe.py").write_text("import sys, irgspp\nprint(irgspp.__file__, __name__, sys.argv[1:], 'ply' in sys.modules)\nimport ply")
    command = [sys.executable, str(folder / "irgspp_addon" / "launch.py"), "probe", "a", "b"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == f"{folder / '__init__.py'} __main__ ['a', 'b'] False"
    assert "No module named 'ply'" in done.stderr


def test_importing_the_package_loads_neither_blender_nor_torch():
    code = (
        "import sys, irgspp; assert not {'bpy', 'torch', 'numba'} & set(sys.modules);"
        "assert {'reconstruct', 'load_dataset', 'Settings'} <= set(dir(irgspp));"
        "print(irgspp.Settings().preset, hasattr(irgspp, 'nonsense'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["balanced", "False"]
