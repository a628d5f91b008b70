# SPDX-License-Identifier: GPL-3.0-or-later
"""Managed engine: installed by a job from wheels made here, completely or not at all, and removed."""

import hashlib
import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from blender_side import ROOT
from engine_jobs import registry as registry
from engine_jobs import until
from irgspp.core.errors import InputError
from irgspp.core.machine.version import LIBRARIES, VERSION
from irgspp.irgspp_addon.engine import install as install_engine
from irgspp.irgspp_addon.engine import managed
from irgspp.irgspp_addon.engine import process as engine
from irgspp.irgspp_addon.jobs import engine_check, queue

LOCK = """# comment
# --- run time, each with its reason
bpy==4.5.15         # Blender itself
tinylib==1.2        # the library
# --- tests and tools
unwanted==9
# --- what those need
tinydep==3.4
"""
PROJECT = '[project]\nname = "x"\n[project.optional-dependencies]\ncuda = ["tinycuda==1.0"]\n'
LAUNCHER = f"""
import importlib.util, json, tinylib
assert tinylib.DEP == 34
cuda = [{{"name": str(importlib.util.find_spec("tinycuda"))}}]
print(json.dumps({{"irgspp": {VERSION!r}, "python": "3", "cpu": {{"name": "c"}}, "cuda": cuda}}))
"""

PATIENCE = 300.0  # seconds, enough on a busy machine


def wheel(folder: Path, name: str, version: str, code: str, *needs: str) -> None:
    info = f"{name}-{version}.dist-info"
    needed = "".join(f"Requires-Dist: {need}\n" for need in needs)
    files = {
        f"{name}.py": code,
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{needed}",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w") as archive:
        for path, text in files.items():
            archive.writestr(path, text)
        archive.writestr(f"{info}/RECORD", "".join(f"{path},,\n" for path in [*files, f"{info}/RECORD"]))


@pytest.fixture
def wheels(tmp_path):
    folder = tmp_path / "wheels"
    folder.mkdir()
    wheel(folder, "tinylib", "1.2", "from tinydep import DEP", "tinydep")
    wheel(folder, "tinydep", "3.4", "DEP = 34")
    wheel(folder, "tinydep", "9.9", "DEP = 99")  # newer than the locked one
    wheel(folder, "tinycuda", "1.0", "")
    return folder


@pytest.fixture
def install(tmp_path, registry, monkeypatch):
    """Return a function that starts the installation of a tiny engine as a job."""
    names = {"lock": LOCK, "project.toml": PROJECT, "launcher.py": LAUNCHER}
    for name, text in names.items():
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(managed, "HASHES", tmp_path / "hashes")
    monkeypatch.setattr(managed, "LOCK", tmp_path / "lock")
    monkeypatch.setattr(managed, "PROJECT", tmp_path / "project.toml")
    monkeypatch.setattr(managed, "LAUNCHER", tmp_path / "launcher.py")
    monkeypatch.setattr(engine, "engine_kind", lambda: "MANAGED")
    monkeypatch.setattr(queue, "ON_END", engine_check.ON_END)

    def start(wheels, device="cpu", change=lambda lines: lines):
        lines = change([f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}" for file in sorted(wheels.glob("*.whl"))])
        (tmp_path / "hashes").write_text("\n".join(lines) + "\n")
        arguments = managed.install_arguments(device, wheels, "", online=False)
        return queue.start("install", "Install engine", managed.folder(), arguments, program=str(managed.INSTALLER))

    return start


@pytest.fixture
def other_pip(tmp_path, monkeypatch):
    """Install with the pip of another Python, which takes half as long as an environment with one of its own."""
    probe = f"print('3\\n11\\n{sys.executable}\\nFalse\\nTrue')"
    script = tmp_path / "install.py"
    script.write_text(Path(install_engine.__file__).read_text().replace("PROBE = (", f"PROBE = {probe!r} or ("))
    monkeypatch.setattr(managed, "INSTALLER", script)


def test_installation_from_wheels_and_removal(install, wheels, request):
    assert engine.status().state == "missing"
    job = queue.wait(install(wheels), PATIENCE)
    assert job.state == "done", job.log_tail()
    phases = [json.loads(line)["phase"] for line in (job.notes / "events.jsonl").read_text().splitlines()]
    assert list(dict.fromkeys(phases)) == ["environment", "libraries", "check", "kernels", "done"] and job.fraction == 1.0
    assert engine.status().state == "ok" and "None" in engine.status().text  # without the library for CUDA
    names = sorted(p.name for p in managed.folder().parent.iterdir())
    assert names == ["engine", "engines.json", "jobs"]
    assert managed.marker()["device"] == "cpu"
    python = managed.python()
    version = subprocess.run([python, "-c", "import tinydep; print(tinydep.DEP)"], capture_output=True, text=True, check=True).stdout
    assert version.strip() == "34"  # the locked one
    # Installed anew for another device, in place of the old one, and with the pip of another Python.
    request.getfixturevalue("other_pip")
    again = queue.wait(install(wheels, "cuda"), PATIENCE)
    assert again.state == "done", again.log_tail()
    assert json.loads(again.output())["irgspp"] == VERSION
    assert "tinycuda" in engine.status().text and managed.marker()["device"] == "cuda"
    managed.remove()
    assert engine.status().state == "missing" and not managed.folder().exists()
    with pytest.raises(InputError, match="no engine to remove"):
        managed.remove()
    until(lambda: not list(managed.folder().parent.glob("engine.*")))


def test_missing_library_is_named_and_no_file_is_left(install, other_pip, wheels):
    for version in ("3.4", "9.9"):
        (wheels / f"tinydep-{version}-py3-none-any.whl").unlink()
    job = queue.wait(install(wheels), PATIENCE)
    assert job.state == "failed" and "tinydep" in job.error and "\n" not in job.error
    assert engine.status().state == "missing"
    assert not list(managed.folder().parent.glob("engine*"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda lines: [line.replace(line[:8], "0" * 8) if "tinylib" in line else line for line in lines],
            "another file than the known one",
        ),
        (lambda lines: [line for line in lines if "tinydep" not in line], "not one of the known files"),
    ],
)
def test_unknown_files_are_rejected(install, other_pip, wheels, change, words):
    job = queue.wait(install(wheels, change=change), PATIENCE)
    assert job.state == "failed" and words in job.error and "\n" not in job.error
    assert not list(managed.folder().parent.glob("engine*"))


