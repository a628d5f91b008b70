# SPDX-License-Identifier: GPL-3.0-or-later
"""Documents: their commands are accepted, and the files, functions, classes and settings that they name exist."""

import ast
import re
import shlex
from functools import cache
from pathlib import Path

import pytest
from irgspp.core.cli.parser import parser
from irgspp.core.settings.overrides import to_dict
from irgspp.core.settings.schema import Settings

ROOT = Path(__file__).resolve().parents[1]
TOP = [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG", "SECURITY")]
PAGES = [*TOP, *sorted((ROOT / "docs").glob("*.md"))]
ARCHITECTURE = ROOT / "docs" / "architecture.md"
COMMAND = re.compile(r"(?:^|[ ;])(?:-m |--command )?irgspp ((?:--help|[a-z]+ ).*)")
OURS = ("core", "tests", "scripts", "docs", "irgspp_addon", "operators", "panels", "typings")
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def commands(page: Path) -> list[str]:
    """Return the words after `irgspp` in a page's code."""
    found = []
    for line in page.read_text("utf-8").splitlines():
        hit = COMMAND.search(line) if line.startswith("    ") and "import irgspp" not in line else None
        if hit:
            found.append(re.split(r" #|;| 2>", hit[1])[0].strip())
    return found


@each_page
def test_commands_are_accepted(page):
    for words in commands(page):
        try:
            parser().parse_args(shlex.split(words))
        except SystemExit:
            pytest.fail(f"{page.name}: irgspp {words}")


def test_commands_are_found_at_all():
    found = [words.split()[0] for page in PAGES for words in commands(page)]
    assert {"demo", "inspect", "reconstruct", "render", "evaluate", "export", "devices", "bake"} <= set(found)


@each_page
def test_links_and_scripts_exist(page):
    text = page.read_text("utf-8")
    links = [target for target in re.findall(r"\]\(([^)#]+)", text) if "://" not in target]
    assert not [target for target in links if not (page.parent / target).is_file()]
    assert not [name for name in re.findall(r"scripts/\w+\.py", text) if not (ROOT / name).is_file()]


# --- paths


def named_paths(page: Path) -> list[str]:
    """Return the paths of this repository in backticks; `NAME` stands for a file that a reader adds."""
    quoted = (text.split()[0] for text in re.findall(r"`([^`\n]+)`", page.read_text("utf-8")) if text.strip())
    return [text for text in quoted if "/" in text and text.split("/")[0] in OURS and "NAME" not in text]


@each_page
def test_paths_in_backticks_exist(page):
    assert not [path for path in named_paths(page) if not (ROOT / path).exists()]


def test_paths_are_found_at_all():
    assert len(named_paths(ARCHITECTURE)) > 40
    assert {"core/pipeline.py", "tests/test_tiny.py", "scripts/benchmark.py"} <= set(named_paths(ROOT / "CONTRIBUTING.md"))


# --- functions and classes


@cache
def definitions(file: Path) -> frozenset[str]:
    """Return the names that a module defines: functions, classes, `Class.method`, constants; for a package also its modules."""
    found = set()
    for node in ast.parse(file.read_text("utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{one.name}" for one in node.body if isinstance(one, ast.FunctionDef)}
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {target.id for target in targets if isinstance(target, ast.Name)}
    if file.name == "__init__.py":
        found |= {path.stem for path in file.parent.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    return frozenset(found)


def module_file(dotted: str) -> Path | None:
    """Return the file of `irgspp.core.errors` and the like, also as the extension is called inside Blender; None if there is none."""
    path = ROOT.joinpath(*dotted.removeprefix("bl_ext.user_default.").split(".")[1:])
    return next((file for file in (path.with_name(f"{path.name}.py"), path / "__init__.py") if file.is_file()), None)


def rows(heading: str) -> list[list[str]]:
    """Return the cells of all table rows in a chapter of docs/architecture.md."""
    chapter = ARCHITECTURE.read_text("utf-8").partition(f"## {heading}\n")[2].partition("\n## ")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in chapter.splitlines() if line.startswith("|")]


def quoted(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def test_functions_of_a_job_are_defined_in_the_files_next_to_them():
    wrong, count = [], 0
    for row in rows("Data flow of one job"):
        column = next((i for i, cell in enumerate(row) if re.fullmatch(r"`core/[\w/]+\.py`", cell)), None)
        if column is None:
            continue
        file = ROOT / row[column].strip("`")
        names = quoted(row[column - 1])
        count += len(names)
        wrong += [f"{name} in {row[column]}" for name in names if not file.is_file() or name not in definitions(file)]
        assert names, row
    assert not wrong and count >= 25


def test_results_and_phases_of_a_job_exist():
    classes = {name for file in (ROOT / "core").rglob("*.py") for name in definitions(file)}
    pipeline = (ROOT / "core" / "pipeline.py").read_text("utf-8")
    table = [row for row in rows("Data flow of one job") if len(row) == 4]
    named = [name for row in table for name in quoted(row[3]) if re.fullmatch(r"[A-Z]\w+", name)]
    phases = [name for row in table for name in quoted(row[0])]
    assert len(named) >= 8 and not [name for name in named if name not in classes]
    assert len(phases) == 9 and not [name for name in phases if f'"{name}"' not in pipeline]


@each_page
def test_modules_and_names_in_code_exist(page):
    text = page.read_text("utf-8")
    imported = re.findall(r"^ {4,}from ((?:bl_ext\.user_default\.)?irgspp[\w.]*) import (\w+)", text, re.MULTILINE)
    dotted = [tuple(name.rsplit(".", 1)) for name in re.findall(r"\birgspp\.core(?:\.\w+)+", text)]
    for module, name in [*imported, *dotted]:
        file, whole = module_file(module), module_file(f"{module}.{name}")
        assert whole or (file and name in definitions(file)), f"{page.name}: {module}.{name}"


# --- modules


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "api").glob("*.md")), ids=lambda page: page.name)
def test_modules_of_the_reference_exist(page):
    named = re.findall(r"^::: irgspp\.([\w.]+)$", page.read_text("utf-8"), re.MULTILINE)
    places = [ROOT / name.replace(".", "/") for name in named]
    assert named and not [place for place in places if not (place.with_suffix(".py").is_file() or (place / "__init__.py").is_file())]


# --- settings


@each_page
def test_settings_exist(page):
    text, groups = page.read_text("utf-8"), to_dict(Settings())
    known = {f"{group}.{key}" for group, keys in groups.items() if isinstance(keys, dict) for key in keys}
    known |= {*groups, "skip.NAME", "key"}  # the last two stand for any setting
    named = re.findall(r"--set ([\w.]+)=", text) + re.findall(r"`((?:data|first|second|surface|skip)\.\w+)", text)
    renamed = {"skip.outside", "skip.constants", "skip.open", "skip.kept"} if page.name in ("CHANGELOG.md", "run_folder.md") else set()
    assert not [key for key in named if key not in known | renamed]
