# SPDX-License-Identifier: GPL-3.0-or-later
"""Check of an NVIDIA GPU in one command and one table: `python scripts/gpu_check.py [--dataset DATASET]`.

`--device cpu --quick` runs all of it small, by the same kernels on warp's CPU device: that tests this script, and says nothing of GPUs.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import irgspp.core  # noqa: F401  (before torch: it sets how torch's threads wait)
import torch
from gpu import measurements
from gpu.measurements import QUICK, Measurement, Size
from gpu.scene import Work, make_work
from irgspp.core.errors import IrgsppError
from irgspp.core.machine.cuda import probe_cuda
from irgspp.core.machine.devices import WARP_ON_CPU, choose_device, computing_on
from irgspp.core.pipeline import DEMO_DATA

TINY = ("data.resolution=64", "first.gaussians=2000", "first.iterations=60", "first.trial_iterations=10",
        "first.trial_gaussians=500", "second.points=300", "second.rows=8", "second.views=4", "second.iterations=5",
        "second.pixels=32", "second.samples=16", "second.pool=2000", "second.radiance_iterations=5", "surface.voxels=48",
        "surface.triangles=2000", "surface.texture=128", "materials=low-gloss")  # fmt: skip

Part = tuple[str, Callable[[], Measurement | list[Measurement]]]


def main() -> int:
    """Measure the chosen parts and print the table; return 1 where a part failed, 2 where there is no such device."""
    args = _arguments()
    try:
        chosen = choose_device(WARP_ON_CPU if args.device == "cpu" else "cuda")
    except IrgsppError as error:
        print(f"gpu_check: {error}", file=sys.stderr)
        return 2
    size, device = QUICK if args.quick else Size(), chosen.device
    table = [Measurement("device", _name(device)), Measurement("driver, torch, warp", _versions())]
    with tempfile.TemporaryDirectory() as scratch, computing_on(chosen):
        parts = _parts(args, make_work(size.gaussians, size.image, size.triangles, device), size, device, Path(scratch))
        failed = _measure(parts, args.only, table)
    _print(table)
    if args.json is not None:
        args.json.write_text(json.dumps([asdict(measurement) for measurement in table], indent=1))
    return int(failed)


def _parts(args: argparse.Namespace, work: Work, size: Size, device: torch.device, scratch: Path) -> list[Part]:
    """Return the parts in order, by name."""
    dataset = args.dataset or (DEMO_DATA if args.quick else None)
    name, run = WARP_ON_CPU if args.device == "cpu" else "cuda", args.run or scratch / "run"
    omitted = Measurement("whole job", "not run: give --dataset", measurements.JOB_TARGETS[args.preset])
    return [
        ("correctness", lambda: measurements.correctness(device, args.quick)),
        ("iterations", lambda: measurements.steps(work, size, device)),
        ("relighting", lambda: measurements.relighting(work, size, device)),
        ("job", lambda: omitted if dataset is None else measurements.job(args.preset, dataset, run, name, TINY if args.quick else ())),
        ("memory of these", lambda: measurements.memory(device)),
        ("bandwidth", lambda: measurements.bandwidth(work, size, device)),
        ("profile", lambda: measurements.profile(work, size, device)),
    ]


def _measure(parts: list[Part], only: list[str], table: list[Measurement]) -> bool:
    """Append all measurements to the table, where a failed part has its error; return True where one failed."""
    failed = False
    for name, measure in parts:
        if only and not any(word in name for word in only):
            continue
        print(f"gpu_check: {name} ...", file=sys.stderr, flush=True)
        began = time.monotonic()
        try:
            found = measure()
        except Exception as error:  # a table with a failed part is better than none
            failed, found = True, Measurement(name, f"FAILED: {type(error).__name__}: {' '.join(str(error).split())[:200]}")
        table += found if isinstance(found, list) else [found]
        failed |= any("FAILED" in measurement.measured for measurement in table)
        print(f"gpu_check: {name} took {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    return failed


def _arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--device", choices=("cuda", "cpu"), default="cuda", help="cpu: the GPU's kernels on warp's CPU device")
    parser.add_argument("--quick", action="store_true", help="everything small")
    parser.add_argument("--dataset", type=Path, help="for the whole job, such as one that scripts/render_dataset.py made at 800x800")
    parser.add_argument("--preset", choices=list(measurements.JOB_TARGETS), default="balanced", help="preset of that job")
    parser.add_argument("--run", type=Path, help="folder to keep that job's run in (default: it is deleted)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the table as JSON")
    parser.add_argument("--only", action="append", default=[], metavar="WORD", help="only parts with this word in their name")
    return parser.parse_args()


def _name(device: torch.device) -> str:
    """Return the name of the device."""
    if device.type == "cuda":
        properties = torch.cuda.get_device_properties(device)
        return f"{properties.name}, {properties.total_memory / 2**30:.0f} GiB, compute capability {properties.major}.{properties.minor}"
    return f"warp's CPU device, {platform.machine()}: says nothing of GPUs"


def _versions() -> str:
    """Return the versions of driver, torch and warp."""
    import warp

    found = probe_cuda()
    driver = "none" if found.driver is None else "CUDA {}.{}".format(*found.driver)
    return f"{driver}; {torch.__version__} (CUDA {found.torch_cuda}); {warp.config.version}"


def _print(table: list[Measurement]) -> None:
    """Print the table."""
    rows = [Measurement("quantity", "measured", "target"), *table]
    wide = [max(len(getattr(row, name)) for row in rows) for name in ("name", "measured")]
    for row in rows:
        print(f"{row.name:{wide[0]}}  {row.measured:{wide[1]}}  {row.target}".rstrip())


if __name__ == "__main__":
    sys.exit(main())
