# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure how a finished run's object comes back from the formats of other programs, against its .blend, in fresh Blenders.

    .venv/bin/python scripts/reimport.py run/                    # in the Blender that exports, too
    .venv/bin/python scripts/reimport.py run/ 4.5 5.0 5.2        # in these versions, in the environments of test_blender_versions.py

`irgspp export` writes each file once. Each is read in a Blender of its own, and rendered by Cycles under the recovered light from the same
views as the .blend. The check sets Non-Color where OBJ names no colour space; all else stays as it was read, and the second column shows
what is left with the .blend's microfacet distribution. Of the splats (.ply), which Blender reads as points, the values are compared.
Exit status: 0 all formats come back, 1 one does not, 2 bad usage.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from irgspp.core.assets.export import export
from irgspp.core.errors import IrgsppError
from irgspp.core.machine.blender_process import LAUNCHER, blender_command
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.mesh_ply import load_mesh_ply
from reimporting.comparison import Asset, Difference, compare, load_asset, wrong_columns
from test_blender_versions import ROOT, VERSIONS, environment, find_python

CHILD = Path(__file__).resolve().parent / "reimporting" / "read_child.py"
FORMATS = ("glb", "usdc", "usdz", "obj", "fbx")
SIDES = ((0.6, -0.7, 0.4), (-0.7, 0.6, -0.2), (0.2, 0.3, 0.9))  # from which the object is rendered
AWAY, FILLED = 4.0, 0.95  # distance of the cameras in radii of the object, and fraction of the image that its bounding sphere fills
LEAST_LOOK, MOST_DISTANCE = 45.0, 1e-4  # dB; of the object's size
MOST_UV, MOST_NORMAL, MOST_TEXEL = 1e-4, 2.0, 1  # degrees, as Blender stores 16 bits; steps of 8 bits


def views(run: Path, size: int) -> list[dict]:
    """Return cameras around a run's object, relative to its foot, as read_child.py takes them.

    Args:
        run: finished run.
        size: pixels along a side.
    """
    low, high = (bound(load_mesh_ply(run / "mesh.ply").vertices, 0).astype(np.float64) for bound in (np.min, np.max))
    middle, radius = np.array([0.0, 0.0, (high - low)[2] / 2]), float(np.linalg.norm(high - low)) / 2
    focal = FILLED * size / 2 * np.sqrt(AWAY**2 - 1)
    poses = [look_at(middle + AWAY * radius * np.array(side) / np.linalg.norm(side), middle) for side in SIDES]
    cameras = [Camera(size, size, focal, focal, size / 2, size / 2, pose) for pose in poses]
    return [{**vars(camera), "to_world": camera.to_world.tolist()} for camera in cameras]


def read_in_blender(command: Sequence[str], job: dict, out: Path, last: str) -> None:
    """Read a file in a fresh Blender, which writes what came back.

    Args:
        command: what runs read_child.py in a Blender.
        job: of read_child.py, without "out".
        out: folder for the results.
        last: name of the file that is written last.

    Raises:
        IrgsppError: if Blender fails.
    """
    shutil.rmtree(out, ignore_errors=True)  # of an earlier check
    out.mkdir(parents=True)
    (out / "job.json").write_text(json.dumps({**job, "out": str(out)}), "utf-8")
    done = subprocess.run([*command, str(out / "job.json")], capture_output=True, text=True, check=False)
    if not (out / last).is_file():  # the module can crash at its end, after its work
        lines = done.stderr.strip().splitlines() or ["no message"]
        reason = next((line.strip() for line in reversed(lines) if "Error" in line), lines[-1])
        raise IrgsppError(f"{Path(job['file']).name}: not read, Blender ended with status {done.returncode}: {reason}")


def read_back(command: Sequence[str], job: dict, out: Path) -> Asset:
    """Read an asset in a fresh Blender and return what came back.

    Args:
        command: what runs read_child.py in a Blender.
        job: of read_child.py, without "out".
        out: folder for the results.

    Raises:
        IrgsppError: if Blender fails.
    """
    read_in_blender(command, job, out, f"view{len(job['views']) - 1}.exr")
    return load_asset(out)


def check_splats(file: Path, command: Sequence[str], out: Path) -> bool:
    """Print a line for splats that are read by one Blender, and return True where all of their values come back.

    Args:
        file: the exported .ply.
        command: what runs read_child.py in this Blender.
        out: folder for the results.
    """
    try:
        read_in_blender(command, {"file": str(file)}, out, "splats.npz")
    except IrgsppError as error:
        print(f"ply    FAILED: {error}", flush=True)
        return False
    wrong, columns = wrong_columns(file, out / "splats.npz")
    print(f"ply    {f'FAILED: {len(wrong)} differ, such as {wrong[0]}' if wrong else 'equal'}, {columns} columns of splats", flush=True)
    return not wrong


