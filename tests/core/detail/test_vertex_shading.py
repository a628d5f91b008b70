# SPDX-License-Identifier: GPL-3.0-or-later
"""Shading of vertices: a light that turns, and metal."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.detail.photographs import find_full_size_photographs
from irgspp.core.detail.vertex_shading import NO_METAL, VertexShading
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.relight.relighter import Relighter
from irgspp.core.settings.schema import DataSettings
from irgspp.core.shading.environment_lookup import turned

QUARTER_TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def shading(written, light, metallic=0.0):
    """Shading of the sphere, of one metallic, under a light map."""
    mesh = replace(written.mesh, metallic=np.full_like(written.mesh.metallic, metallic))
    relighter = Relighter(written.reconstruction, MeshQuery(mesh, 1.0), RelightSettings(denoise="off"))
    return VertexShading(mesh, relighter, light, 1.0)


def seen(found):
    """Vertices that the camera sees not too obliquely."""
    return found.factor.min(1) > 0.2 * found.factor.max()


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_a_turned_light_shades_as_its_turned_map_does(written, metallic):
    camera, light = written.cameras()["r_1"], written.reconstruction.environment_map()
    found = shading(written, light, metallic).seen_by(camera, QUARTER_TURN)
    expected = shading(written, turned(light, QUARTER_TURN), metallic).seen_by(camera)
    still = shading(written, light, metallic).seen_by(camera)
    inside = seen(expected)
    assert inside.sum() > 300
    for now, then, before in ((found.factor, expected.factor, still.factor), (found.gloss, expected.gloss, still.gloss)):
        error, change = (np.abs(part - then)[inside].mean() for part in (now, before))
        assert error < 0.05 * then[inside].mean() + 1e-4  # of noise
        assert error < 0.3 * change


@pytest.mark.parametrize("metallic", [0.0, NO_METAL])
def test_an_object_without_metal_is_shaded_at_once(written, metallic, monkeypatch):
    light, camera, calls = written.reconstruction.environment_map(), written.cameras()["r_4"], []
    reflected = Relighter.reflected
    monkeypatch.setattr(Relighter, "reflected", lambda *arguments: calls.append(1) or reflected(*arguments))
    found = shading(written, light, metallic).seen_by(camera)
    assert len(calls) == 2  # one for the irradiance of all vertices
    expected = shading(written, light, 1.001 * NO_METAL).seen_by(camera)  # by both parts of the specular lobe
    assert len(calls) == 5
    inside = seen(expected)
    assert np.allclose(found.factor[inside], expected.factor[inside], rtol=0.05)
    assert np.allclose(found.gloss[inside], expected.gloss[inside], rtol=0.05, atol=1e-3)


def test_photographs_know_how_their_light_was_turned(written):
    settings = DataSettings(resolution=80, exposure="off", holdout=1000)
    found, missing = find_full_size_photographs(written.folder, settings, written.views(QUARTER_TURN))
    assert len(found) == 10 and not missing
    assert all((one.light_rotation == QUARTER_TURN).all() for one in found)
