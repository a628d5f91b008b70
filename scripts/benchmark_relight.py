# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighting's time against its error, on finished runs: samples, denoisers, sampling, backends, frame rates, and Cycles beside it.

python scripts/benchmark_relight.py RUN --environment a.exr --environment b.exr -o report/ [--view NAME ...] [--cycles]

Errors are PSNR in dB against the converged picture of the same renderer (4096 samples, not denoised), sRGB-encoded, on black. Times are
medians of repeats of one frame; compare them within one report, machines are noisy.
"""

# pyright: reportMissingImports=false
# (`irgspp` is the folder above, known to pyright under no name)

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from irgspp.core.datasets.camera import Camera
from irgspp.core.evaluation import pictures
from irgspp.core.evaluation.cycles import CyclesPass, cycles_pictures
from irgspp.core.evaluation.metrics import on_black, psnr
from irgspp.core.progress import Silent
from irgspp.core.relight.backends import open_relighter
from irgspp.core.relight.lighting import PreparedLight, prepare
from irgspp.core.relight.relighter import Relighter, RelightSettings
from irgspp.core.rendering import load_light
from irgspp.core.scene.cameras import load_cameras
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.shading.lightmap import rotate
from PIL import Image

CONVERGED = 4096
COUNTS = (8, 16, 32, 64, 128, 256, 512)
GOAL = 38.0  # dB at which Cycles and we are timed
CYCLES_COUNTS = (1, 2, 4, 8, 16, 32, 64)
REPEATS = 7
WAYS = {
    "denoised": {},
    "paper's filter": {"denoise": "paper"},
    "noisy": {"denoise": "off"},
    "stratified": {"denoise": "off", "sampling": "stratified"},
}


class Bench:
    """A run, a view of it and lights; relighters share what is costly to open."""

    def __init__(self, run: Path, camera: Camera, lights: dict[str, np.ndarray]) -> None:
        self.run, self.camera, self.maps = run, camera, lights
        self.lights = {name: prepare(light) for name, light in lights.items()}
        self.reconstruction = Reconstruction.load(run)
        self._open = {backend: open_relighter(run, self.reconstruction, backend, RelightSettings()) for backend in ("mesh", "gaussian")}

    def relighter(self, samples: str | int, backend: str = "mesh", **settings: Any) -> Relighter:
        """With settings of its own and nothing remembered."""
        one = self._open[backend]
        return Relighter(self.reconstruction, one.query, replace(one.settings, samples=samples, **settings), one.mesh)

    def picture(self, light: PreparedLight, samples: str | int, **settings: Any) -> np.ndarray:
        one = self.relighter(samples, **settings)
        return on_black(one.relit(one.surface(self.camera), light).numpy())


def seconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median time of `work` after one run that doesn't count."""
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def convergence(bench: Bench) -> dict[str, Any]:
    """Error by samples, for each light and way of making pictures, and 16 samples with MIS beside 1024 without."""
    result: dict[str, Any] = {}
    for name, light in bench.lights.items():
        true = bench.picture(light, CONVERGED, denoise="off")
        rows = {way: [psnr(bench.picture(light, n, **how), true) for n in COUNTS] for way, how in WAYS.items()}
        few = psnr(bench.picture(light, 16, denoise="off"), true)
        many = psnr(bench.picture(light, 1024, denoise="off", sampling="stratified"), true)
        result[name] = {"samples": COUNTS, **rows, "16 MIS": few, "1024 stratified": many}
        print(f"\n{name:15s} " + "".join(f"{n:8d}" for n in COUNTS))
        for way, row in rows.items():
            print(f"{way:15s} " + "".join(f"{value:8.2f}" for value in row))
        print(f"16 samples with MIS {few:.2f} dB, 1024 stratified {many:.2f} dB: {few - many:+.2f} dB")
    return result


def speeds(bench: Bench) -> dict[str, Any]:
    """Seconds of a frame: by mesh and by Gaussians, new and under another light; how much of it is Embree."""
    lights = list(bench.lights.values())
    result: dict[str, Any] = {}
    for backend in ("mesh", "gaussian"):
        one = bench.relighter("efficient", backend)
        result[backend] = seconds(lambda one=one: one.relit(one.surface(bench.camera), lights[0]))
        surface, turn = one.surface(bench.camera), itertools.cycle(lights)
        result[f"{backend}, another light"] = seconds(lambda one=one, s=surface, t=turn: one.relit(s, next(t)))
    result["gaussian / mesh"] = result["gaussian"] / result["mesh"]
    result |= embree_share(bench, lights[0], result["mesh"])
    for name, value in result.items():
        print(f"{name:32s} {value:.4f}")
    print(f"{'frames per second, mesh':32s} {1 / result['mesh']:.1f}")
    return result


