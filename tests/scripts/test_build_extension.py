# SPDX-License-Identifier: GPL-3.0-or-later
"""The zip is small and contains exactly what it should; the repository's listing leads to it."""

import ast
import hashlib
import importlib.util
import json
import shutil
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("build_extension", ROOT / "scripts" / "build_extension.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def archive(script, tmp_path_factory):
    return script.build(tmp_path_factory.mktemp("dist"))


@pytest.fixture
def copied(script, tmp_path, monkeypatch):
    """Give the script a root of its own with the least that Blender's tool accepts as an extension."""
    root = tmp_path / "source"
    for name in script.CONTENT:
        path = root / name
        if path.suffix or name == "LICENSE":
            path.parent.mkdir(exist_ok=True)
            shutil.copyfile(ROOT / name, path)
        else:
            path.mkdir(parents=True)
            (path / "__init__.py").touch()
    monkeypatch.setattr(script, "ROOT", root)
    return root


def test_zip_is_small_and_holds_no_libraries_tests_or_documents(archive):
    names = zipfile.ZipFile(archive).namelist()
    assert archive.stat().st_size < 2_000_000  # code and the demo, 1.5 MB; any library or render would be far more
    top = {name.split("/")[0] for name in names}
    assert not top & {"tests", "scripts", "typings", "docs", "dist", "demo", "wheels", "README.md"}
    assert not [name for name in names if any(part.startswith(".") for part in Path(name).parts)]
    kinds = {Path(name).suffix for name in names if not name.endswith("/")}
    assert kinds <= {".py", ".toml", ".lock", ".sha256", ".json", ".npz", ".png", ".exr", ".md", ".jinja", ""}


def test_manifest_names_no_wheels_and_asks_for_no_more_than_is_used():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    assert "wheels" not in manifest
    assert set(manifest["permissions"]) == {"files", "network"}
    assert manifest["blender_version_min"] == "4.2.0" and "blender_version_max" not in manifest


def test_zip_holds_what_the_managed_engine_is_installed_from(archive):
    names = zipfile.ZipFile(archive).namelist()
    assert {"requirements.lock", "pyproject.toml", "__main__.py", "core/cli/main.py", "irgspp_addon/launch.py"} <= set(names)


def test_zip_holds_the_template_of_the_report(archive):
    assert "core/evaluation/report.html.jinja" in zipfile.ZipFile(archive).namelist()


def test_every_module_that_is_imported_is_in_the_zip(archive):
    """Relative imports of the packed files lead to packed files."""
    files = zipfile.ZipFile(archive)
    names = set(files.namelist())
    lost = []
    for name in names:
        if not name.endswith(".py"):
            continue
        for node in ast.walk(ast.parse(files.read(name))):
            if isinstance(node, ast.ImportFrom) and node.level:
                folder = Path(name).parents[node.level - 1].joinpath(*(node.module or "").split("."))
                found = {f"{folder.as_posix()}.py", f"{folder.as_posix()}/__init__.py".removeprefix("./")}
                if not found & names:
                    lost.append((name, node.module))
    assert not lost


def test_repository_list_leads_to_the_zip(script, archive, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["build_extension.py", "-o", str(archive.parent), "--repository"])
    assert script.main() == 0
    assert capsys.readouterr().out.split() == [str(archive), str(archive.parent / "index.json")]
    (listed,) = json.loads((archive.parent / "index.json").read_text())["data"]
    packed = (archive.parent / listed["archive_url"]).read_bytes()
    assert listed["id"] == "irgspp" and listed["archive_size"] == len(packed)
    assert listed["archive_hash"] == f"sha256:{hashlib.sha256(packed).hexdigest()}"
    assert "IRGS++" in (archive.parent / "index.html").read_text()


def test_stray_file_is_refused(script, copied, tmp_path):
    script.build(tmp_path / "dist")
    (copied / "holiday.blend").write_bytes(b"...")
    with pytest.raises(SystemExit, match=r"holiday\.blend in .* would get into the zip"):
        script.build(tmp_path / "dist2")
    assert not list((tmp_path / "dist2").iterdir())


def test_missing_part_is_refused(script, copied, tmp_path):
    (copied / "requirements.lock").unlink()
    with pytest.raises(SystemExit, match=r"lacks requirements\.lock"):
        script.build(tmp_path / "dist")


def test_large_file_is_refused(script, copied, tmp_path, monkeypatch):
    monkeypatch.setattr(script, "LARGEST", 1000)
    with pytest.raises(SystemExit, match="more than 1000"):
        script.build(tmp_path / "dist")


def test_bad_manifest_is_refused(script, copied, tmp_path):
    manifest = copied / "blender_manifest.toml"
    manifest.write_text(manifest.read_text().replace('"Lighting"', '"Lightning"'))
    with pytest.raises(SystemExit, match="Lightning"):
        script.build(tmp_path / "dist")
