# SPDX-License-Identifier: GPL-3.0-or-later
"""Shade a scene of known geometry, material and light by tracing Gaussians, and by Cycles; print how far they are apart."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.shading.procedural_lights import LIGHTS
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from cycles_comparison.known_scene import CyclesScene, Surface, camera, first_hits, inner_pixels, lift, splats
from cycles_comparison.traced_scene import INNER, TracedScene, traced_image


@dataclass(frozen=True)
class Case:
    """The materials, and whether our diffuse lobe gives up what the specular one reflects (`reflect_light`), as Blender's does."""

    sphere: Surface
    square: Surface
    conserving: bool = False


GOLD, STEEL = Surface((0.9, 0.6, 0.3), 0.4, 1.0), Surface((0.7, 0.7, 0.75), 0.5, 1.0)
RED, BLUE = Surface((0.8, 0.3, 0.2), 0.4), Surface((0.5, 0.6, 0.7), 0.5)
CASES = {
    "diffuse": Case(replace(RED, diffuse=True), replace(BLUE, diffuse=True)),
    "metal": Case(GOLD, STEEL),
    "metal on diffuse": Case(GOLD, replace(BLUE, diffuse=True)),
    "dielectric": Case(RED, BLUE),
    "dielectric, 1-E_s": Case(RED, BLUE, conserving=True),
    "metal, multiscatter": Case(replace(GOLD, multiscatter=True), replace(STEEL, multiscatter=True)),
}
MARGIN = 1  # pixels left out along edges


@dataclass(frozen=True)
class Difference:
    """Ours against Cycles over the inner pixels: mean of |a - b| / b per pixel, and the signed difference of the means."""

    case: str
    bounces: int
    relative: float
    signed: float
    strip: np.ndarray  # (H, 3 W, 3) encoded: ours, Cycles, 10 x the difference

    def row(self) -> str:
        """A line of the table."""
        lit = "one bounce" if self.bounces else "direct"
        return f"{self.case:20} {lit:12} {100 * self.relative:12.2f} % {100 * self.signed:+11.2f} %"


def compare(name: str, cycles: CyclesScene, light: np.ndarray, args: argparse.Namespace) -> Iterator[Difference]:
    """Direct light, then one bounce."""
    case, view = CASES[name], camera(args.size)
    inner = inner_pixels(first_hits(view), MARGIN)
    gaussians = splats(args.splats, case.sphere, case.square)
    shine = torch.where(gaussians.position[2] == 0, float(not case.square.diffuse), float(not case.sphere.diffuse))
    scene = TracedScene(gaussians, shine, light, lift(args.splats), case.conserving)
    scene.prepare(max(32, args.samples // INNER))
    for bounces in (0, 1):
        truth = cycles.render(view, case.sphere, case.square, bounces, args.cycles_samples)[..., :3] * inner[..., None]
        ours = traced_image(scene, view, inner, args.samples, bounces)
        a, b = ours[inner].astype(np.float64), truth[inner].astype(np.float64)
        relative = float((np.abs(a - b).mean(-1) / b.mean(-1)).mean())
        strip = np.concatenate([encode_srgb(np.clip(p, 0, 1)) for p in (ours, truth, 10 * np.abs(ours - truth))], 1)
        yield Difference(name, bounces, relative, float(a.mean() / b.mean() - 1), strip)


def arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", help="some of: " + ", ".join(CASES) + "; default: all")
    parser.add_argument("-o", "--output", type=Path, help="folder for images: ours, Cycles, 10 x the difference")
    parser.add_argument("--size", type=int, default=48, help="pixels across")
    parser.add_argument("--samples", type=int, default=512, help="ours, per pixel")
    parser.add_argument("--cycles-samples", type=int, default=2048)
    parser.add_argument("--splats", type=int, default=30_000)
    parser.add_argument("--light", choices=LIGHTS, default="studio")
    args = parser.parse_args(argv)
    unknown = set(args.cases) - set(CASES)
    if unknown:
        parser.error(f"no case {', '.join(sorted(unknown))}")
    return args


def main(argv: list[str] | None = None) -> int:
    args = arguments(argv)
    light = LIGHTS[args.light](64, 128)
    cycles = CyclesScene(light)
    if args.output is not None:
        args.output.mkdir(parents=True, exist_ok=True)
    print(f"{'case':20} {'light':12} {'mean relative':>14} {'of the means':>13}")
    for name in args.cases or CASES:
        for difference in compare(name, cycles, light, args):
            print(difference.row(), flush=True)
            if args.output is not None:
                path = args.output / f"{re.sub('[^a-z0-9]+', '_', name.lower())}_{difference.bounces}.png"
                Image.fromarray(np.round(255 * difference.strip).astype(np.uint8)).save(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
