# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings under their names of version 0.1: on the command line, and in the run.json of old runs."""

import copy

import pytest
from irgspp.core.errors import InputError
from irgspp.core.settings.overrides import differences, from_dict, to_dict, with_overrides
from irgspp.core.settings.renames import GROUPS, KEYS, current_key, current_names
from irgspp.core.settings.schema import Settings, preset

# Settings as version 0.1 wrote them into run.json: the balanced preset, with some values changed.
OLD = {
    "preset": "balanced",
    "seed": 3,
    "device": "cpu",
    "materials": "auto",
    "time": None,
    "data": {"resolution": 640, "masks": True, "holdout": 8, "split": "auto", "centre": [0.0, 0.0, 1.0], "radius": None},
    "reflective": {
        "iterations": 700,
        "gaussians": 40000,
        "normal_weight": 0.2,
        "mask_weight": 0.5,
        "sh_growth": 0.6,
        "light_height": 64,
        "light_smoothness": 0.001,
        "trial_iterations": 250,
        "trial_gaussians": 8000,
        "trial_resolution": 100,
        "trial_margin": 0.5,
    },
    "transport": {
        "points": 2500,
        "views": 8,
        "rows": 16,
        "light_height": 64,
        "indirect": False,
        "iterations": 300,
        "pixels": 256,
        "samples": 128,
        "sampling": "mis",
        "radiance_iterations": 150,
        "mesh_normals": 0.5,
        "pool": 100000,
        "normal_rate": 0.0005,
        "albedo_smoothness": 0.02,
        "roughness_smoothness": 0.05,
        "metallic_smoothness": 0.05,
        "light_smoothness": 0.0005,
        "white_balance": 0.0,
    },
    "surface": {
        "voxels": 192,
        "smoothing": 10,
        "normal_averages": 5,
        "fragment": 0.03,
        "detail": 1.0,
        "triangles": 40000,
        "texture": 1024,
    },
    "export": {"material": "textures"},
    "skip": {"outside": "off", "trials": "auto", "constants": "on", "open": "auto", "kept": "off"},
}
# Settings that came later, with their defaults.
ADDED = {
    "first.subpixels",
    "first.anchor_weight",
    "first.densification",
    "first.distortion_weight",
    "first.inter_reflections",
    "first.open_edges",
    "first.metal_regions",
    "first.single_rays",
    "first.start_trials",
    "first.stereo",
    "first.stereo_margin",
    "skip.subpixels",
}
ADDED |= {"second.distortion_weight", "second.shading_normals", "second.normal_iterations"}
ADDED |= {
    "first.gaussians_per_pixel",
    "first.unmasked_gaussians",
    "surface.voxel_pixels",
    "surface.triangles_per_pixel",
    "surface.unmasked_triangles",
    "surface.texture_least",
    "surface.texture_most",
    "surface.texture_bits",
    "surface.udim_tiles",
}
ADDED |= {"pace", "second.solver", "second.joint_iterations", "second.geometry_rate", "second.shadows", "second.brdf"}
ADDED |= {"data.exposure", "data.light", "data.mask_error", "second.surroundings", "surface.albedo_detail"} | {
    f"capture.{name}"
    for name in ("features", "frames", "matching", "masks", "resolution", "turntable", "marker", "scale", "centre", "radius")
}
CHANGED = ["seed=3", "device=cpu", "data.centre=0,0,1", "first.iterations=700", "first.gaussians=40000"]
CHANGED += [
    "second.rows=16",
    "second.indirect=off",
    "second.albedo_smoothness=0.02",
    "surface.voxels=192",
    "surface.triangles=40000",
    "surface.texture=1024",
    "skip.background=off",
    "skip.cache_hits=on",
    "skip.cache_rays=off",
]


def keys_of(settings, prefix=""):
    """Every key of nested dictionaries, such as `first.iterations`."""
    for name, value in settings.items():
        yield from keys_of(value, f"{prefix}{name}.") if isinstance(value, dict) else [prefix + name]


def test_every_old_key_has_an_existing_new_one():
    today = set(keys_of(to_dict(Settings())))
    old = set(keys_of(OLD))
    assert {current_key(key) for key in old} == today - ADDED
    assert {key for key in old if current_key(key) != key} == {k for k in old if k.partition(".")[0] in GROUPS} | set(KEYS)
    assert not {key for key in today if current_key(key) != key}  # today's names stay as they are


@pytest.mark.parametrize("new", ["first.iterations", "second.rows", "skip.background", "seed", "unknown", "skip", ""])
def test_other_keys_stay_as_they_are(new):
    assert current_key(new) == new


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("reflective.iterations=7", "first.iterations=7"),
        ("transport.rows=8", "second.rows=8"),
        ("skip.open=off", "skip.reuse_visibility=off"),
        ("skip.outside = on", "skip.background=on"),
    ],
)
def test_old_override_is_applied_with_one_line(text, same, capsys):
    old, new = text.partition("=")[0].strip(), same.partition("=")[0]
    lines = []
    assert with_overrides(Settings(), [text], lines.append) == with_overrides(Settings(), [same])
    assert lines == [f"--set {old} is now --set {new}"]
    assert capsys.readouterr().err == ""
    with_overrides(Settings(), [text])
    assert capsys.readouterr().err == f"irgspp: {lines[0]}\n"
    with_overrides(Settings(), [same])
    assert capsys.readouterr().err == ""


def test_error_in_an_old_override_names_the_new_key():
    with pytest.raises(InputError, match=r"first\.iterations"):
        with_overrides(Settings(), ["reflective.iterations=0"], lambda line: None)
    with pytest.raises(InputError, match="no such setting"):
        with_overrides(Settings(), ["reflective.nonsense=0"], lambda line: None)


def test_settings_of_an_old_run_open():
    before = copy.deepcopy(OLD)
    settings = from_dict(OLD, "run.json")
    assert before == OLD
    assert settings == with_overrides(preset("balanced"), CHANGED)
    assert [line.partition(":")[0] for line in differences(preset("balanced"), settings)] == [one.partition("=")[0] for one in CHANGED]
    assert current_names(to_dict(settings)) == to_dict(settings)


def test_an_unknown_setting_in_an_old_group_is_refused():
    with pytest.raises(InputError, match=r"run\.json.*another version"):
        from_dict({"reflective": {"nonsense": 1}}, "run.json")
