# SPDX-License-Identifier: GPL-3.0-or-later
"""The renderer's options of `render` and `evaluate`."""

import pytest
from irgspp.core.cli.parser import parser
from irgspp.core.cli.renderer_options import relight_settings
from irgspp.core.relight.relight_settings import RelightSettings

COMMANDS = (["render", "run", "-o", "views"], ["evaluate", "run", "dataset"])


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_options_become_settings(words):
    assert relight_settings(parser().parse_args(words)) == RelightSettings()
    changed = parser().parse_args([*words, "--no-denoise", "--no-indirect", "--diffuse", "lambert", "--sampling", "stratified"])
    assert relight_settings(changed) == RelightSettings(sampling="stratified", denoise="off", indirect=False, conserving=False)
    assert relight_settings(parser().parse_args([*words, "--brdf", "irgs"])) == RelightSettings(brdf="irgs")
    assert relight_settings(parser().parse_args([*words, "--diffuse", "conserving"])) == RelightSettings(conserving=True)
    assert relight_settings(parser().parse_args([*words, "--denoiser", "paper", "--no-transfer"])) == RelightSettings(
        denoise="paper", transfer=False
    )
