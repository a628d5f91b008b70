# SPDX-License-Identifier: GPL-3.0-or-later
"""Docstrings of public functions say what a caller needs: arguments with shapes; ruff's D rules hold the rest."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("core", "irgspp_addon", "operators", "panels", "scripts")
SHAPE = re.compile(r"\((?:[A-Z0-9.]|\d)[\w .+*/]*,|\([A-Z]\)|\bscalar")  # (N, 3), (P,), (..., 3)
KERNEL = re.compile(r"\bkernel\b|^wp\.|^stub$")
OPENERS = re.compile(r"(What|How|Where|Whether|Who|Whom|That|Those)\b")  # of riddles; a sentence begins with a verb or a noun of the field


def public(body: list[ast.stmt]) -> Iterator[ast.FunctionDef]:
    """Functions and methods without an underscore, kernels left out."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public(node.body)
        elif isinstance(node, ast.FunctionDef) and not (node.name.startswith("_") or is_kernel(node)):
            yield node


def is_kernel(node: ast.FunctionDef) -> bool:
    return any(KERNEL.search(ast.unparse(one)) for one in node.decorator_list)


def functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    """Every public function of the package and its scripts, with its place."""
    for room in ROOMS:
        for file in sorted((ROOT / room).rglob("*.py")):
            for node in public(ast.parse(file.read_text("utf-8")).body):
                yield f"{file.relative_to(ROOT).as_posix()}:{node.name}", node


def arguments(node: ast.FunctionDef) -> list[ast.arg]:
    every = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
    return [one for one in every if one.arg not in ("self", "cls", "ctx")]


FUNCTIONS = dict(functions())


def test_functions_are_found():
    assert len(FUNCTIONS) > 800


def test_two_arguments_or_more_are_described():
    several = {name: node for name, node in FUNCTIONS.items() if len(arguments(node)) >= 2}
    silent = [name for name, node in several.items() if "Args:" not in (ast.get_docstring(node) or "")]
    assert len(silent) <= 0.1 * len(several), silent


def test_arrays_have_shapes():
    arrays = {
        name: node
        for name, node in FUNCTIONS.items()
        if any(one.annotation is not None and re.search(r"Tensor|ndarray", ast.unparse(one.annotation)) for one in arguments(node))
    }
    silent = [name for name, node in arrays.items() if not SHAPE.search(ast.get_docstring(node) or "")]
    assert len(silent) <= 0.05 * len(arrays), silent


def test_no_sentence_begins_as_a_riddle():
    riddles = [name for name, node in FUNCTIONS.items() if OPENERS.match(ast.get_docstring(node) or "")]
    for room in ROOMS:
        for file in sorted((ROOT / room).rglob("*.py")):
            if OPENERS.match(ast.get_docstring(ast.parse(file.read_text("utf-8"))) or ""):
                riddles.append(file.relative_to(ROOT).as_posix())
    assert not riddles
