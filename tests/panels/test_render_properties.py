# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties editor while IRGS++ is the render engine: World nodes, material slots, lamps, sampling and film are there."""

from types import SimpleNamespace

import bpy
import irgspp
import pytest
from recording_layout import draw


@pytest.fixture
def context():
    """A context of the Properties editor, with the extension registered and chosen as render engine."""
    bpy.ops.wm.read_homefile()
    irgspp.register()
    scene, cube = bpy.context.scene, bpy.data.objects["Cube"]
    scene.render.engine = "IRGSPP"
    material = cube.active_material
    yield SimpleNamespace(
        engine=bpy.context.engine, scene=scene, world=scene.world, object=cube, material=material, pin_id=None, material_slot=None
    )
    irgspp.unregister()


def shown(context, tab: str) -> set[str]:
    """Names of the panels of a tab whose poll accepts the context."""
    panels = [cls for cls in bpy.types.Panel.__subclasses__() if getattr(cls, "bl_context", "") == tab]
    ours = [cls for cls in panels if context.engine in getattr(cls, "COMPAT_ENGINES", {context.engine})]
    return {cls.__name__ for cls in ours if hasattr(cls, "poll") and cls.poll(context)}


def test_the_nodes_of_the_world_are_in_its_tab(context):
    assert {"WORLD_PT_context_world", "EEVEE_WORLD_PT_surface"} <= shown(context, "world")


def test_material_slots_and_nodes_are_in_the_material_tab(context):
    assert {"EEVEE_MATERIAL_PT_context_material", "EEVEE_MATERIAL_PT_surface"} <= shown(context, "material")


@pytest.mark.parametrize("kind", ["POINT", "SUN", "SPOT", "AREA"])
def test_colour_power_and_size_of_a_lamp_are_in_its_tab(context, kind):
    context.light = bpy.data.lights.new("lamp", kind)
    names = {name for name in ("light", "EEVEE_light", "spot") if getattr(bpy.types, f"DATA_PT_{name}").poll(context)}
    assert names == {"EEVEE_light"} | ({"spot"} if kind == "SPOT" else set())


def test_samples_and_film_are_in_the_render_tab(context):
    names = shown(context, "render")
    assert {"IRGSPP_PT_render_sampling", "IRGSPP_PT_render_film", "RENDER_PT_color_management"} <= names
    assert not [name for name in names if "eevee" in name.lower() or "CYCLES" in name]  # their settings have no effect here
    drawn = [name for panel in ("sampling", "film") for name in draw(getattr(bpy.types, f"IRGSPP_PT_render_{panel}"), context).properties]
    assert drawn == ["relight_samples", "relight_denoise", "relight_backend", "use_world", "use_lamps", "ground_shadow", "film_transparent"]


def test_other_engines_do_not_show_them(context):
    context.engine = "CYCLES"
    assert not bpy.types.IRGSPP_PT_render_sampling.poll(context) and not bpy.types.IRGSPP_PT_render_film.poll(context)


def test_nothing_is_left_in_blenders_panels(context):
    irgspp.unregister()
    left = [cls.__name__ for cls in bpy.types.Panel.__subclasses__() if "IRGSPP" in getattr(cls, "COMPAT_ENGINES", ())]
    irgspp.register()
    assert not left
