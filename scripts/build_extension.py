# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension as a zip that Blender installs, and validate it, with the tool that comes with Blender's Python module.

`--repository` also writes the listing of a static repository: the folder can then be put on any web server (or used by a file:// address),
and the address of its index.json is entered in Blender under Preferences > Get Extensions > Repositories > Add Remote Repository.
"""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Everything that the zip may hold at its top level; the managed engine is installed from the second line's files.
CONTENT = {"blender_manifest.toml", "__init__.py", "__main__.py", "LICENSE", "core", "irgspp_addon", "operators", "panels"}
CONTENT |= {"requirements.lock", "requirements.sha256", "pyproject.toml"}
LARGEST = 2_000_000  # bytes; the zip holds nothing compiled or trained


def blender_tool() -> tuple[Path, Path]:
    """Return Blender's extension tool and its list of known tags, from the installed bpy package of any version."""
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
    """Validate the sources, write the zip into a folder, and check and validate the zip.

    Args:
        output: folder for the zip.

    Returns:
        The path of the zip.

    Raises:
        SystemExit: where a check fails.
    """
    tool, tags = blender_tool()
    output.mkdir(parents=True, exist_ok=True)
    before = {path: path.stat().st_mtime_ns for path in output.glob("*.zip")}
    run(tool, "validate", f"--valid-tags={tags}", str(ROOT))
    run(tool, "build", "--source-dir", str(ROOT), "--output-dir", str(output), f"--valid-tags={tags}")
    (archive,) = [path for path in output.glob("*.zip") if before.get(path) != path.stat().st_mtime_ns]
    fault = content_fault(archive)
    if fault:
        archive.unlink()
        raise SystemExit(f"build_extension: {fault}")
    run(tool, "validate", f"--valid-tags={tags}", str(archive))
    return archive


def content_fault(archive: Path) -> str | None:
    """Return what a zip holds too much or lacks, in words; None where it is right."""
    found = {name.split("/")[0] for name in zipfile.ZipFile(archive).namelist()}
    if found - CONTENT:
        return f"{', '.join(sorted(found - CONTENT))} in {ROOT} would get into the zip; remove it, or exclude it in blender_manifest.toml"
    if CONTENT - found:
        return f"the zip lacks {', '.join(sorted(CONTENT - found))}"
    if archive.stat().st_size > LARGEST:
        return f"the zip has {archive.stat().st_size} bytes, more than {LARGEST}"
    return None


def index(folder: Path) -> Path:
    """Write index.json for Blender and index.html for people, of all zips in a folder; return the former."""
    run(blender_tool()[0], "server-generate", "--repo-dir", str(folder), "--html")
    return folder / "index.json"


def run(tool: Path, *arguments: str) -> None:
    """Run a command of the tool, and show its output where it fails.

    Args:
        tool: path of the tool.
        *arguments: command and its options.
    """
    done = subprocess.run([sys.executable, str(tool), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"build_extension: {arguments[0]} failed: {(done.stdout + done.stderr).strip()}")


def main() -> int:
    """Build the extension and print the path of the zip."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist", help="folder for the zip (default: dist)")
    parser.add_argument("--repository", action="store_true", help="also write index.json and index.html of a static repository")
    args = parser.parse_args()
    print(build(args.output))
    if args.repository:
        print(index(args.output))
    return 0


if __name__ == "__main__":
    sys.exit(main())
