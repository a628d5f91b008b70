# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests in several versions of Blender: kinds of failure are distinguished, and engine libraries in Blender's environment are refused."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def script(monkeypatch):
    spec = importlib.util.spec_from_file_location("test_blender_versions_script", ROOT / "scripts" / "test_blender_versions.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def tested(script, tmp_path, monkeypatch):
    """Return a function that runs the text of a test file as the tests of a version, in this Python."""
    monkeypatch.setattr(script, "ENGINE_ONLY", ())

    def run(text: str, limit: float = 100.0):
        (tmp_path / "test_it.py").write_text(text)
        words = ["--rootdir", str(tmp_path), "-c", str(tmp_path / "none.ini"), str(tmp_path / "test_it.py")]
        (tmp_path / "none.ini").write_text("[pytest]\n")
        return script.run_tests(script.VERSIONS["4.5"], Path(sys.executable), sys.executable, words, limit)

    return run


def test_passed_failed_and_skipped_are_counted(tested):
    text = "import pytest\ndef test_a(): pass\ndef test_b(): assert False\n@pytest.mark.skip\ndef test_c(): pass\n"
    result = tested(text)
    assert (result.end, result.passed, result.failed, result.skipped) == ("failed", 1, 1, 1)


def test_the_engine_is_named_to_the_tests(tested):
    result = tested(f"import os\ndef test_a(): assert os.environ['IRGSPP_PYTHON'] == {sys.executable!r}\n")
    assert (result.end, result.passed) == ("passed", 1)


def test_crash_at_the_end_is_not_taken_for_success(tested):
    result = tested("import atexit, os\natexit.register(os.abort)\ndef test_a(): pass\n")
    assert result.end == "ended with -6" if sys.platform != "win32" else result.end != "passed"
    assert result.passed == 1


def test_process_that_hangs_is_ended(tested):
    assert tested("import time\ndef test_a(): time.sleep(60)\n", limit=2).end == "hung"


def test_libraries_of_the_engine_in_blenders_environment_are_refused(script):
    result = script.run_tests(script.VERSIONS["4.5"], Path(sys.executable), sys.executable, [], 10)
    assert result.end.startswith("has torch")


def test_bad_usage(script, monkeypatch, capsys, tmp_path):
    assert script.main(["3.6"]) == 2
    assert "no version 3.6; there are 4.2, 4.5, 5.0, 5.2" in capsys.readouterr().err
    assert script.main(["4.5", "--engine", str(tmp_path / "nothing")]) == 2
    assert "can't be the engine" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        script.main(["5.2", "--engine", sys.executable, "--python313", str(tmp_path / "nothing")])
    assert ended.value.code == 2
    assert "name one by --python313" in capsys.readouterr().err


def test_environment_is_made_once_and_anew_for_other_packages(script, tmp_path, monkeypatch):
    version = script.Version("0.0", script.VERSIONS["4.5"].python, ())
    monkeypatch.setattr(script.subprocess, "run", lambda words, **_: made.append(words[-1]) or (tmp_path / "0.0").mkdir(exist_ok=True))
    monkeypatch.setattr(script, "mount", lambda python: None)
    monkeypatch.setattr(script, "output", lambda python, code: "")
    made = []
    for packages, times in [((), 2), ((), 2), (("numpy",), 4)]:
        script.environment(script.Version(version.name, version.python, packages), sys.executable, tmp_path)
        assert len(made) == times


def test_table_has_a_line_for_each(script):
    results = [script.Result(version, "passed", passed=7) for version in script.VERSIONS.values()]
    lines = script.table(results).splitlines()
    assert [line.split()[0] for line in lines[1:]] == ["4.2.23", "4.5.15", "5.0.1", "5.2.3"]
    assert all(line.split()[2] == "7" for line in lines[1:])
