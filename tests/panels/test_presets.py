# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets are chosen by pictures."""

import bpy
import pytest
from irgspp.irgspp_addon.shared_properties import PRESETS
from irgspp.panels import images, presets, reconstruct
from panel_states import settings as settings
from recording_layout import draw

NAMES = [name for name, *_ in PRESETS]
PICTURES = sorted(presets.PICTURES.glob("*.png"))


def test_pictures_are_of_presets_and_differ():
    assert {"draft", "balanced", "high"} <= {file.stem for file in PICTURES} <= set(NAMES)
    assert len({file.read_bytes() for file in PICTURES}) == len(PICTURES)


@pytest.mark.parametrize("file", PICTURES, ids=lambda file: file.stem)
def test_a_picture_is_small_and_square(file):
    picture = bpy.data.images.load(str(file))
    width, height = picture.size
    bpy.data.images.remove(picture)
    assert width == height == 160 and file.stat().st_size < 60_000


def test_each_preset_has_its_picture_above_its_button(settings):
    drawn = draw(reconstruct.IRGSPP_PT_reconstruct).drawn
    assert [entry[0] for entry in drawn if entry[0] in ("picture", "choice")] == ["picture", "choice"] * len(NAMES)
    assert [entry[2] for entry in drawn if entry[0] == "choice"] == NAMES
    stand_ins = sum(entry[1] == presets.icon_number(presets.STAND_IN) for entry in drawn if entry[0] == "picture")
    assert stand_ins == len(NAMES) - len(PICTURES)


def test_without_previews_the_buttons_are_there(settings, monkeypatch):
    monkeypatch.setattr(images, "_previews", None)
    assert [entry[2] for entry in draw(reconstruct.IRGSPP_PT_reconstruct).drawn if entry[0] == "choice"] == NAMES
