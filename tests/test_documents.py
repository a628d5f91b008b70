# SPDX-License-Identifier: GPL-3.0-or-later
"""Documents: the command line accepts their commands, and every file that they name exists."""

import re
import shlex
from pathlib import Path

import pytest
from irgspp.core.cli.parser import parser

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
COMMAND = re.compile(r"(?:^|[ ;])(?:-m |--command )?irgspp ((?:--help|[a-z]+ ).*)")


def commands(page: Path) -> list[str]:
    """The words after `irgspp` in a page's code."""
    found = []
    for line in page.read_text("utf-8").splitlines():
        hit = COMMAND.search(line) if line.startswith("    ") and "import irgspp" not in line else None
        if hit:
            found.append(re.split(r" #|;| 2>", hit[1])[0].strip())
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_are_accepted(page):
    for words in commands(page):
        try:
            parser().parse_args(shlex.split(words))
        except SystemExit:
            pytest.fail(f"{page.name}: irgspp {words}")


def test_commands_are_found_at_all():
    found = [words.split()[0] for page in PAGES for words in commands(page)]
    assert {"demo", "inspect", "reconstruct", "render", "evaluate", "export", "devices", "bake"} <= set(found)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_scripts_exist(page):
    text = page.read_text("utf-8")
    links = [target for target in re.findall(r"\]\(([^)#]+)", text) if "://" not in target]
    assert not [target for target in links if not (page.parent / target).is_file()]
    assert not [name for name in re.findall(r"scripts/\w+\.py", text) if not (ROOT / name).is_file()]
