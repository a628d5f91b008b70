# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension as a zip that Blender installs, and validate it, with the tool that comes with Blender's Python module."""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def blender_tool() -> tuple[Path, Path]:
    """Blender's extension tool, and the list of tags it knows, inside the installed bpy package (of any version)."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        raise SystemExit("build_extension: Blender's Python module is not installed; install the package bpy")
    folder = Path(spec.origin).parent
    tool = next(folder.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"), None)
    tags = next(folder.glob("*/scripts/modules/_bpy_internal/extensions/tags.py"), None)
    if tool is None or tags is None:
        raise SystemExit(f"build_extension: {folder} holds no extension tool")
    return tool, tags


def build(output: Path) -> Path:
    """Validate the sources, write the zip into the folder `output`, validate the zip; returns its path."""
    tool, tags = blender_tool()
    output.mkdir(parents=True, exist_ok=True)
    before = {path: path.stat().st_mtime_ns for path in output.glob("*.zip")}
    run(tool, "validate", f"--valid-tags={tags}", str(ROOT))
    run(tool, "build", "--source-dir", str(ROOT), "--output-dir", str(output), f"--valid-tags={tags}")
    (archive,) = [path for path in output.glob("*.zip") if before.get(path) != path.stat().st_mtime_ns]
    run(tool, "validate", f"--valid-tags={tags}", str(archive))
    return archive


def run(tool: Path, *arguments: str) -> None:
    """One command of the tool; what it says is shown where it fails."""
    done = subprocess.run([sys.executable, str(tool), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"build_extension: {arguments[0]} failed: {(done.stdout + done.stderr).strip()}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist", help="folder for the zip (default: dist)")
    print(build(parser.parse_args().output))
    return 0


if __name__ == "__main__":
    sys.exit(main())
