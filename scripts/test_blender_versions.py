# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the tests of Blender's side in several versions of Blender, as the module bpy, each in a private environment.

None of the engine's libraries is installed there, which proves that Blender's own process needs none: the engine is another Python
($IRGSPP_PYTHON, --engine, or that of .venv). Words after `--` go to pytest; folders and files among them replace FOLDERS.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parent.parent
LAUNCHER = ROOT / "irgspp_addon" / "launch.py"
FOLDERS = ("tests/irgspp_addon", "tests/operators", "tests/panels")
ENGINE_ONLY = ("torch", "numba", "scipy", "cv2", "PIL", "embreex", "warp", "OpenEXR", "plyfile", "trimesh", "skimage", "xatlas")
SCRIPTS = "Scripts/python.exe" if os.name == "nt" else "bin/python"


@dataclass(frozen=True)
class Version:
    """Version of Blender with the Python it comes with and the packages of its test environment."""

    name: str
    python: str
    packages: tuple[str, ...]


TOOLS = ("pytest==9.2.0", "hypothesis==6.170.15")
VERSIONS = {
    version.name: version
    for version in (
        Version("4.2", "3.11", ("bpy==4.2.23", "numpy==1.26.4", *TOOLS)),
        Version("4.5", "3.11", ("bpy==4.5.15", "numpy==1.26.4", *TOOLS)),
        Version("5.0", "3.11", ("bpy==5.0.1", "numpy==1.26.4", *TOOLS)),
        Version("5.2", "3.13", ("bpy==5.2.3", "numpy>=2.3", *TOOLS)),
    )
}


@dataclass(frozen=True)
class Result:
    """Result of a version: `end` is "passed", or the failure in a word or two."""

    version: Version
    end: str
    passed: int = 0
    failed: int = 0
    skipped: int = 0
    seconds: float = 0.0


def find_python(version: str, given: str | None) -> str:
    """Return a Python of a version that starts: the one given, this one, or one on PATH.

    Args:
        version: version such as "3.11".
        given: path from the command line, or None.

    Raises:
        SystemExit: with status 2, where there is none.
    """
    for candidate in [given] if given else [sys.executable, shutil.which(f"python{version}")]:
        if candidate and output(candidate, "import sys; print('%d.%d' % sys.version_info[:2])") == version:
            return candidate
    raise SystemExit(usage(f"no Python {version}{f' at {given}' if given else ' on PATH'}; name one by --python{version.replace('.', '')}"))


def usage(reason: str) -> int:
    """Print what is wrong with the options and return the exit status."""
    print(f"test_blender_versions: {reason}", file=sys.stderr)
    return 2


def output(python: str | Path, code: str) -> str | None:
    """Return what a line of Python prints.

    Args:
        python: interpreter.
        code: code to run.

    Returns:
        The output without the final newline; None where the code fails.
    """
    try:
        done = subprocess.run([str(python), "-c", code], capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def environment(version: Version, python: str, cache: Path) -> Path:
    """Return the Python of a version's test environment, which is made where it is missing, unfinished or has other packages.

    Args:
        version: version of Blender.
        python: Python to make the environment with.
        cache: folder of all environments.
    """
    folder = cache / version.name
    stamp, found = folder / "packages.txt", folder / SCRIPTS
    packages = "\n".join(version.packages)
    if stamp.exists() and stamp.read_text("utf-8") == packages and output(found, "") is not None:
        mount(found)
        return found
    print(f"test_blender_versions: making {folder}", file=sys.stderr, flush=True)
    make = f"import venv; venv.create({str(folder)!r}, clear=True, with_pip=True, symlinks={os.name != 'nt'})"
    subprocess.run([python, "-c", make], check=True)
    subprocess.run([str(found), "-m", "pip", "install", "--quiet", *version.packages], check=True)
    mount(found)
    stamp.write_text(packages, "utf-8")
    return found


def mount(python: Path) -> None:
    """Make `import irgspp` mean this folder in an environment, without installing the package's dependencies."""
    packages = output(python, "import sysconfig; print(sysconfig.get_path('purelib'))")
    assert packages is not None
    line = f"import pathlib, runpy; runpy.run_path({str(LAUNCHER)!r})['mount'](pathlib.Path({str(ROOT)!r}))\n"
    Path(packages, "irgspp_source.pth").write_text(line, "utf-8")


def run_tests(version: Version, python: Path, engine: str, words: list[str], limit: float) -> Result:
    """Run the tests in one version; a process that crashes or hangs at its end is distinguished from failed tests.

    Args:
        version: version of Blender.
        python: Python of its test environment.
        engine: Python of the engine.
        words: options and files for pytest.
        limit: seconds that the tests may take.
    """
    heavy = output(python, f"import importlib.util as u; print(*[n for n in {ENGINE_ONLY!r} if u.find_spec(n)])")
    if heavy:
        return Result(version, f"has {heavy}")
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="irgspp-blender-") as folder:
        report = Path(folder, "report.xml")
        places = [] if any(Path(word.split("::")[0]).exists() for word in words) else [*FOLDERS]
        command = [str(python), "-m", "pytest", "-p", "no:cacheprovider", f"--junitxml={report}", *places, *words]
        variables = {"IRGSPP_PYTHON": engine, "BLENDER_USER_RESOURCES": folder, "PYTHONDONTWRITEBYTECODE": "1"}
        try:
            status = subprocess.run(command, cwd=ROOT, env={**os.environ, **variables}, timeout=limit, check=False).returncode
            end = {0: "passed", 1: "failed"}.get(status, f"ended with {status}")
        except subprocess.TimeoutExpired:
            end = "hung"
        return counted(Result(version, end, seconds=time.monotonic() - began), report)


