# SPDX-License-Identifier: GPL-3.0-or-later
"""Every text that the extension shows has a translation with the same placeholders."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import blender_side  # noqa: F401  (before bpy)
import bpy
import irgspp
import pytest
from irgspp.irgspp_addon import translations
from irgspp.panels import jobs as jobs_panel
from irgspp.panels import photographs, registration
from irgspp.panels.photographs import SHOWN
from panel_states import add_job
from panel_states import settings as settings
from recording_layout import draw

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted(
    [*(ROOT / "panels").glob("*.py"), *(ROOT / "operators").glob("*.py")]
    + [ROOT / "irgspp_addon" / f"{name}.py" for name in ("preferences_page", "properties", "shared_properties")]
)
# Looks like text and is none, or is Blender's or the engine's: names of classes, keys of dates, phases and states, beginnings of log lines.
NOT_TRANSLATED = {
    *("%d %b", "Error: ", "IRGS++ Mask", "Reconstructions", "ShaderNodeTexImage", "IRGS++"),
    *("read images", "quick fit", "first stage", "second stage", "turn surfels", "contact sheet", "read photographs", "find features"),
    *("match photographs", "find poses", "undistort photographs", "dense points", "refine poses", "cut out the object"),
    "cuda can be used",
}
FORMATTED = {  # f-strings with words: units, which are the same in all languages, the ends of errors, and lines of a log
    "f'{whole // 60}:{whole % 60:02d} min'",
    "f'irgspp: {job.title}: {job.phase}'",
    "f' ({job.of} steps)'",
    "f'choose {job.folder} as photographs there'",
    "f'import the result by File > Import > IRGS++ Run from {job.folder}'",
    "f'reconstruct {job.folder} there'",
    "f\"{', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}\"",
    "f'Ends with {ENDINGS}'",
}
ADVICE = {
    "inspect the dataset again there",
    "import the dataset again there",
    "mark the asset again",
}  # the end of an error, like those of FORMATTED
ELSEWHERE = {*map(str.capitalize, SHOWN), "queued", "running"}  # rows of an inspection, and states of jobs: looked up when they are shown


def is_text(words: str) -> bool:
    """True for what a person would read: several words, or one that begins like a label."""
    if re.match(r"IRGSPP_|_| *$|[^A-Za-z0-9+-]*$", words):
        return False
    return " " in words or bool(re.match(r"[A-Z][a-z]|3D", words))


def texts(path: Path) -> Iterator[str]:
    """Yield the texts of a file, without docstrings and the words of errors."""
    tree = ast.parse(path.read_text("utf-8"))
    skipped: set[int] = set()
    for node in ast.walk(tree):
        error = isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("Error", "refuse"))
        docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if error or docstring:
            skipped |= {id(part) for part in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            if id(node) not in skipped:
                constant = "".join(part.value for part in node.values if isinstance(part, ast.Constant))
                if re.search(r"[A-Za-z]{2,} | [A-Za-z]{2,}", constant):
                    assert ast.unparse(node) in FORMATTED, f"{path.name}:{node.lineno}: use translated() for {ast.unparse(node)}"
            skipped |= {id(part) for part in ast.walk(node)}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in skipped and is_text(node.value):
            yield node.value


def literals_given_to_translated() -> set[str]:
    """All English texts that are looked up by `translated`, also outside of the panels."""
    found = set()
    for path in [*FILES, *(ROOT / "irgspp_addon").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "translated":
                first = node.args[0]
                parts = [first.body, first.orelse] if isinstance(first, ast.IfExp) else [first]
                found |= {part.value for part in parts if isinstance(part, ast.Constant)}
    return found


def tooltips() -> set[str]:
    operators = [cls for cls in registration.CLASSES if issubclass(cls, bpy.types.Operator)]
    return {cls.__doc__.removesuffix(".") for cls in operators}


def kinds() -> set[str]:
    from irgspp.irgspp_addon.relight.left_out import KINDS

    return {text for texts_of_kind in KINDS.values() for text in texts_of_kind}


def shown() -> set[str]:
    found = {text for path in FILES for text in texts(path)} - NOT_TRANSLATED - ADVICE
    return found | literals_given_to_translated() | tooltips() | kinds() | ELSEWHERE


@pytest.mark.parametrize("language", translations.LANGUAGES)
def test_every_text_has_a_translation_and_no_translation_is_left_over(language):
    known = set(translations.LANGUAGES[language])
    assert sorted(shown() - known) == []
    assert sorted(known - shown()) == []


@pytest.mark.parametrize("language", translations.LANGUAGES)
def test_placeholders_and_ends_agree(language):
    for text, translation in translations.LANGUAGES[language].items():
        assert sorted(re.findall(r"{\w*}", text)) == sorted(re.findall(r"{\w*}", translation)), text
        assert (translation.strip() and text[-1] in ".:?" and text[-1] == translation[-1]) or text[-1] not in ".:?", text
        assert text.startswith(",") == translation.startswith(","), text


@pytest.fixture
def blender(monkeypatch):
    """Blender's translations, which its Python module is built without: what is registered, and German for all of it."""
    registered = {}
    look_up = lambda text: next((texts["de"]["*", text] for texts in registered.values() if ("*", text) in texts["de"]), text)  # noqa: E731
    fake = SimpleNamespace(register=registered.__setitem__, unregister=registered.pop, pgettext_iface=look_up)
    monkeypatch.setattr(translations, "bpy", SimpleNamespace(app=SimpleNamespace(translations=fake)))
    return registered


def test_they_are_registered_and_unregistered_with_the_extension(blender):
    irgspp.register()
    assert list(blender) == [translations.__name__]
    entries = blender[translations.__name__]["de"]
    assert entries["*", "1 Photographs"] == "1 Fotos" and entries["Operator", "Find Cameras"] == "Kameras suchen"  # a button's text
    irgspp.unregister()
    assert not blender


def test_panels_draw_in_german(settings, blender, tmp_path):
    translations.register()
    assert "Einen Ordner mit Fotos oder ein Video auswählen." in draw(photographs.IRGSPP_PT_photographs).words
    (tmp_path / "a.jpg").touch()
    settings.dataset = str(tmp_path)
    assert "Fotos ohne Kameras: 1 Datei" in draw(photographs.IRGSPP_PT_photographs).words
    add_job(tmp_path, state="done", began=10.0, ended=75.0)
    assert "Fertig nach 1:05 min" in draw(jobs_panel.IRGSPP_PT_jobs).words


def test_placeholders_are_filled_in():
    assert translations.translated("Show {name}", name="a {b}.glb") == "Show a {b}.glb"
    assert translations.translated("100 {of} this") == "100 {of} this"  # without values it is no template
