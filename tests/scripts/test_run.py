# SPDX-License-Identifier: GPL-3.0-or-later
"""The set-up script installs once, again when the lock changes, and anew after an interruption, and passes exit statuses on."""

import ast
import errno
import importlib.util
import os
import re
import subprocess
import sys
import threading
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "run.py"


@pytest.fixture
def script(tmp_path, monkeypatch):
    """Return the script with a root of its own and with recorded instead of started commands; making the environment makes its Python."""
    spec = importlib.util.spec_from_file_location("run_script", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    venv = tmp_path / ".venv"
    paths = {"ROOT": tmp_path, "VENV": venv, "LOCK": tmp_path / "requirements.lock", "PYTHON": venv / "python"}
    paths |= {"STAMP": venv / module.STAMP.name, "UNFINISHED": venv / module.UNFINISHED.name, "LOCKED": tmp_path / "build" / "setup.lock"}
    for name, value in paths.items():
        monkeypatch.setattr(module, name, value)
    for name in ("requirements.lock", "pyproject.toml"):
        (tmp_path / name).write_text("numpy==1.26.4\n")
    calls = []

    def call(*command):
        calls.append(" ".join(map(str, command)))
        if "venv" in command:
            venv.mkdir(exist_ok=True)
            (venv / "python").touch()
            for left in (module.STAMP, module.UNFINISHED):
                left.unlink(missing_ok=True)
        return module.statuses.get(next((word for word in ("venv", "pip", "compile", "pytest", "demo") if word in command), ""), 0)

    monkeypatch.setattr(module, "call", call)
    monkeypatch.setattr(module, "works", lambda python: python.exists())
    module.calls, module.statuses = calls, {}
    return module


def kinds(calls):
    return [next(word for word in ("-m venv", "--editable", "-r ", "irgspp compile", "pytest", "demo") if word in c) for c in calls]


def test_first_set_up_then_nothing(script):
    assert script.main(["setup"]) == 0
    assert kinds(script.calls) == ["-m venv", "-r ", "--editable", "irgspp compile"]
    script.calls.clear()
    assert script.main(["setup"]) == 0
    assert script.calls == []


def test_two_set_ups_at_once_install_once(script, capsys):
    """The second one waits for the first and finds everything done."""
    begun, checked = threading.Event(), threading.Event()
    record = script.call

    def slow(*command):
        if "venv" in command:
            begun.set()
            assert checked.wait(30)
        return record(*command)

    script.call = slow
    script.time = SimpleNamespace(sleep=lambda _: checked.set())
    first = threading.Thread(target=script.main, args=[["setup"]])
    first.start()
    assert begun.wait(30)
    assert script.main(["setup"]) == 0
    first.join()
    assert kinds(script.calls) == ["-m venv", "-r ", "--editable", "irgspp compile"]
    assert capsys.readouterr().err.count("waiting for another set-up") == 1


def test_changed_lock_installs_into_the_same_environment(script):
    script.main(["setup"])
    script.calls.clear()
    script.LOCK.write_text("numpy==2.0.0\n")
    script.main(["setup"])
    assert kinds(script.calls) == ["-r ", "--editable", "irgspp compile"]


@pytest.mark.parametrize(("status", "code"), [(1, 2), (130, 130)])
def test_interrupted_set_up_is_made_anew(script, status, code):
    script.statuses["pip"] = status
    with pytest.raises(SystemExit) as end:
        script.main(["test"])
    assert end.value.code == code
    assert "-m pytest" not in " ".join(script.calls)
    script.calls.clear()
    script.statuses.clear()
    script.main(["setup"])
    assert kinds(script.calls) == ["-m venv", "-r ", "--editable", "irgspp compile"]


def test_without_compiled_kernels_the_rest_is_set_up(script, capsys):
    script.statuses["compile"] = 1
    assert script.main(["demo"]) == 0
    assert script.calls[-1].endswith("irgspp demo -o demo")
    assert "the first job compiles" in capsys.readouterr().err


def test_broken_environment_is_made_anew(script):
    script.main(["setup"])
    script.PYTHON.unlink()
    script.calls.clear()
    script.main(["setup"])
    assert kinds(script.calls) == ["-m venv", "-r ", "--editable", "irgspp compile"]


def test_arguments_and_exit_status_are_passed_on(script):
    script.statuses["pytest"] = 5
    assert script.main(["test", "-k", "run"]) == 5
    assert "-m pytest " in script.calls[-1] and script.calls[-1].endswith(" -k run")
    assert script.main(["demo", "--resume"]) == 0
    assert script.calls[-1].endswith("irgspp demo -o demo --resume")
    script.main(["demo", "-o", "there"])
    assert script.calls[-1].endswith("irgspp demo -o there")


@pytest.mark.parametrize(("cores", "words"), [(1, []), (2, ["-n", "2", "--dist", "worksteal"]), (64, ["-n", "4", "--dist", "worksteal"])])
def test_a_process_for_each_core(script, monkeypatch, cores, words):
    monkeypatch.setattr(script.os, "sched_getaffinity", lambda _: set(range(cores)), raising=False)
    assert script.workers() == words


def test_wrong_python_gets_one_line(script, monkeypatch, capsys):
    monkeypatch.setattr(script.sys, "version_info", (3, 13, 1, "final", 0))
    with pytest.raises(SystemExit) as end:
        script.main(["setup"])
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "3.11" in error
    assert "3.13" in error
    assert script.calls == []


@pytest.mark.parametrize("arguments", [[], ["install"]])
def test_usage(arguments):
    process = subprocess.run([sys.executable, str(SCRIPT), *arguments], capture_output=True, text=True)
    assert process.returncode == 2
    assert "setup|demo|test" in process.stderr


def test_old_pythons_can_parse_it():
    ast.parse(SCRIPT.read_text("utf-8"), feature_version=(3, 6))


def test_only_the_standard_library():
    imports = [n for n in ast.walk(ast.parse(SCRIPT.read_text("utf-8"))) if isinstance(n, ast.Import | ast.ImportFrom)]
    names = {n.module if isinstance(n, ast.ImportFrom) else n.names[0].name for n in imports}
    assert names <= sys.stdlib_module_names


def test_lock_pins_everything_the_package_needs():
    lines = [line for line in (ROOT / "requirements.lock").read_text("utf-8").splitlines() if line and not line.startswith("#")]
    pins = {}
    for line in lines:
        name, version = re.match(r"([\w.-]+)==([\w.]+)", line).groups()
        pins[name.lower().replace("_", "-")] = (version, "#" in line)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    for requirement in [*project["dependencies"], *project["optional-dependencies"]["test"]]:
        name = re.match(r"[\w.-]+", requirement)[0].lower()
        assert name in pins
        assert pins[name][1], f"{name} has no line that says what it is for"


def test_without_locks_of_the_file_system_a_set_up_goes_on(script, capsys, monkeypatch):
    def unsupported(*_):
        raise OSError(errno.ENOLCK, "no locks")

    name = {"nt": "msvcrt", "posix": "fcntl"}[os.name]
    monkeypatch.setattr(script, name, SimpleNamespace(**vars(getattr(script, name)) | {"flock": unsupported, "locking": unsupported}))
    assert script.main(["setup"]) == 0
    assert kinds(script.calls) == ["-m venv", "-r ", "--editable", "irgspp compile"]
    assert "has no locks" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_one_line(script, tmp_path, capsys):
    (tmp_path / "build").write_text("a file where the lock's folder belongs")
    with pytest.raises(SystemExit) as ended:
        script.main(["setup"])
    assert ended.value.code == 2 and script.calls == []
    assert capsys.readouterr().err.startswith("run.py: could not write ")
