# SPDX-License-Identifier: GPL-3.0-or-later
"""Write requirements.sha256: the digests of every wheel that the managed engine may be installed from, in the format of sha256sum.

    .venv/bin/python scripts/lock_hashes.py INDEX [--also FOLDER]      # after requirements.lock has changed

INDEX is the address of a package index ("simple" pages). Digests of wheels in FOLDER are added.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
import urllib.parse
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path

from irgspp.irgspp_addon.engine.install import plain, requirements

ROOT = Path(__file__).resolve().parent.parent
HASHES = ROOT / "requirements.sha256"
LINK = re.compile(r'href="[^"#]*/([^"/#]+\.whl)#sha256=([0-9a-f]{64})"')
PYTHON = re.compile(r"(py3|py2\.py3|cp3[0-9]+)")
PLATFORM = re.compile(r"any|win_amd64|macosx.*|manylinux.*(x86_64|aarch64)|linux_x86_64")


def main(arguments: Sequence[str] | None = None) -> int:
    """Ask the index for the wheels of every pin, write their digests, and return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("index")
    parser.add_argument("--also", type=Path, metavar="FOLDER")
    options = parser.parse_args(arguments)
    found: dict[str, str] = {}
    for name, version in sorted({*resolved(options.index), *pins()}):
        files = dict(wheels(options.index, name, version))
        if not files:
            print(f"lock_hashes: {name}=={version}: the index has no wheel", file=sys.stderr)
            return 1
        found |= files
        print(f"{name} {version}: {len(files)}", file=sys.stderr)
    for file in sorted(options.also.glob("*.whl")) if options.also else []:
        found[file.name] = hashlib.sha256(file.read_bytes()).hexdigest()
    HASHES.write_text("".join(f"{found[name]}  {name}\n" for name in sorted(found)), encoding="utf-8")
    return 0


def locked() -> list[str]:
    """Return the pins of the lock file without Blender's module, which engines inside Blender don't need."""
    return requirements((ROOT / "requirements.lock").read_text("utf-8"), [])[1]


def pins() -> Iterator[tuple[str, str]]:
    """Yield (name, version) of all that an engine may need: the lock's pins, and the extra for CUDA."""
    for line in locked():
        name, version = line.partition(";")[0].split("==")
        yield plain(name), version.strip()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    for requirement in project["optional-dependencies"]["cuda"]:
        name, version = requirement.split("==")
        yield plain(name), version


def resolved(index: str) -> Iterator[tuple[str, str]]:
    """Yield (name, version) of what pip would install on this system: on Linux, torch needs CUDA libraries that the lock does not name."""
    with tempfile.TemporaryDirectory() as name:
        lines, report = Path(name, "lines"), Path(name, "report")
        lines.write_text("\n".join(locked()), encoding="utf-8")
        words = ["--dry-run", "--ignore-installed", "--only-binary", ":all:", "--quiet", "--index-url", index]
        command = [sys.executable, "-m", "pip", "--isolated", "install", *words, "--report", str(report), "-r", str(lines)]
        subprocess.run(command, check=True, env={k: v for k, v in os.environ.items() if not k.startswith("PIP_FIND")})
        for item in json.loads(report.read_text("utf-8"))["install"]:
            yield plain(item["metadata"]["name"]), item["download_info"]["url"].rpartition("/")[2].split("-")[1]


def wheels(index: str, name: str, version: str) -> Iterator[tuple[str, str]]:
    """Yield (file name, digest) of the wheels of a version for the Pythons and systems that Blender runs on.

    Args:
        index: address of the package index.
        name: name of the package.
        version: version of the package.
    """
    address = f"{index.rstrip('/')}/{plain(name)}/"
    with urllib.request.urlopen(urllib.request.Request(address, headers={"Accept": "text/html"}), timeout=60) as page:
        text = page.read().decode()
    for file, digest in LINK.findall(text):
        file = urllib.parse.unquote(file)
        parts = file.removesuffix(".whl").split("-")
        python, abi, platform = parts[-3:]
        if parts[1] == version and _serves(python, abi) and any(PLATFORM.fullmatch(p) for p in platform.split(".")):
            yield file, digest


def _serves(python: str, abi: str) -> bool:
    """Return True for a wheel that Python 3.11 to 3.13 can load."""
    if abi.endswith("t") or not PYTHON.match(python):
        return False
    return abi in ("none", "abi3") or python in ("cp311", "cp312", "cp313")


if __name__ == "__main__":
    sys.exit(main())
