# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables, charts and notes that the benchmark's sections make from records."""

import pytest
from scripts_folder import script as script


@pytest.fixture
def shown(script, tmp_path):
    """Return a function that gives a section's blocks by their type, for the metrics of some configurations."""

    def show(name, records):
        module, store = script(f"benchmarks.{name}"), script("benchmarks.store")
        kept = store.Store(tmp_path)
        for configuration, figures in records.items():
            kept.add(store.Record(name, "ball", configuration, figures=figures, counted={"samples": 1}))
        found = {}
        for block in module.blocks(store.Results(kept, name)):
            found.setdefault(type(block).__name__, []).append(block)
        return found

    return show


def test_skipped_work_is_told_as_what_it_saves_and_what_it_costs(shown):
    job = {"chosen": "", "evidence": "", "cpu_seconds": 1.0}
    records = {
        "auto": {**job, "seconds": 80.0, "relight_psnr": 30.0, "normal_mae": 2.5},
        "all off": {**job, "seconds": 100.0, "relight_psnr": 30.1, "normal_mae": 2.4},
        "trials": {**job, "chosen": "on", "evidence": "0.9 dB behind", "seconds": 90.0, "relight_psnr": 30.0, "normal_mae": 2.5},
        "converged": {"chosen": "off", "evidence": "still gaining"},
    }
    together, alone = shown("skipping", records)["Table"]
    row = dict(zip(together.columns, together.rows[0], strict=True))
    assert (row["seconds with ↓"], row["saved"]) == (80.0, "20 %")
    assert (row["relit dB ↑ added"], row["normals ° ↓ added"]) == ("-0.10", "+0.10")
    rows = {row[0]: row for row in alone.rows}
    assert rows["converged, ball"][-1] == "kept: still gaining" and rows["converged, ball"][1] is None
    assert rows["trials, ball"][3] == "11 %" and rows["trials, ball"][-1] == "0.9 dB behind"


def test_time_budgets_are_curves_beside_the_presets(shown):
    figures = {
        "relight_psnr": 30.0,
        "nvs_psnr": 31.0,
        "normal_mae": 3.0,
        "cpu_seconds": 1.0,
        "peak_memory_bytes": 2**30,
        "read_seconds": 0.5,
    }
    records = {f"balanced, {m} min": {**figures, "seconds": 60.0 * m, "relight_psnr": 28.0 + m} for m in (2, 1)}
    records |= {"balanced": {**figures, "seconds": 110.0}, "without indirect light": {**figures, "seconds": 100.0, "relight_psnr": 29.0}}
    blocks = shown("reconstruction", records)
    curves = {series.label: series for series in blocks["Chart"][0].panels["ball"]}
    assert (list(curves["balanced --time"].x), list(curves["balanced --time"].y)) == ([60.0, 120.0], [29.0, 30.0])
    assert (list(curves["balanced"].x), curves["balanced"].line) == ([110.0], False)
    parts = next(table for table in blocks["Table"] if "2DGRT" in table.title)
    assert [row[:3] for row in parts.rows] == [["ball, balanced", 110.0, 30.0], ["ball, without indirect light", 100.0, 29.0]]


def test_time_that_made_it_worse_is_told(shown):
    runs = {1: 30.0, 2: 31.0, 4: 30.5}
    records = {f"balanced, {m} min": {"seconds": 60.0 * m, "relight_psnr": psnr, "cpu_seconds": 1.0} for m, psnr in runs.items()}
    presets = {
        preset: {"seconds": 50.0, "relight_psnr": 30.0, "peak_memory_bytes": 1, "cpu_seconds": 1.0} for preset in ("balanced", "draft")
    }
    told = [note.text for note in shown("reconstruction", records | presets)["Note"] if "good" in note.text]
    assert told == ["More time than did good: ball: 0.5 dB relit lost from 120 to 240 s."]


def test_the_slope_of_random_samples_is_told(shown):
    points = {n: {"samples": n, "rms_error": n**-0.5, "converged_psnr": 30.0, "seconds": 0.1, "true_psnr": 20.0} for n in (16, 64, 256)}
    blocks = shown("relighting", {f"without denoiser, {n} samples": figures for n, figures in points.items()})
    table = next(t for t in blocks["Table"] if "slope (−0.5: Monte Carlo)" in t.columns)
    assert table.rows[0][table.columns.index("slope (−0.5: Monte Carlo)")] == pytest.approx(-0.5)


def test_who_was_raced_against_is_told_in_a_sentence_and_who_was_faster_by_name(script, tmp_path):
    store = script("benchmarks.store")
    kept = store.Store(tmp_path)
    for samples, ratio in ((4, 0.85), (16, 5.6)):
        figures = {"samples": samples, "Other: times as long": ratio, "Slow: times as long": 3.0}
        kept.add(store.Record("peers", "ball", f"to our error, {samples}", figures=figures))
    every, worse = (block.text for block in script("benchmarks.summary").blocks(kept))
    assert "Other 0.85 to 5.6; Slow 3." in every
    assert worse == "Not faster than others: Other, ball to our error at 4 samples, 0.85 times as long."


def test_what_another_optimiser_does_better_in_the_same_time_is_told(script, tmp_path):
    store = script("benchmarks.store")
    kept = store.Store(tmp_path)
    figures = {"relight_psnr": 30.0, "environment_psnr": 14.0, "roughness_mae": 0.2}
    kept.add(store.Record("peers", "ball", "inverse: our second stage", figures=figures))
    kept.add(store.Record("peers", "ball", "inverse: Mitsuba, 1 x", figures={**figures, "relight_psnr": 25.0, "environment_psnr": 17.0}))
    relit, worse = (block.text for block in script("benchmarks.summary").blocks(kept))
    assert relit.endswith("ball 30.0 and 25.0 dB.")
    assert worse == "Mitsuba's is better in: light dB of ball, 14.00 and 17.00."


@pytest.mark.parametrize(("theirs", "factor"), [(29.0, 8.0), (30.0, 8.0), (30.1, None)])
def test_irgs_rate_is_compared_at_equal_or_better_quality(script, shown, tmp_path, theirs, factor):
    way = {"relight_ssim": 0.9, "turned_seconds": 1.0, "train_seconds": 60.0}
    records = {
        "headline, IRGS with its BRDF": {**way, "relight_psnr": theirs, "frame_seconds": 2.0},
        "headline, IRGS++ efficient": {**way, "relight_psnr": 30.0, "frame_seconds": 0.25},
        "balanced": {"seconds": 100.0, "relight_psnr": 30.0, "cpu_seconds": 1.0, "peak_memory_bytes": 2**30},
    }
    blocks = shown("reconstruction", records)
    table = next(table for table in blocks["Table"] if "headline" in table.title)
    assert [row[table.columns.index("times as fast ↑")] for row in table.rows] == [1.0, factor]
    assert any("1,024 pixels" in note.text and "at equal or better quality" in note.text for note in blocks["Note"])
    store = script("benchmarks.store")
    kept = store.Store(tmp_path, fresh=True)
    kept.scenes["ball"] = {}
    for irgs in (False, True):
        for configuration, figures in records.items():
            if irgs or "BRDF" not in configuration:
                kept.add(store.Record("reconstruction", "ball", configuration, figures=figures))
        table, *notes = script("benchmarks.summary").blocks(kept)
        assert ("times IRGS' rate ↑" in table.columns) == irgs == any("equal or better quality" in note.text for note in notes)
    assert table.rows[0][-1] == factor and len(table.rows[0]) == len(table.columns)
