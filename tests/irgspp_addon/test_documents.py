# SPDX-License-Identifier: GPL-3.0-or-later
"""All operators and keywords in the documents exist."""

import ast
import re
from pathlib import Path

import bpy
import pytest
from irgspp.panels import registration

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
OPERATORS = {cls.bl_idname.removeprefix("irgspp."): cls for cls in registration.CLASSES if issubclass(cls, bpy.types.Operator)}


def properties(cls: type) -> set[str]:
    return {name for base in cls.__mro__ for name in getattr(base, "__annotations__", {})}


def code_blocks(text: str) -> list[str]:
    """Return the blocks of lines that are indented by four spaces, without the indentation."""
    blocks = re.findall(r"(?:^    .*\n|^\n(?=    ))+", text, re.MULTILINE)
    return ["\n".join(line[4:] for line in block.strip("\n").split("\n")) for block in blocks]


def calls(page: Path) -> list[tuple[str, list[str]]]:
    """Return operator and keywords of each call of the extension's operators in a page, in code or text."""
    found = []
    for call in re.findall(r"bpy\.ops\.irgspp\.\w+\([^()]*\)", page.read_text("utf-8")):
        node = ast.parse(call.replace("...", "None"), mode="eval").body
        assert isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        found.append((node.func.attr, [str(word.arg) for word in node.keywords]))
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_calls_name_operators_and_keywords_that_exist(page):
    for operator, keywords in calls(page):
        assert operator in OPERATORS, f"{page.name}: {operator}"
        assert set(keywords) <= properties(OPERATORS[operator]), f"{page.name}: {operator}({', '.join(keywords)})"


def test_table_of_operators_is_complete():
    """Each operator for scripts is in the table with all its keywords."""
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \| (.*) \|$", (ROOT / "docs" / "scripting.md").read_text("utf-8"), re.MULTILINE)
    documented = {name: words for names, words in rows for name in re.findall(r"`(\w+)`", names)}
    internal = {"import_dropped", "relight_stop", "open_engine_folder", "mask_brush", "show_image"}
    assert set(documented) == {name for name in OPERATORS if name not in internal and not name.startswith(("panel_", "choose_"))}
    hidden = {"wait", "was_read", "was_cut", "check_existing", "filter_glob", "filter_folder"}
    for name, words in documented.items():
        assert properties(OPERATORS[name]) - hidden <= set(re.findall(r"\w+", words)), name


def test_python_in_the_documents_can_be_parsed():
    blocks = [block for page in PAGES for block in code_blocks(page.read_text("utf-8"))]
    python = [block for block in blocks if re.match(r"(#.*\n)?(import|from|try)\b", block)]
    assert len(python) >= 6
    for block in python:
        ast.parse(block)
