# SPDX-License-Identifier: GPL-3.0-or-later
"""Ablations of relighting: one finished run, evaluated with every variant; evaluated ones are kept."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from irgspp.core.evaluation.report import evaluate
from irgspp.core.progress.protocol import Progress
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.run_folder import read_run, write_atomic
from irgspp.core.settings.overrides import from_dict

from .variants import Variant

Report = dict[str, Any]


def evaluated(variant: Variant, run: Path, dataset: Path, out: Path, progress: Progress, protocol: str, views: int | None) -> Report:
    """Return the report of a variant; one that was made of the same run with the same choices is read again.

    Args:
        variant: way to render.
        run: finished run.
        dataset: dataset with ground truth.
        out: folder of the reports.
        progress: receives the progress and may cancel.
        protocol: name of the protocol.
        views: number of test views; None: all.
    """
    choices = {**variant.options, "protocol": protocol, "views": views, "run": str(run.resolve()), "dataset": str(dataset.resolve())}
    text = json.dumps(choices, sort_keys=True)
    folder = out / hashlib.sha256(text.encode()).hexdigest()[:12]
    whole, report = folder / "choices.json", folder / "report.json"
    if whole.is_file() and report.is_file() and report.stat().st_mtime >= (run / "run.json").stat().st_mtime:
        return json.loads(report.read_text(encoding="utf-8"))
    progress.message(f"{variant.label}, {variant.samples} samples")
    data = from_dict(read_run(run)["settings"], run / "run.json").data
    relight, options = RelightSettings(**variant.settings), {"backend": variant.backend, "views": views}
    found = evaluate(run, dataset, folder, data, progress, protocol=protocol, samples=variant.samples, relight=relight, **options)
    write_atomic(whole, text.encode())  # last: a report without it is made again
    return found