def test_builds_of_an_index_that_the_user_named(tmp_path):
    (tmp_path / "torch-2.0+cpu-cp311-cp311-linux_x86_64.whl").write_bytes(b"torch")
    assert install_engine.verified(tmp_path, {}, own_index=True)
    with pytest.raises(install_engine.Failed, match="not one of the known files"):
        install_engine.verified(tmp_path, {}, own_index=False)
    (tmp_path / "numpy-2.0-cp311-cp311-linux_x86_64.whl").write_bytes(b"not theirs to answer for")
    with pytest.raises(install_engine.Failed, match="numpy"):
        install_engine.verified(tmp_path, {}, own_index=True)


def test_every_locked_version_has_known_files():
    known = install_engine.known_files(str(ROOT / "requirements.sha256"))
    _, locked = install_engine.requirements((ROOT / "requirements.lock").read_text(), [])
    available = {(install_engine.plain(file.split("-")[0]), file.split("-")[1]) for file in known}
    for pin in locked:
        name, version = pin.partition(";")[0].split("==")
        assert (install_engine.plain(name), version.strip()) in available, f"{pin}: run scripts/lock_hashes.py"
    assert all(re.fullmatch("[0-9a-f]{64}", digest) for digest in known.values())
    more = install_engine.more_pins(known, locked)
    assert not {install_engine.plain(pin.split("==")[0]) for pin in more} & {install_engine.plain(pin.split("==")[0]) for pin in locked}


def test_engine_that_does_not_work_is_not_put_in_place(install, other_pip, wheels, tmp_path):
    managed.python().parent.mkdir(parents=True)
    managed.python().write_text("an older engine")
    (tmp_path / "launcher.py").write_text("raise SystemExit('irgspp: no torch')")
    job = queue.wait(install(wheels), PATIENCE)
    assert job.state == "failed" and "no torch" in job.error
    assert managed.python().read_text() == "an older engine"


def test_cancelled_installation_leaves_no_file(install, wheels):
    job = install(wheels)
    until(lambda: job.phase)
    queue.cancel(job)
    until(lambda: job.finished)
    assert job.state == "cancelled" and not list(managed.folder().parent.glob("engine*"))


def test_bad_arguments(tmp_path, registry):
    with pytest.raises(InputError, match="may not use the network"):
        managed.install_arguments("cpu", None, "", online=False)
    with pytest.raises(InputError, match=r"\*\.whl"):
        managed.install_arguments("cpu", tmp_path, "", online=True)
    with pytest.raises(InputError, match="cpu or cuda"):
        managed.install_arguments("tpu", None, "", online=True)
    assert "--index" in managed.install_arguments("cpu", None, "https://example.org/simple", online=True)


def test_the_lock_covers_the_engines_libraries():
    required, locked = install_engine.requirements((ROOT / "requirements.lock").read_text(), ["extra==1"])
    names = {pin.split("==")[0] for pin in required}
    assert names == {name for name, _ in LIBRARIES.values()} | {"extra", "coacd"}  # without coacd, collision hulls are simpler
    assert 'numpy==1.26.4; python_version < "3.13"' in required and not [pin for pin in locked if pin.startswith("bpy")]
    assert {"llvmlite", "sympy"} <= {pin.split("==")[0] for pin in locked}


def test_no_python_that_can_make_environments(monkeypatch):
    monkeypatch.setattr(install_engine, "PROBE", "print('3\\n11\\n/usr/bin/python3\\nFalse\\nFalse')")
    with pytest.raises(install_engine.Failed, match=r"/usr/bin/python3 .*ensurepip.*python3-venv"):
        install_engine.base_python()
    monkeypatch.setattr(install_engine, "PROBE", f"print('3\\n12\\n{sys.executable}\\nFalse\\nTrue')")
    assert install_engine.base_python() == (sys.executable, (3, 12), False)
