# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels are redrawn without the scenes beside them."""

from types import SimpleNamespace

from irgspp.irgspp_addon import windows


def test_a_sidebar_is_redrawn_without_its_scene(monkeypatch):
    tagged = []

    def area(kind):
        regions = [SimpleNamespace(type=name, tag_redraw=lambda name=name: tagged.append((kind, name))) for name in ("WINDOW", "UI")]
        return SimpleNamespace(type=kind, regions=regions)

    monkeypatch.setattr(windows, "areas", lambda *kinds: map(area, kinds))
    windows.redraw_panels("VIEW_3D", "PROPERTIES")
    assert tagged == [("VIEW_3D", "UI"), ("PROPERTIES", "WINDOW"), ("PROPERTIES", "UI")]
