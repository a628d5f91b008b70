# SPDX-License-Identifier: GPL-3.0-or-later
"""Installer of the managed engine: a virtual environment with the locked libraries, put in place once it is complete and works.

python install.py TARGET LOCK HASHES PROJECT LAUNCHER --device cpu|cuda [--wheels FOLDER] [--index ADDRESS]

It runs in Blender's own Python with the standard library alone; progress and cancellation go through the folder $IRGSPP_JOB.
"""

import argparse
import hashlib
import json
import os
import queue
import re
import shutil
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path

QUIET = ("--no-input", "--disable-pip-version-check", "--progress-bar", "off")
MARKER = "irgspp-engine.json"  # file in a complete environment
PYTHONS = ((3, 11), (3, 12), (3, 13))  # versions for which the locked libraries have wheels, best first
PROBE = (
    "import sys, importlib.util as u; print(*sys.version_info[:2], sys.executable, sep='\\n');"
    "print(all(map(u.find_spec, ('venv', 'ensurepip')))); print(all(map(u.find_spec, ('venv', 'pip'))))"
)


class Failed(Exception):
    """Failure of the installation, described in one line."""


class Stopped(Exception):
    """Cancellation by the user."""


class Report:
    """Progress recorder with the events of core/progress/recorder.py."""

    def __init__(self, folder: str) -> None:
        self.folder = Path(folder) if folder else None

    def record(self, **values) -> None:
        """Append an event with these values to events.jsonl and print its phase and message."""
        print(" ".join(str(values[key]) for key in ("phase", "message") if key in values), file=sys.stderr, flush=True)
        if self.folder is not None:
            with (self.folder / "events.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps({"time": round(time.time(), 3), **values}) + "\n")

    @property
    def cancelled(self) -> bool:
        """True once the user has cancelled the job."""
        return self.folder is not None and (self.folder / "cancel").exists()


def requirements(lock: str, extra: list) -> tuple:
    """Return the libraries to install and the pins of all their dependencies, as lines for pip; without bpy, tests and tools.

    Args:
        lock: text of the lock file.
        extra: further libraries to install.
    """
    sections, section = {}, ""
    for line in lock.splitlines():
        if line.startswith("# ---"):
            section = line.split()[2]
        pin = line.split("#")[0].strip()
        if pin and not pin.startswith("bpy=="):
            sections.setdefault(section, []).append(pin)
    return sections["run"] + extra, [pin for pins in sections.values() for pin in pins]


def python_of(environment: Path) -> Path:
    """Return the path of the Python in a virtual environment."""
    return environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def base_python() -> tuple:
    """Return path, version and the availability of the module venv of the best Python installed; raise Failed if none is suitable."""
    found = []
    names = [sys.executable, *(shutil.which(f"python{major}.{minor}") for major, minor in PYTHONS)]
    for name in dict.fromkeys(name for name in names if name):
        try:
            probe = subprocess.run([name, "-I", "-c", PROBE], capture_output=True, text=True, timeout=60, check=False)
        except (OSError, subprocess.TimeoutExpired):
            continue
        if probe.returncode == 0:
            major, minor, path, venv, pip = probe.stdout.split("\n")[:5]
            found.append(((int(major), int(minor)), path, venv == "True", pip == "True"))
    suitable = [one for one in found if one[0] >= PYTHONS[0] and (one[2] or one[3])]
    if not suitable:
        listed = ", ".join(f"{path} (Python {v[0]}.{v[1]})" for v, path, *_ in found) or "none"
        raise Failed(
            f"no installed Python can create a virtual environment: {listed} lack the modules venv and ensurepip; "
            "install them (Debian, Ubuntu: the package python3-venv) or choose an existing environment in the preferences"
        )
    version, path, venv, _ = min(suitable, key=lambda one: (PYTHONS.index(one[0]) if one[0] in PYTHONS else len(PYTHONS), not one[2]))
    return path, version, venv


def run(command: list, report: Report, on_line=lambda line: None) -> None:
    """Run a program and log its output; raise Stopped if the user cancels, Failed with the program's error if it fails.

    Args:
        command: command line.
        report: progress recorder, asked for cancellation.
        on_line: function called with each line of output.
    """
    lines, recent = queue.Queue(), []
    own = {name: value for name, value in os.environ.items() if name != "IRGSPP_JOB"}  # the report of this job is the installer's alone
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", env=own
    )
    reader = threading.Thread(target=lambda: [*map(lines.put, process.stdout or ())], daemon=True)  # on Windows one can't wait for pipes
    reader.start()
    while reader.is_alive() or not lines.empty():
        if report.cancelled:
            process.kill()
            process.wait()
            raise Stopped
        try:
            line = lines.get(timeout=0.1).rstrip()
        except queue.Empty:
            continue
        print(line, file=sys.stderr, flush=True)
        recent = [*recent[-30:], line.strip()] if line.strip() else recent
        on_line(line)
    if process.wait():
        raise Failed(reason(recent) or f"{command[0]} ended with status {process.returncode}")


