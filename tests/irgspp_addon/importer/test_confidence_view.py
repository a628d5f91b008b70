# SPDX-License-Identifier: GPL-3.0-or-later
"""View of the confidence: the material glows in it, and reflects light again."""

import bpy
import numpy as np
import pytest
from blender_side import write_sphere_run
from cycles_layers import render
from irgspp.irgspp_addon.importer import confidence_view
from irgspp.irgspp_addon.importer.confidence_view import confidence_shown, has_confidence
from irgspp.irgspp_addon.importer.materials import source_of, use_source
from irgspp.irgspp_addon.importer.scene_builder import import_run, show_as_photographed


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """Run whose confidence is known."""
    return write_sphere_run(tmp_path_factory.mktemp("known") / "run", confidence=True)


@pytest.fixture
def imported(known):
    bpy.ops.wm.read_homefile(use_empty=True)
    confidence_view.register()
    yield import_run(known)
    confidence_view.unregister()


def test_switch_changes_what_the_output_shows(imported):
    material = imported.mesh.active_material
    assert has_confidence(material) and not material.irgspp_show_confidence
    material.irgspp_show_confidence = True
    assert confidence_shown(material)
    use_source(material, "attributes")  # the other switch keeps its meaning
    assert material.irgspp_show_confidence and source_of(material) == "attributes"
    material.irgspp_show_confidence = False
    output = next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    assert output.inputs["Surface"].links[0].from_node.bl_idname == "ShaderNodeBsdfPrincipled"


def test_cycles_shows_the_confidence(imported, tmp_path):
    """Seen from the side, albedo's confidence (red) grows with z and roughness' (green) falls, whatever the light."""
    imported.mesh.active_material.irgspp_show_confidence = True
    scene = bpy.context.scene
    show_as_photographed(scene, imported)
    image = render(scene, tmp_path / "shown.exr", 4)
    inside = image[image[..., 3] > 0.99]
    assert len(inside) > 100 and np.allclose(inside[:, 0] + inside[:, 1], 1, atol=0.02)
    assert np.allclose(inside[:, 2], inside[:, 0] ** 2, atol=0.02)


def test_materials_without_it_stay_as_they_are(run_folder):
    material = import_run(run_folder).mesh.active_material
    assert not has_confidence(material) and not confidence_shown(material)
