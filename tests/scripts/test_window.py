# SPDX-License-Identifier: GPL-3.0-or-later
"""A story that quits Blender goes on in a second one; one whose Blender dies has failed."""

import argparse
import sys

import pytest
from scripts_folder import scripts_on_path

if sys.platform == "win32":
    pytest.skip("the stand-in of Blender is a shell script", allow_module_level=True)

# Stand-in of Blender: it quits in its first window, and writes the story's result in its second one.
QUITS = """#!/bin/sh
while [ "$1" != -- ]; do shift; done
if [ -z "$IRGSPP_AGAIN" ]; then
    touch "$2/again"
else
    echo '{"error": null, "figures": {}, "slowest": {}}' > "$2/end.json"
fi
"""


@pytest.fixture
def story(tmp_path, monkeypatch):
    """Return a function that runs a story in a stand-in of Blender with a program's text, and returns the exit status."""
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("IRGSPP_AGAIN", "")

    def drive(program: str) -> int:
        """Run the story."""
        blender = tmp_path / "blender"
        blender.write_text(program)
        blender.chmod(0o755)
        args = argparse.Namespace(blender=str(blender), output=tmp_path, size="800x600", story="story_quit", engine="", timeout=20.0)
        with scripts_on_path() as script:
            return script("window.run").drive(args)

    return drive


def test_a_story_goes_on_in_a_second_blender(story, tmp_path):
    assert story(QUITS) == 0
    assert (tmp_path / "blender.log").exists() and (tmp_path / "blender_again.log").exists() and not (tmp_path / "again").exists()


def test_a_blender_that_dies_is_noticed(story, tmp_path, capsys):
    assert story("#!/bin/sh\nexit 1\n") == 3
    assert "Blender ended or took too long" in capsys.readouterr().err and not (tmp_path / "blender_again.log").exists()
