# SPDX-License-Identifier: GPL-3.0-or-later
"""A relightable run, and the extension registered with an engine, for tests in Blender's process."""

from __future__ import annotations

from pathlib import Path

import blender_side
import pytest


@pytest.fixture(scope="session")
def relightable(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of a sphere with Gaussians."""
    folder = tmp_path_factory.mktemp("relit") / "ball"
    blender_side.in_engine(Path(__file__).with_name("relight_run.py"), folder)
    return folder


@pytest.fixture(scope="module")
def warm():
    """The extension's parts that relighting needs, registered; workers stay warm from test to test of a module."""
    import bpy
    from irgspp.irgspp_addon import registration

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IRGSPP_PYTHON", blender_side.ENGINE)
        bpy.ops.wm.read_homefile(use_empty=True)
        registration.register()
        yield
        registration.unregister()
