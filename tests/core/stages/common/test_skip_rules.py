# SPDX-License-Identifier: GPL-3.0-or-later
"""Skip rules: evidence decides, settings overrule it, and the run records the decision."""

import json
from dataclasses import replace

import pytest
from irgspp.core.progress.protocol import Silent
from irgspp.core.progress.recorder import ProgressRecorder
from irgspp.core.run_folder import RunFolder
from irgspp.core.settings.schema import Settings, SkipSettings
from irgspp.core.stages.common.skip_rules import decide_skip_rule


class Witness(Silent):
    def __init__(self):
        self.heard = []

    def decided(self, rule, on, evidence):
        self.heard.append((rule, on, evidence))


@pytest.mark.parametrize(
    ("choice", "found", "on"), [("auto", True, True), ("auto", False, False), ("on", False, True), ("off", True, False)]
)
def test_evidence_decides_unless_the_settings_do(choice, found, on):
    witness = Witness()
    assert decide_skip_rule(replace(SkipSettings(), background=choice), "background", found, "40 % black", witness) is on
    ((rule, decided, evidence),) = witness.heard
    assert (rule, decided) == ("background", on)
    assert ("as set" in evidence) == (choice != "auto") and "40 % black" in evidence


def test_the_run_has_it_on_record(tmp_path):
    folder, witness = RunFolder.open(tmp_path / "run", Settings(), "photos"), Witness()
    ProgressRecorder(folder, witness).decided("trials", True, "metal fell behind")
    folder.close()
    assert json.loads((tmp_path / "run" / "run.json").read_text())["rules"] == {"trials": {"on": True, "evidence": "metal fell behind"}}
    assert "trials on: metal fell behind" in (tmp_path / "run" / "log.txt").read_text()
    assert witness.heard == [("trials", True, "metal fell behind")]
