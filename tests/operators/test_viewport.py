# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered shading starts again after an error: where it is chosen again, and where another engine is chosen or checked."""

from types import SimpleNamespace

import bpy
import irgspp
import pytest
from irgspp.irgspp_addon.relight import live_image, render_engine
from mathutils import Matrix


@pytest.fixture
def context():
    """Context of a 3D View of 40x30 pixels, with the extension registered."""
    bpy.ops.wm.read_homefile(use_empty=True)
    irgspp.register()
    view = SimpleNamespace(view_matrix=Matrix(), window_matrix=Matrix())
    region = SimpleNamespace(as_pointer=lambda: 7, width=40, height=30)
    yield SimpleNamespace(scene=bpy.context.scene, region=region, region_data=view)
    irgspp.unregister()


def ended_with_an_error(context) -> live_image.Follower:
    follower = live_image.follower_of(render_engine.viewport_of(context).channel)
    follower.failed, follower.message = True, "the engine stopped"
    follower.close()
    return follower


def current(context) -> live_image.Follower:
    return live_image.follower_of(render_engine.viewport_of(context).channel)


def test_choosing_the_shading_again_tries_again(context):
    update, instance = render_engine.IRGSPP_RenderEngine.view_update, SimpleNamespace(is_known=False)
    update(instance, context, None)
    first = ended_with_an_error(context)
    update(instance, context, None)
    assert current(context) is first  # not again and again
    update(SimpleNamespace(is_known=False), context, None)
    assert current(context) is not first and not current(context).failed


def test_another_engine_tries_again(context, monkeypatch):
    first = ended_with_an_error(context)
    assert not first.outdated and current(context) is first
    monkeypatch.setattr(live_image, "_engine_state", lambda: ("/another/python", "unknown"))
    assert first.outdated and current(context) is not first
