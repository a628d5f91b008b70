# SPDX-License-Identifier: GPL-3.0-or-later
"""Install the engine: a virtual environment with the locked libraries, in place only once it is complete and works.

python install_engine.py TARGET LOCK HASHES PROJECT LAUNCHER --device cpu|cuda [--wheels FOLDER] [--index ADDRESS]

Runs in Blender's own Python, with the standard library alone; progress and cancelling go through the folder $IRGSPP_JOB.
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
MARKER = "irgspp-engine.json"  # in the environment once it is complete
PYTHONS = ((3, 11), (3, 12), (3, 13))  # that the locked libraries have wheels for, best first
PROBE = (
    "import sys, importlib.util as u; print(*sys.version_info[:2], sys.executable, sep='\\n');"
    "print(all(map(u.find_spec, ('venv', 'ensurepip')))); print(all(map(u.find_spec, ('venv', 'pip'))))"
)


class Failed(Exception):
    """Told in one line."""


class Stopped(Exception):
    """The user cancelled."""


class Report:
    """Progress as the engine's commands tell it, see core/progress/recorder.py."""

    def __init__(self, folder: str) -> None:
        self.folder = Path(folder) if folder else None

    def tell(self, **values) -> None:
        print(" ".join(str(values[key]) for key in ("phase", "message") if key in values), file=sys.stderr, flush=True)
        if self.folder is not None:
            with (self.folder / "events.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps({"time": round(time.time(), 3), **values}) + "\n")

    @property
    def cancelled(self) -> bool:
        return self.folder is not None and (self.folder / "cancel").exists()


def requirements(lock: str, extra: list) -> tuple:
    """The libraries to install and the versions of those that they need, as pip's lines, out of the lock file.

    Blender as a module is left out, as Blender itself does its work, and so are tests and tools.
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
    """The Python of a virtual environment."""
    return environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def base_python() -> tuple:
    """(path, version, whether it makes environments with pip) of the best Python at hand. Raises Failed where none serves."""
    found = []
    names = [sys.executable, *(shutil.which(f"python{major}.{minor}") for major, minor in PYTHONS)]
    for name in dict.fromkeys(name for name in names if name):
        try:
            done = subprocess.run([name, "-I", "-c", PROBE], capture_output=True, text=True, timeout=60, check=False)
        except (OSError, subprocess.TimeoutExpired):
            continue
        if done.returncode == 0:
            major, minor, path, venv, pip = done.stdout.split("\n")[:5]
            found.append(((int(major), int(minor)), path, venv == "True", pip == "True"))
    able = [one for one in found if one[0] >= PYTHONS[0] and (one[2] or one[3])]
    if not able:
        seen = ", ".join(f"{path} (Python {v[0]}.{v[1]})" for v, path, *_ in found) or "none"
        raise Failed(
            f"no Python can make an environment: {seen} lack the modules venv and ensurepip; "
            "install them (Debian, Ubuntu: the package python3-venv) or choose an existing environment in the preferences"
        )
    version, path, venv, _ = min(able, key=lambda one: (PYTHONS.index(one[0]) if one[0] in PYTHONS else len(PYTHONS), not one[2]))
    return path, version, venv


def run(command: list, report: Report, hear=lambda line: None) -> None:
    """Run a program, each line it says passed on; raises Stopped, or Failed with its own last word."""
    lines, said = queue.Queue(), []
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    )
    reader = threading.Thread(target=lambda: [*map(lines.put, process.stdout or ())], daemon=True)  # pipes can't be waited for on Windows
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
        said = [*said[-30:], line.strip()] if line.strip() else said
        hear(line)
    if process.wait():
        raise Failed(reason(said) or f"{command[0]} ended with status {process.returncode}")


def reason(said: list) -> str:
    """pip's first error, or what it says of versions that don't go together, which is also how it tells of missing ones."""
    conflict = [line for line in said if " depends on " in line or "(constraint)" in line]
    if conflict:
        return "these can't be had together, or not at all: " + ", ".join(conflict[:4])
    errors = [line.removeprefix("ERROR: ") for line in said if line.startswith("ERROR: ")]
    return (errors or said[-1:] or [""])[0].strip()


def install(args, report: Report) -> None:
    """Everything, into a folder beside the target that takes its place at the end."""
    path, version, venv = base_python()
    with Path(args.project).open("rb") as file:
        extra = tomllib.load(file)["project"]["optional-dependencies"]["cuda"] if args.device == "cuda" else []
    lock = Path(args.lock).read_text("utf-8")
    known = known_files(args.hashes)
    wanted, locked = requirements(lock, extra)
    locked += more_pins(known, locked)
    target = Path(args.target)
    partial = target.with_name(target.name + ".part")
    shutil.rmtree(partial, ignore_errors=True)
    report.tell(phase="environment", step=0, of=1, message=f"Python {version[0]}.{version[1]}: {path}")
    run([path, "-I", "-m", "venv", *([] if venv else ["--without-pip"]), str(partial)], report)
    python = python_of(partial)
    pip = [str(python), "-I", "-m", "pip"] if venv else [path, "-I", "-m", "pip", "--python", str(python)]
    listener, wheels = Listener(report, len(locked)), partial / "wheels"
    run([*pip, *download_arguments(args, partial, wanted, locked), "-d", str(wheels)], report, listener)
    files = verified(wheels, known, bool(args.index))
    run([*pip, "install", *QUIET, "--no-index", "--no-deps", *map(str, files)], report, listener)
    shutil.rmtree(wheels)
    report.tell(phase="check", step=0, of=1, message="Checking")
    answers = []
    run([str(python), args.launcher, "__main__", "devices", "--json"], report, answers.append)
    digest = hashlib.sha256(Path(args.lock).read_bytes()).hexdigest()
    noted = {"lock": digest, "device": args.device, "python": f"{version[0]}.{version[1]}"}
    (partial / MARKER).write_text(json.dumps(noted), encoding="utf-8")
    replace(partial, target)
    report.tell(phase="done", step=1, of=1, message="Installed")
    print("\n".join(answers))  # what the engine says of itself


def known_files(hashes: str) -> dict:
    """SHA-256 by file name, of every file that this version may be made of; lines as sha256sum writes them."""
    lines = Path(hashes).read_text("utf-8").splitlines()
    return {name: digest for digest, name in (line.split("  ", 1) for line in lines if line)}


def more_pins(known: dict, locked: list) -> list:
    """The versions of known files that the lock has none of: libraries of CUDA, which torch asks for on Linux alone."""
    named = {plain(pin.split("==")[0]) for pin in locked}
    return sorted({"==".join(file.split("-")[:2]) for file in known if plain(file.split("-")[0]) not in named})


def plain(name: str) -> str:
    """A package's name as indices spell it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def verified(folder: Path, known: dict, own_index: bool) -> list:
    """The wheels in a folder. Raises Failed for one that is not known, before any of them is opened.

    Builds of their own (+cpu, +cu126) can come only from the index that the user named, which answers for them.
    """
    files = sorted(folder.iterdir())
    for file in files:
        if file.name not in known and own_index and "+" in file.name:
            print(f"{file.name}: of the index that was named, not one of the known files", file=sys.stderr, flush=True)
            continue
        digest = hashlib.sha256()
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
        if known.get(file.name) != digest.hexdigest():
            why = "another file than the known one of that name" if file.name in known else "not one of the known files"
            raise Failed(f"{file.name} is {why} (SHA-256 {digest.hexdigest()}), so nothing of it was run")
    return files


def download_arguments(args, folder: Path, wanted: list, locked: list) -> list:
    """pip's words: built packages only, as nobody has compilers, and exactly the locked versions."""
    (folder / "wanted.txt").write_text("\n".join(wanted), encoding="utf-8")
    (folder / "locked.txt").write_text("\n".join(locked), encoding="utf-8")
    words = ["download", *QUIET, "--only-binary", ":all:", "-r", str(folder / "wanted.txt"), "-c", str(folder / "locked.txt")]
    if args.wheels:
        return [*words, "--no-index", "--find-links", args.wheels]
    return [*words, "--extra-index-url", args.index] if args.index else words


class Listener:
    """Tells pip's lines as progress."""

    def __init__(self, report: Report, packages: int) -> None:
        self.report, self.of, self.step = report, packages + 5, 0
        report.tell(phase="libraries", step=0, of=self.of, message="Looking for libraries")

    def __call__(self, line: str) -> None:
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
        self.report.tell(phase="libraries", step=self.step, of=self.of, message=text)


def replace(new: Path, place: Path) -> None:
    """Put a folder in place of another, which is deleted."""
    old = place.with_name(place.name + ".old")
    shutil.rmtree(old, ignore_errors=True)
    if place.exists():
        place.rename(old)
    new.rename(place)
    shutil.rmtree(old, ignore_errors=True)


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("target", "lock", "hashes", "project", "launcher"):
        parser.add_argument(name)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--wheels")
    parser.add_argument("--index")
    args = parser.parse_args(arguments)
    try:
        install(args, Report(os.environ.get("IRGSPP_JOB", "")))
        return 0
    except Stopped:
        return _given_up(args, 130, "cancelled; nothing was changed")
    except Failed as error:
        return _given_up(args, 1, f"the engine could not be installed: {error}")
    except OSError as error:
        return _given_up(args, 1, f"the engine could not be installed: {error.filename or ''}: {error.strerror or error}")


def _given_up(args, status: int, line: str) -> int:
    shutil.rmtree(args.target + ".part", ignore_errors=True)
    print(f"irgspp: {line}", file=sys.stderr, flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
