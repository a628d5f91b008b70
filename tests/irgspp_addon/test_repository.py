# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender installs the extension from a static repository without warnings, and removes it."""

import importlib.util
import sys
from pathlib import Path

import bpy
import pytest

ROOT = Path(__file__).resolve().parents[2]
NAME = "self_hosted"
MODULE = f"bl_ext.{NAME}.irgspp"


@pytest.fixture
def repository(tmp_path):
    """Add a repository at a file:// address to Blender and return its index."""
    spec = importlib.util.spec_from_file_location("build_extension", ROOT / "scripts" / "build_extension.py")
    assert spec and spec.loader
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.build(tmp_path / "site")
    address = script.index(tmp_path / "site").as_uri()
    preferences = bpy.context.preferences
    online = preferences.system.use_online_access
    preferences.system.use_online_access = True
    folder = tmp_path / "installed"
    folder.mkdir()
    new = preferences.extensions.repos.new(name=NAME, module=NAME, custom_directory=str(folder), remote_url=address)
    yield next(i for i, one in enumerate(preferences.extensions.repos) if one == new)
    preferences.extensions.repos.remove(new)
    preferences.system.use_online_access = online


def test_install_from_a_static_repository_and_uninstall(repository):
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.extensions.repo_sync(repo_index=repository)
    assert bpy.ops.extensions.package_install(repo_index=repository, pkg_id="irgspp", enable_on_install=True) == {"FINISHED"}
    assert MODULE in bpy.context.preferences.addons
    assert bpy.ops.irgspp.import_run.get_rna_type().name
    assert bpy.ops.extensions.package_uninstall(repo_index=repository, pkg_id="irgspp") == {"FINISHED"}
    assert MODULE not in bpy.context.preferences.addons
    assert MODULE not in sys.modules
    assert not hasattr(bpy.types, "IRGSPP_OT_import_run")
