# SPDX-License-Identifier: GPL-3.0-or-later
"""The command that writes a scene in the layout of other datasets."""

from pathlib import Path

import pytest
from irgspp.core.datasets.load import load_dataset
from irgspp.core.pipeline import DEMO_DATA
from scripts_folder import SCRIPTS, scripts_on_path

with scripts_on_path():
    from dataset_formats import main
    from formats import WRITERS


@pytest.mark.parametrize("name", ["stanford-orb", "tensoir"])
def test_the_embedded_scene_in_other_layouts(name, tmp_path, capsys):
    assert main([str(DEMO_DATA), "--format", name, "-o", str(tmp_path / "copy")]) == 0
    data = load_dataset(Path(capsys.readouterr().out.strip()))
    assert (data.format, len(data.train), len(data.test)) == (name, 40, 6) and not data.warnings


def test_bad_input_ends_with_status_2_and_one_line(tmp_path, capsys):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    for scene, out, words in ((tmp_path, "new", "not a rendered scene"), (DEMO_DATA, "full", "not empty")):
        assert main([str(scene), "--format", "tensoir", "-o", str(tmp_path / out)]) == 2
        assert words in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_every_format_of_the_page_can_be_written():
    page = (SCRIPTS.parent / "docs" / "datasets.md").read_text("utf-8")
    rows = {line.split("`")[1] for line in page.splitlines() if line.startswith("| `")}
    assert rows - {"colmap", "transforms"} == set(WRITERS)
