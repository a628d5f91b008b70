# SPDX-License-Identifier: GPL-3.0-or-later
"""Promises of SECURITY.md, checked in the sources: no code from data, no shell, private temporary files, declared permissions only."""

import ast
import os
import stat
import sys
import tomllib
from functools import cache
from pathlib import Path, PurePosixPath, PureWindowsPath

import blender_side  # noqa: F401  (before what imports bpy)
import pytest
from engine_jobs import counter as counter
from engine_jobs import registry as registry
from hypothesis import example, given
from hypothesis import strategies as st
from irgspp.core.datasets.parsed_dataset import view_names
from irgspp.irgspp_addon.jobs import queue as jobs

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("core", "irgspp_addon", "operators", "panels")
SOURCES = [ROOT / "__init__.py", ROOT / "__main__.py", *(f for part in PARTS for f in sorted((ROOT / part).rglob("*.py")))]

# Files that run code that is not imported by name: our own files, next to the one that runs them.
RUNS_OUR_FILES = {"irgspp_addon/engine/worker.py", "irgspp_addon/launch.py"}
CODE = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "runpy.run_path", "runpy.run_module", "subprocess.getoutput"}
UNPICKLERS = {
    f"{module}.{name}" for module in ("pickle", "marshal", "dill", "cloudpickle", "joblib") for name in ("load", "loads", "Unpickler")
}
NETWORK = {"socket", "ssl", "http", "urllib", "urllib3", "requests", "ftplib", "smtplib", "xmlrpc", "asyncio", "websockets", "webbrowser"}


@cache
def nodes():
    """Return (file, node) of every node of the sources' syntax trees."""
    trees = ((file.relative_to(ROOT).as_posix(), ast.parse(file.read_text("utf-8"))) for file in SOURCES)
    return [(file, node) for file, tree in trees for node in ast.walk(tree)]


@pytest.fixture(scope="module", autouse=True)
def _nodes():
    """Forget them after these tests: every search for garbage would go through a million objects."""
    yield
    nodes.cache_clear()


def dotted(node):
    """Return `a.b.c` of a name or attribute, else ""."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def calls(*names):
    """Return (file, call) of every call by one of these names."""
    return [(f, n) for f, n in nodes() if isinstance(n, ast.Call) and dotted(n.func) in names]


def imported():
    """Yield (file, top module) of every import, also inside functions."""
    for file, node in nodes():
        if isinstance(node, ast.Import):
            yield from ((file, alias.name.split(".")[0]) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield file, (node.module or "").split(".")[0]


def keyword(call, name):
    return next((ast.unparse(word.value) for word in call.keywords if word.arg == name), None)


def test_nothing_is_evaluated():
    assert {file for file, _ in calls(*CODE)} <= RUNS_OUR_FILES
    assert len(calls("subprocess.Popen", "subprocess.run")) > 5  # the search finds calls


def test_no_shell():
    for file, call in calls("subprocess.Popen", "subprocess.run", "subprocess.call", "subprocess.check_output", "subprocess.check_call"):
        assert keyword(call, "shell") is None, file
        assert not isinstance(call.args[0], ast.Constant | ast.JoinedStr | ast.BinOp), f"{file}: a command is a list of words"


def test_only_arrays_come_out_of_pickles():
    assert not calls(*UNPICKLERS)
    unpicklers = [f for f, n in nodes() if isinstance(n, ast.ClassDef) and "pickle.Unpickler" in map(dotted, n.bases)]
    assert unpicklers == ["core/io/safe_pickle.py"]
    assert {file for file, module in imported() if module == "pickle"} <= {"core/io/safe_pickle.py", "core/run_folder.py"}
    for file, call in calls("torch.load"):
        assert keyword(call, "weights_only") == "True", file
    for file, call in calls("np.load"):
        assert keyword(call, "allow_pickle") == "False", f"{file}, line {call.lineno}"
    assert calls("torch.load") and calls("np.load")


def test_temporary_files_are_private():
    """mkstemp and mkdtemp make files that no other user can open; mktemp and fixed names do not."""
    assert not calls("tempfile.mktemp", "os.tempnam")
    texts = [(f, n.value) for f, n in nodes() if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    assert not [(f, text) for f, text in texts if text.startswith(("/tmp", "/var/tmp", "C:\\"))]
    assert {f for f, _ in calls("tempfile.gettempdir")} <= {"core/machine/cache_folder.py"}  # which checks the owner of the folder


def test_declared_permissions_are_those_that_are_used():
    """Files and network, the latter by pip alone and only where the user installs an engine; no other permission of Blender."""
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))
    assert set(manifest["permissions"]) == {"files", "network"}
    found = {(file, module) for file, module in imported() if module in NETWORK}
    assert not found
    attributes = {n.attr for _, n in nodes() if isinstance(n, ast.Attribute)}
    assert not attributes & {"clipboard", "url_open"}
    online = [f for f, n in nodes() if isinstance(n, ast.Attribute) and n.attr == "online_access"]
    assert online and all(f.startswith("operators/") for f in online)  # asked before the installer may use the network


@given(st.lists(st.text(max_size=300), min_size=1, max_size=6))
@example(
    ["../../x.png", "C:\\evil.png", "a/./..", "CON", "a:b.png", "x" * 400, "", "\ud800", "..", "A.png", "a.png", "é.png", "e\u0301.png"]
)
def test_names_of_views_stay_in_their_folder(listed):
    """Names of views become names of files in run folders and of folders of images."""
    names = view_names(listed)
    assert len({name.casefold() for name in names}) == len(names) == len(listed)
    for name in names:
        assert PurePosixPath("run", name).parent == PurePosixPath("run") and PurePosixPath(name).name == name
        assert PureWindowsPath("run", name).parent == PureWindowsPath("run") and not PureWindowsPath(name).is_reserved()
        assert len(name.encode()) < 200 and "\0" not in name


@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps users' folders private by itself")
def test_notes_of_jobs_are_their_users_alone(registry, counter):
    job = counter(1)
    jobs.wait(job, 300)
    assert stat.S_IMODE(os.stat(job.notes).st_mode) == 0o700


def test_engine_is_installed_from_known_files():
    """tests/irgspp_addon/test_install_engine.py has the rest; here: pip never reads an index while it installs."""
    words = [
        n.value for f, n in nodes() if f == "irgspp_addon/engine/install.py" and isinstance(n, ast.Constant) and isinstance(n.value, str)
    ]
    assert {"download", "--no-index", "--no-deps", "--only-binary"} <= set(words)