def reason(lines: list) -> str:
    """Return pip's first error in its output, or its list of conflicting versions, which it also prints for missing ones."""
    conflict = [line for line in lines if " depends on " in line or "(constraint)" in line]
    if conflict:
        return "these libraries conflict or are missing: " + ", ".join(conflict[:4])
    errors = [line.removeprefix("ERROR: ") for line in lines if line.startswith("ERROR: ")]
    return (errors or lines[-1:] or [""])[0].strip()


def _install(args, report: Report) -> None:
    """Install into a temporary folder next to the target, check the result, and move it into place."""
    path, version, venv = base_python()
    with Path(args.project).open("rb") as file:
        extra = tomllib.load(file)["project"]["optional-dependencies"]["cuda"] if args.device == "cuda" else []
    lock = Path(args.lock).read_text("utf-8")
    known = known_files(args.hashes)
    required, locked = requirements(lock, extra)
    locked += more_pins(known, locked)
    target = Path(args.target)
    partial = target.with_name(target.name + ".part")
    shutil.rmtree(partial, ignore_errors=True)
    report.record(phase="environment", step=0, of=1, message=f"Python {version[0]}.{version[1]}: {path}")
    run([path, "-I", "-m", "venv", *([] if venv else ["--without-pip"]), str(partial)], report)
    python = python_of(partial)
    pip = [str(python), "-I", "-m", "pip"] if venv else [path, "-I", "-m", "pip", "--python", str(python)]
    listener, wheels = Listener(report, len(locked)), partial / "wheels"
    run([*pip, *download_arguments(args, partial, required, locked), "-d", str(wheels)], report, listener)
    files = verified(wheels, known, bool(args.index))
    run([*pip, "install", *QUIET, "--no-index", "--no-deps", *map(str, files)], report, listener)
    shutil.rmtree(wheels)
    report.record(phase="check", step=0, of=1, message="Checking")
    answers = []
    run([str(python), args.launcher, "__main__", "devices", "--json"], report, answers.append)
    compile_kernels(python, args.launcher, report)
    digest = hashlib.sha256(Path(args.lock).read_bytes()).hexdigest()
    marker = {"lock": digest, "device": args.device, "python": f"{version[0]}.{version[1]}"}
    (partial / MARKER).write_text(json.dumps(marker), encoding="utf-8")
    _replace(partial, target)
    report.record(phase="done", step=1, of=1, message="Installed")
    print("\n".join(answers))  # the engine's answer to `devices --json`


def compile_kernels(python: Path, launcher: str, report: Report) -> None:
    """Let the engine compile its kernels, which takes under a minute, so that the first job need not.

    Args:
        python: the engine's Python.
        launcher: script that starts the engine's commands.
        report: progress recorder, asked for cancellation.
    """

    def record(percent: int) -> None:
        report.record(phase="kernels", step=percent, of=100, message="Compiling kernels for this processor")

    def on_line(line: str) -> None:
        if found := re.search(r"(\d+)%", line):
            record(int(found[1]))

    record(0)
    run([str(python), launcher, "__main__", "compile"], report, on_line)


def known_files(hashes: str) -> dict:
    """Return the SHA-256, by file name, of each wheel that may be installed, from a file in the format of sha256sum."""
    lines = Path(hashes).read_text("utf-8").splitlines()
    return {name: digest for digest, name in (line.split("  ", 1) for line in lines if line)}