def counted(result: Result, report: Path) -> Result:
    """Return a result with the numbers of pytest's report, where there is one.

    Args:
        result: result of the process.
        report: report of pytest as XML.
    """
    if not report.is_file():
        return result
    suites = ElementTree.parse(report).getroot().iter("testsuite")
    total = {name: 0 for name in ("tests", "failures", "errors", "skipped")}
    for suite in suites:
        for name in total:
            total[name] += int(suite.get(name, 0))
    failed = total["failures"] + total["errors"]
    return Result(result.version, result.end, total["tests"] - failed - total["skipped"], failed, total["skipped"], result.seconds)


def table(results: list[Result]) -> str:
    """Return the results as a table with a line for each version."""
    lines = [f"{'Blender':10}{'Python':10}{'passed':>8}{'failed':>8}{'skipped':>9}{'seconds':>9}  end"]
    for r in results:
        packages = r.version.packages[0].removeprefix("bpy==")
        lines.append(f"{packages:10}{r.version.python:10}{r.passed:8}{r.failed:8}{r.skipped:9}{r.seconds:9.0f}  {r.end}")
    return "\n".join(lines)


def arguments(words: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """Parse our options, and split off pytest's after `--`."""
    ours, theirs = (words[: words.index("--")], words[words.index("--") + 1 :]) if "--" in words else (words, [])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("versions", nargs="*", metavar="VERSION", help=f"of {', '.join(VERSIONS)} (default: all)")
    parser.add_argument("--cache", type=Path, default=ROOT / ".blender_versions", help="folder of the environments (0.5 to 1 GB each)")
    parser.add_argument("--engine", help="Python that has the engine's libraries (default: $IRGSPP_PYTHON, or that of .venv)")
    parser.add_argument("--python311", help="Python 3.11 to make environments with (default: this one, or python3.11)")
    parser.add_argument("--python313", help="Python 3.13 to make environments with (default: this one, or python3.13)")
    parser.add_argument("--timeout", type=float, default=1800, metavar="S", help="seconds that the tests of one version may take")
    return parser.parse_args(ours), theirs


def main(words: list[str]) -> int:
    """Run the tests in the chosen versions and return the exit status."""
    args, theirs = arguments(words)
    unknown = [name for name in args.versions if name not in VERSIONS]
    if unknown:
        return usage(f"no version {unknown[0]}; there are {', '.join(VERSIONS)}")
    engine = args.engine or os.environ.get("IRGSPP_PYTHON") or str(ROOT / ".venv" / SCRIPTS)
    if output(engine, "import torch") is None:
        return usage(f"{engine} can't be the engine, it does not import torch; run scripts/run.py setup, or name another by --engine")
    chosen = [VERSIONS[name] for name in args.versions or VERSIONS]
    pythons = {v.name: find_python(v.python, getattr(args, f"python{v.python.replace('.', '')}")) for v in chosen}
    results = []
    for version in chosen:
        try:
            python = environment(version, pythons[version.name], args.cache.absolute())
        except subprocess.CalledProcessError:
            results.append(Result(version, "not installed"))
            continue
        results.append(run_tests(version, python, engine, theirs, args.timeout))
    print(table(results))
    return 0 if all(result.end == "passed" for result in results) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
