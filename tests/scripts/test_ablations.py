# SPDX-License-Identifier: GPL-3.0-or-later
"""Ablation tables: every variant is evaluated once, with the choices that its name says; the evaluation is a stub."""

import json
import os
import time

import pytest
from irgspp.core.cli.parser import check_words
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.settings.overrides import to_dict, with_overrides
from irgspp.core.settings.schema import preset
from scripts_folder import script as script


@pytest.fixture
def ablations(script, monkeypatch, tmp_path):
    """Return a function that runs the script on a run of a draft, with what the stub was asked for, and the figures it returns."""
    module, relighting, asked = script("ablations"), script("ablation.relighting"), []
    figures = {"relight_psnr": 30.0, "nvs_psnr": 33.0}

    def evaluate(run, dataset, output, data, progress, *, protocol, views, samples, relight, backend):
        asked.append((samples, relight, backend))
        found = dict(figures)
        if "relight_psnr" in found:
            found["relight_psnr"] -= 2.0 * (not relight.indirect) + 3.0 * (not relight.shadows)
        report = {"figures": found, "protocol": [f"Protocol {protocol}: x.", f"{samples} samples"]}
        output.mkdir(parents=True, exist_ok=True)
        (output / "report.json").write_text(json.dumps(report))
        return report

    run = tmp_path / "run"
    run.mkdir()
    settings = with_overrides(preset("draft"), ["seed=5"])
    (run / "run.json").write_text(json.dumps({"status": "done", "settings": to_dict(settings), "phases": {}}))
    monkeypatch.setattr(relighting, "evaluate", evaluate)
    monkeypatch.setattr(module.Reconstruction, "load", lambda path: None)
    monkeypatch.setattr(module, "is_mostly_metallic", lambda reconstruction: True)
    start = lambda *words: module.main([str(tmp_path / "data"), str(run), "-o", str(tmp_path / "out"), "--counts", "8,64", *words])  # noqa: E731
    return start, asked, figures


def test_each_variant_is_what_its_name_says_and_done_once(ablations, tmp_path, capsys):
    start, asked, _ = ablations
    assert start() == 0
    assert len(asked) == len({(samples, settings, backend) for samples, settings, backend in asked})
    text = capsys.readouterr().out
    assert "| without both | 512 | -5.00 dB | 25.00 | 33.00 |" in text and "| without visibility | 512 | -3.00 dB |" in text
    count = len(asked)
    assert (16, RelightSettings(), "gaussian") in asked and (16, RelightSettings(ratio=False), "mesh") in asked
    assert (512, RelightSettings(indirect=False, shadows=False), "mesh") in asked
    assert {(s, r.sampling) for s, r, _ in asked if r.denoise == "off" and r.allocation is None} >= {
        (n, m) for n in (8, 64) for m in ("mis", "stratified")
    }
    assert {r.allocation for _, r, _ in asked} == {None, (1, 1, 2), (1, 4, 3), (2, 1, 1)}
    assert {r.mesh_normals for _, r, _ in asked} == {0.0, None, 1.0}
    assert start() == 0 and len(asked) == count  # nothing again
    assert "| without MIS (strata) (paper, cat) | 512 | -5.12 dB |" in text and "| strata (paper, teapot) | 1024 | -7.40 dB |" in text
    assert text.count("--protocol glossy") == 2  # a note below each table with rows of the paper
    html = (tmp_path / "out" / "ablations.html").read_text()
    assert "Secondary rays" in html and json.loads((tmp_path / "out" / "ablations.json").read_text())[0]["heads"][0] == "variant"


def test_a_newer_run_is_evaluated_again(ablations, tmp_path):
    start, asked, _ = ablations
    assert start() == 0
    count, later = len(asked), time.time() + 100
    os.utime(tmp_path / "run" / "run.json", (later, later))
    assert start() == 0 and len(asked) > count


def test_without_relit_ground_truth_one_line_says_so(ablations, capsys):
    start, asked, figures = ablations
    del figures["relight_psnr"]
    assert start() == 2 and len(asked) == 1
    assert "has no relit ground truth" in capsys.readouterr().err


def test_trainings_are_valid_jobs_with_the_run_s_own_settings(script, tmp_path, ablations):
    module = script("ablations")
    args = module.arguments([str(tmp_path / "data"), str(tmp_path / "run"), "--views", "3"])
    for training in script("ablation.variants").TRAININGS:
        job = module.training_job(training, args, tmp_path / "out")
        for step in job.steps:
            check_words(step)
        assert job.steps[0][4:8] == ("--preset", "draft", "--set", "seed=5")
        assert all(change in job.steps[0] for change in training.changes) and set(training.as_trained) <= set(job.steps[2])
        assert not set(training.as_trained) & set(job.steps[1]) and len({step[-1] for step in job.steps}) > 1


def test_bad_counts_are_refused(ablations, capsys):
    start, asked, _ = ablations
    assert start("--counts", "8,many") == 2 and not asked
    assert "is not a list of numbers" in capsys.readouterr().err