def embree_share(bench: Bench, light: PreparedLight, frame: float) -> dict[str, float]:
    """The rays of a frame again: through the query, and through bare Embree in as many threads."""
    one, asked = bench.relighter("efficient"), []
    recorder = _Recorder(one.query, asked)
    watched = Relighter(one.reconstruction, recorder, one.settings, one.mesh)
    watched.relit(watched.surface(bench.camera), light)
    query = seconds(lambda: [one.query.hits(*rays) for rays in asked])
    bare = seconds(lambda: [one.query.closest(*rays) for rays in asked])
    rays = sum(len(origin) for origin, _ in asked)
    return {"rays a frame": rays, "share of Embree": bare / frame, "ray rate, query / bare": bare / query, "bare Mray/s": rays / bare / 1e6}


class _Recorder:
    """A query that notes what it is asked."""

    def __init__(self, query, asked: list[tuple[torch.Tensor, torch.Tensor]]) -> None:
        self._query, self._asked, self.origins = query, asked, query.origins

    def hits(self, origin: torch.Tensor, direction: torch.Tensor):
        self._asked.append((origin, direction))
        return self._query.hits(origin, direction)


def against_cycles(bench: Bench, out: Path) -> dict[str, Any]:
    """Seconds a frame to GOAL dB, each against its own converged picture; and how far these two are apart."""
    passes = [CyclesPass(n, denoise) for n in CYCLES_COUNTS for denoise in (True, False)] + [CyclesPass(CONVERGED // 4, False)]
    rendered = cycles_pictures(bench.run, {"view": bench.camera}, bench.maps, passes, Silent())
    result: dict[str, Any] = {}
    for name, light in bench.lights.items():
        theirs = rendered["view", name]
        true = on_black(theirs[-1].rgba)
        cycles = [(one, psnr(on_black(p.rgba), true), p.seconds) for one, p in zip(passes[:-1], theirs[:-1], strict=True)]
        fresh, turned = ours_to_goal(bench, light, bench.maps[name])
        best = min((row for row in cycles if row[1] >= GOAL), key=lambda row: row[2], default=None)
        ours = bench.picture(light, CONVERGED, denoise="off")
        difference = np.abs(ours - true)[true.sum(-1) > 0].mean()
        row = {"difference": float(difference), "psnr": psnr(ours, true), "ours": fresh, "ours, turned light": turned}
        row["cycles"] = (
            None if best is None else {"samples": best[0].samples, "denoise": best[0].denoise, "dB": best[1], "seconds": best[2]}
        )
        row["cycles, all"] = [(one.samples, one.denoise, db, s) for one, db, s in cycles]
        result[name] = row
        print(f"\n{name}: Cycles' converged picture and ours differ by {difference:.4f} on the object, PSNR {row['psnr']:.2f} dB")
        print(f"  to {GOAL} dB: Cycles {row['cycles']}\n            ours {fresh}\n            ours under another light {turned}")
        side = np.concatenate([ours, true, pictures.heat(np.abs(ours - true).max(-1), 0.2)[..., :3]], 1)
        Image.fromarray((255 * side.clip(0, 1)).round().astype(np.uint8)).save(out / f"cycles_{name}.png")
    return result


def ours_to_goal(bench: Bench, light: PreparedLight, picture: np.ndarray) -> tuple[dict[str, float] | None, dict[str, float] | None]:
    """The fewest samples that reach GOAL: seconds of a new frame, and of one whose light was turned."""
    true = bench.picture(light, CONVERGED, denoise="off")
    enough = ((n, psnr(bench.picture(light, n), true)) for n in COUNTS)
    samples, quality = next(((n, db) for n, db in enough if db >= GOAL), (0, 0.0))
    if not samples:
        return None, None
    one = bench.relighter(samples)
    surface, turned = one.surface(bench.camera), prepare(rotate(picture, 30.0).astype(np.float32))
    both = itertools.cycle((light, turned))
    fresh = seconds(lambda: one.relit(one.surface(bench.camera), light))
    again = seconds(lambda: one.relit(surface, next(both)))
    about = {"samples": samples, "dB": quality}
    return {**about, "seconds": fresh}, {**about, "seconds": again}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--environment", type=Path, action="append", required=True, metavar="FILE", help="a light (repeatable)")
    parser.add_argument("--view", help="name of the camera in the run (default: the first)")
    parser.add_argument("--cycles", action="store_true", help="render by Cycles too")
    parser.add_argument("--only", choices=("convergence", "speeds", "cycles"), help="one section")
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="DIR")
    args = parser.parse_args()
    cameras = {placed.name: placed.camera for placed in load_cameras(args.run / "cameras.json")}
    if args.view and args.view not in cameras:
        parser.error(f"--view {args.view}: the run has no such camera (there are {', '.join(list(cameras)[:5])}, ...)")
    lights = {path.stem: load_light(path).picture for path in args.environment}
    bench = Bench(args.run, cameras[args.view or next(iter(cameras))], lights)
    args.out.mkdir(parents=True, exist_ok=True)
    report = {}
    for name, section in (("convergence", convergence), ("speeds", speeds)):
        if args.only in (None, name):
            report[name] = section(bench)
    if args.only == "cycles" or (args.cycles and args.only is None):
        report["cycles"] = against_cycles(bench, args.out)
    (args.out / "relight.json").write_text(json.dumps(report, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
