# SPDX-License-Identifier: GPL-3.0-or-later
"""Portability of the sources: calls of POSIX, encodings that depend on the locale, and the Python versions of Blender."""

import ast
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("core", "irgspp_addon", "operators", "panels")
SOURCES = [ROOT / "__init__.py", ROOT / "__main__.py", *(f for part in PARTS for f in sorted((ROOT / part).rglob("*.py")))]
POSIX_MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog", "posix"}
POSIX_CALLS = {"fork", "getuid", "geteuid", "getgid", "setsid", "setuid", "killpg", "getpgid", "mkfifo", "chown", "wait4", "WIFSIGNALED"}
POSIX_CALLS |= {
    "sched_getaffinity",
    "sched_setaffinity",
    "uname",
    "getloadavg",
    "SIGKILL",
    "SIGHUP",
    "SIGUSR1",
    "SIGUSR2",
    "SIGALRM",
    "setitimer",
}
GUARDS = ("sys.platform", "os.name", "hasattr(")  # one of them in the function, or around it, chooses the alternative
BLENDERS_PYTHONS = ((3, 11), (3, 12), (3, 13))


def parents(tree):
    return {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}


def guarded(node, above, text):
    """True where a function or condition around the node tests the operating system."""
    while (node := above.get(node)) is not None:
        if isinstance(node, ast.FunctionDef | ast.If | ast.IfExp) and any(g in (ast.get_source_segment(text, node) or "") for g in GUARDS):
            return True
    return False


def posix_uses(file):
    text = file.read_text("utf-8")
    tree = ast.parse(text)
    above = None
    for node in ast.walk(tree):
        modules = {a.name.split(".")[0] for a in node.names} if isinstance(node, ast.Import) else set()
        called = isinstance(node, ast.Attribute) and node.attr in POSIX_CALLS and ast.unparse(node.value) in ("os", "signal")
        if modules & POSIX_MODULES or called:
            above = above or parents(tree)
            yield node, guarded(node, above, text)


def test_calls_of_posix_have_an_alternative():
    found = [(f.relative_to(ROOT).as_posix(), node.lineno, fine) for f in SOURCES for node, fine in posix_uses(f)]
    assert len(found) > 3  # the search finds them
    assert not [(file, line) for file, line, fine in found if not fine]


def test_a_bare_call_of_posix_is_found(tmp_path):
    file = tmp_path / "a.py"
    file.write_text("import os\ndef f():\n    return os.getuid()\ndef g():\n    return os.getuid() if hasattr(os, 'getuid') else 0\n")
    assert [fine for _, fine in posix_uses(file)] == [False, True]


def test_text_is_read_and_written_in_a_stated_encoding():
    """Else Windows and some locales would use another encoding for the same file."""
    words = ["check", "--preview", "--isolated", "--select", "PLW1514", "--output-format", "concise", *PARTS]
    done = subprocess.run([sys.executable, "-m", "ruff", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_file_names_are_unique_without_regard_to_case():
    others = (p for pattern in ("docs/**/*", "tests/**/*.py", "scripts/**/*.py") for p in ROOT.glob(pattern))
    names = {p.relative_to(ROOT).as_posix() for p in (*SOURCES, *others)}
    assert len({name.casefold() for name in names}) == len(names)


@pytest.mark.parametrize("version", BLENDERS_PYTHONS, ids=lambda v: f"{v[0]}.{v[1]}")
def test_sources_parse_in_every_python_of_blender(version):
    for file in SOURCES:
        ast.parse(file.read_text("utf-8"), str(file), feature_version=version)


def test_nothing_removed_from_the_standard_library_is_used():
    """Between 3.11 and 3.13."""
    gone = {"imp", "asynchat", "asyncore", "smtpd", "distutils", "cgi", "cgitb", "crypt", "imghdr", "pipes", "telnetlib", "lib2to3", "uu"}
    found = set()
    for node in (node for file in SOURCES for node in ast.walk(ast.parse(file.read_text("utf-8")))):
        found |= {node.module or ""} if isinstance(node, ast.ImportFrom) and not node.level else set()
        found |= {a.name for a in node.names} if isinstance(node, ast.Import) else set()
    assert "numpy" in {name.split(".")[0] for name in found}  # the search finds imports
    assert not {name.split(".")[0] for name in found} & gone


IMPORTS = """
import importlib, runpy, sys
from pathlib import Path
from unittest.mock import MagicMock
sys.modules["numpy"] = MagicMock()
root = Path(sys.argv[1])
runpy.run_path(str(root / "irgspp_addon" / "launch.py"))["mount"](root)
for name in sys.argv[2:]:
    importlib.import_module(name)
print("all")
"""


@pytest.mark.parametrize("version", ["3.12", "3.13"])
def test_modules_that_blender_imports_load_in_its_later_pythons(version):
    """numpy, which Blender brings, is replaced by a mock."""
    others = sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}*/bin/python"))
    found = [p for p in (shutil.which(f"python{version}"), *map(str, others)) if p]
    python = next((p for p in found if subprocess.run([p, "-c", ""], capture_output=True, check=False).returncode == 0), None)
    if python is None:
        pytest.skip(f"no Python {version} here")
    modules = {
        "irgspp.core." + (node.module or "").removeprefix("core.")
        for part in PARTS[1:]
        for file in (ROOT / part).rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.ImportFrom) and node.level >= 2 and (node.module or "").startswith("core.")
    }
    modules -= {"irgspp.core.machine.thread_pool"}  # of the engine's interpreter, imported where that is Blender's own
    assert len(modules) > 5
    command = [python, "-B", "-W", "error", "-c", IMPORTS, str(ROOT), *sorted(modules)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout.strip() == "all", done.stderr


def test_every_package_is_listed_for_installation():
    """Setuptools takes only packages that pyproject.toml names."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    folders = {file.parent.relative_to(ROOT).as_posix().replace("/", ".") for file in SOURCES if file.parent != ROOT}
    assert set(project["tool"]["setuptools"]["packages"]) == {"irgspp", *(f"irgspp.{folder}" for folder in folders)}


def test_every_other_file_of_the_packages_is_installed():
    """Setuptools takes other files than sources only where pyproject.toml names them."""
    patterns = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]["package-data"]
    whole = {package: [pattern.replace("**", "**/*") for pattern in own] for package, own in patterns.items()}  # as setuptools reads **
    installed = {file for package, own in whole.items() for pattern in own for file in (ROOT / package_folder(package)).glob(pattern)}
    others = {file for part in PARTS for file in (ROOT / part).rglob("*") if file.is_file() and file.suffix != ".py"}
    others = {file for file in others if file.parent.name != "__pycache__"}
    assert {ROOT / "core" / "capture" / "report.html.jinja", ROOT / "core" / "demo_data" / "meta.json"} <= others <= installed


def package_folder(name: str) -> Path:
    """Folder of a package in the repository, which is the package irgspp itself."""
    return Path(*name.split(".")[1:])