def failures(difference: Difference) -> list[str]:
    """Return which of the differences are too large, by the names of the table's columns."""
    return [
        name
        for name, failed in (
            ("look", difference.look < LEAST_LOOK),
            ("vertices", difference.distance > MOST_DISTANCE),
            ("faces", difference.faces != 0),
            ("UVs", not difference.uv <= MOST_UV),  # NaN where there are none
            ("normals", difference.normal > MOST_NORMAL),
            ("texels", difference.texel > MOST_TEXEL),
        )
        if failed
    ]


def row(name: str, difference: Difference) -> str:
    """Return a line of the table for a file."""
    d = difference
    cells = f"{name:6}{d.look:9.1f}{d.single:9.1f}{d.distance:11.1e}{d.faces:+7d}{d.uv:10.1e}{d.normal:9.2f}{d.texel:8d}"
    return f"{cells}  {'; '.join([*(f'FAILED: {word}' for word in failures(d)), *d.material]) or '-'}"


HEAD = f"{'format':6}{'look dB':>9}{'GGX dB':>9}{'vertices':>11}{'faces':>7}{'UVs':>10}{'normals':>9}{'texels':>8}  material"


def check(run: Path, files: Path, command: Sequence[str], args: argparse.Namespace, out: Path) -> bool:
    """Print a line for each format that is read by one Blender, and return True where all come back.

    Args:
        run: finished run.
        files: folder of the exported files.
        command: what runs read_child.py in this Blender.
        args: size and samples of the images.
        out: folder for the results.

    Raises:
        IrgsppError: if Blender can't read the .blend.
    """
    job = {"light": str((run / "environment.exr").resolve()), "views": views(run, args.size), "samples": args.samples}
    blend = read_back(command, {**job, "file": str(files / "asset.blend")}, out / "blend")
    print(f"Blender {blend.blender}, against its .blend\n{HEAD}", flush=True)
    good = True
    for suffix in FORMATS:
        try:
            difference = compare(read_back(command, {**job, "file": str(files / f"asset.{suffix}")}, out / suffix), blend)
        except IrgsppError as error:
            print(f"{suffix:6} FAILED: {error}", flush=True)
            good = False
            continue
        print(row(suffix, difference), flush=True)
        good &= not failures(difference)
    return check_splats(files / "asset.ply", command, out / "ply") and good


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; `words` is that of the process where None."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of a finished run")
    parser.add_argument("versions", nargs="*", metavar="VERSION", help=f"of {', '.join(VERSIONS)} (default: the Blender that exports)")
    parser.add_argument("--cache", type=Path, default=ROOT / ".blender_versions", help="folder of the versions' environments")
    parser.add_argument("--python311", help="Python 3.11 to make environments with (default: this one, or python3.11)")
    parser.add_argument("--python313", help="Python 3.13 to make environments with (default: this one, or python3.13)")
    parser.add_argument("--size", type=int, default=128, help="pixels along a side (default: 128)")
    parser.add_argument("--samples", type=int, default=256, help="per pixel (default: 256); with fewer, noise counts as a difference")
    parser.add_argument("-o", "--output", type=Path, help="folder that keeps the files and images")
    args = parser.parse_args(words)
    unknown = set(args.versions) - set(VERSIONS)
    if unknown:
        parser.error(f"no version {', '.join(sorted(unknown))}; there are {', '.join(VERSIONS)}")
    return args


def blenders(args: argparse.Namespace) -> list[list[str]]:
    """Return what runs read_child.py in each chosen Blender."""
    if not args.versions:
        return [[str(CHILD) if word == str(LAUNCHER) else word for word in blender_command()]]
    chosen = [VERSIONS[name] for name in args.versions]
    pythons = [find_python(version.python, getattr(args, f"python{version.python.replace('.', '')}")) for version in chosen]
    made = [environment(version, python, args.cache.absolute()) for version, python in zip(chosen, pythons, strict=True)]
    return [[str(python), str(CHILD)] for python in made]


def main(words: Sequence[str] | None = None) -> int:
    """Export a run, read its files back, print the tables and return the exit status."""
    args = arguments(words)
    with tempfile.TemporaryDirectory(prefix="irgspp-reimport-") as scratch:
        files = (args.output or Path(scratch)).resolve()
        try:
            files.mkdir(parents=True, exist_ok=True)
            for suffix in ("blend", *FORMATS, "ply"):
                export(args.run, files / f"asset.{suffix}")
            read = [check(args.run, files, command, args, files / f"read{number}") for number, command in enumerate(blenders(args))]
        except IrgsppError as error:
            print(f"reimport: {error}", file=sys.stderr)
            return error.exit_status
    return 0 if all(read) else 1


if __name__ == "__main__":
    sys.exit(main())
