# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings: overrides are typed by the annotations, errors name similar keys, JSON round trip."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from irgspp.core.errors import InputError
from irgspp.core.relight.sample_counts import sample_counts
from irgspp.core.settings.overrides import check, differences, from_dict, overrides_from, to_dict, with_overrides
from irgspp.core.settings.schema import PRESETS, Settings, preset


@pytest.mark.parametrize(
    ("text", "read", "expected"),
    [
        ("seed=7", lambda s: s.seed, 7),
        ("first.iterations=600", lambda s: s.first.iterations, 600),
        ("data.masks=no", lambda s: s.data.masks, False),
        ("second.indirect=off", lambda s: s.second.indirect, False),
        ("data.masks = TRUE", lambda s: s.data.masks, True),
        ("data.centre=1,-2.5,3e-1", lambda s: s.data.centre, (1.0, -2.5, 0.3)),
        ("data.centre=none", lambda s: s.data.centre, None),
        ("data.radius=2", lambda s: s.data.radius, 2.0),
        ("export.material=attributes", lambda s: s.export.material, "attributes"),
    ],
)
def test_override_is_typed(text, read, expected):
    value = read(with_overrides(Settings(), [text]))
    assert value == expected
    assert type(value) is type(expected)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("first.iteration=4", "first.iterations"),
        ("iterations=4", "first.iterations"),
        ("preset=draft", "no such setting"),
        ("data=3", "no such setting"),
        ("seed", "key=value"),
        ("seed=x", "whole number"),
        ("seed=1.5", "whole number"),
        ("seed=-1", "out of range"),
        ("second.rows=5", "multiple of 2"),
        ("data.radius=0", "out of range"),
        ("data.radius=nan", "not a number"),
        ("data.radius=inf", "not a number"),
        ("data.centre=1,2", "3 values"),
        ("data.masks=maybe", "true or false"),
        ("device=gpu", "auto, cpu, cuda"),
    ],
)
def test_bad_override_is_reported_in_one_line(text, words):
    with pytest.raises(InputError) as error:
        with_overrides(Settings(), [text])
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_valid_and_survive_json(name):
    settings = preset(name)
    assert settings.preset == name
    assert from_dict(json.loads(json.dumps(to_dict(check(settings))))) == settings


def test_schedule_of_the_paper():
    paper = preset("paper")
    assert paper.data.resolution == 800
    assert (paper.first.iterations, paper.first.gaussians) == (50_000, 100_000)
    assert (paper.second.iterations, paper.second.pixels * paper.second.samples) == (10_000, 1 << 18)
    assert paper.second.samples == sum(sample_counts("hq", False)) == 512
    assert [sum(sample_counts("efficient", glossy)) for glossy in (False, True)] == [32, 16]


def test_unknown_preset():
    with pytest.raises(InputError, match="draft, balanced, high, paper"):
        preset("fast")


@given(st.integers(0, 2**31 - 1), st.tuples(*[st.floats(-1e6, 1e6)] * 3), st.booleans())
def test_any_valid_override_survives_json(seed, centre, masks):
    texts = [f"seed={seed}", f"data.centre={','.join(map(repr, centre))}", f"data.masks={masks}"]
    settings = with_overrides(Settings(), texts)
    assert (settings.seed, settings.data.centre, settings.data.masks) == (seed, centre, masks)
    assert from_dict(json.loads(json.dumps(to_dict(settings)))) == settings


def test_settings_of_another_version_are_refused():
    with pytest.raises(InputError, match=r"run\.json"):
        from_dict({"data": {"colour": "blue"}}, "run.json")


def test_differences_name_the_setting():
    assert differences(preset("draft"), with_overrides(preset("draft"), ["seed=3"])) == ["seed: 0 -> 3"]


def test_overrides_lead_from_one_settings_to_another():
    texts = ["data.centre=1.0,-2.5,0.3", "data.radius=2.0", "second.indirect=false", "first.normal_weight=1e-07", "seed=4"]
    changed = with_overrides(preset("draft"), texts)
    found = overrides_from(preset("draft"), changed)
    assert set(found) == set(texts) and with_overrides(preset("draft"), found) == changed
    assert overrides_from(changed, preset("draft"))[:1] == ["seed=0"] and "data.radius=none" in overrides_from(changed, preset("draft"))


@pytest.mark.parametrize("solver", ["closed", "closed+joint"])
def test_a_brdf_that_the_solver_would_ignore_is_refused(solver):
    words = rf"second\.brdf: .*second\.solver={solver.replace('+', '.')} would ignore it.*--set second\.solver=joint"
    with pytest.raises(InputError, match=words):
        with_overrides(Settings(), ["second.brdf=irgs", f"second.solver={solver}"])
    for texts in (["second.brdf=irgs", "second.solver=joint"], ["second.solver=joint", "second.brdf=irgs"]):
        assert with_overrides(Settings(), texts).second.brdf == "irgs"