def more_pins(known: dict, locked: list) -> list:
    """Return pins for known files whose library is not in the lock: CUDA libraries, which torch requires on Linux alone.

    Args:
        known: SHA-256 by file name.
        locked: pins of the lock file.
    """
    named = {plain(pin.split("==")[0]) for pin in locked}
    return sorted({"==".join(file.split("-")[:2]) for file in known if plain(file.split("-")[0]) not in named})


def plain(name: str) -> str:
    """Normalise a package's name as package indices do (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def verified(folder: Path, known: dict, own_index: bool) -> list:
    """Return the wheels in a folder, or raise Failed for an unknown one before any of them is opened.

    Args:
        folder: folder of downloaded wheels.
        known: SHA-256 by file name.
        own_index: True if the user named an index; its local builds (+cpu, +cu126) are trusted, as they can come only from there.
    """
    files = sorted(folder.iterdir())
    for file in files:
        if file.name not in known and own_index and "+" in file.name:
            print(f"{file.name}: from the index named by the user, not one of the known files", file=sys.stderr, flush=True)
            continue
        digest = hashlib.sha256()
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
        if known.get(file.name) != digest.hexdigest():
            why = "another file than the known one of that name" if file.name in known else "not one of the known files"
            raise Failed(f"{file.name} is {why} (SHA-256 {digest.hexdigest()}); it was not installed, and no code of it was run")
    return files


def download_arguments(args, folder: Path, required: list, locked: list) -> list:
    """Return pip's arguments to download wheels of exactly the locked versions; source packages would need a compiler.

    Args:
        args: parsed command line.
        folder: folder for the lists that pip reads.
        required: libraries to install.
        locked: pins of all versions.
    """
    (folder / "wanted.txt").write_text("\n".join(required), encoding="utf-8")
    (folder / "locked.txt").write_text("\n".join(locked), encoding="utf-8")
    words = ["download", *QUIET, "--only-binary", ":all:", "-r", str(folder / "wanted.txt"), "-c", str(folder / "locked.txt")]
    if args.wheels:
        return [*words, "--no-index", "--find-links", args.wheels]
    return [*words, "--extra-index-url", args.index] if args.index else words


class Listener:
    """Converter of pip's output into progress events."""

    def __init__(self, report: Report, packages: int) -> None:
        self.report, self.of, self.step = report, packages + 5, 0
        report.record(phase="libraries", step=0, of=self.of, message="Looking for libraries")

    def __call__(self, line: str) -> None:
        """Record the progress that a line of pip's output shows."""
        found = re.match(r"\s*(Collecting|Downloading|Processing|Installing collected packages)\b:?\s*(\S+)", line)
        if not found:
            return
        verb, what = found.groups()
        if verb == "Collecting":
            self.step = min(self.step + 1, self.of - 2)
        elif verb.startswith("Installing"):
            self.step, verb, what = self.of - 1, "Installing", "them all"
        size = re.search(r"\(([\d.]+ [kMG]?B)\)", line)
        text = f"{verb} {what.rpartition('/')[2]}" + (f", {size[1]}" if size else "")
        self.report.record(phase="libraries", step=self.step, of=self.of, message=text)


def _replace(new: Path, target: Path) -> None:
    """Move the folder `new` to `target` and delete the folder that was there."""
    old = target.with_name(target.name + ".old")
    shutil.rmtree(old, ignore_errors=True)
    if target.exists():
        target.rename(old)
    new.rename(target)
    shutil.rmtree(old, ignore_errors=True)


def main(arguments=None) -> int:
    """Run the installer and return its exit status: 0, 1 if it failed, 130 if it was cancelled."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("target", "lock", "hashes", "project", "launcher"):
        parser.add_argument(name)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--wheels")
    parser.add_argument("--index")
    args = parser.parse_args(arguments)
    try:
        _install(args, Report(os.environ.get("IRGSPP_JOB", "")))
        return 0
    except Stopped:
        return _clean_up(args, 130, "cancelled; nothing was changed")
    except Failed as error:
        return _clean_up(args, 1, f"the engine could not be installed: {error}")
    except OSError as error:
        return _clean_up(args, 1, f"the engine could not be installed: {error.filename or ''}: {error.strerror or error}")


def _clean_up(args, status: int, line: str) -> int:
    """Delete the temporary folder, print the reason, and return the exit status."""
    shutil.rmtree(args.target + ".part", ignore_errors=True)
    print(f"irgspp: {line}", file=sys.stderr, flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
