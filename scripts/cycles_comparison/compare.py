# SPDX-License-Identifier: GPL-3.0-or-later
"""Compare radiance traced through Gaussians with Cycles' on a scene of known geometry, material and light.

.venv/bin/python scripts/cycles_comparison/compare.py [CASES...] [-o DIR]
"""

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
    """Materials of the two objects.

    Attributes:
        sphere: material of the sphere.
        square: material of the square.
        conserving: True where our diffuse lobe gets what the specular one leaves (`reflect_light`), as Blender's does.
    """

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
MARGIN = 1  # pixels along edges that are not compared


@dataclass(frozen=True)
class Difference:
    """Difference of ours and Cycles over the inner pixels.

    Attributes:
        case: name of the case.
        bounces: bounces of indirect light.
        relative: mean over the pixels of |a - b| / b.
        signed: relative difference of the means.
        strip: (H, 3 W, 3) encoded: ours, Cycles, 10 x the difference.
    """

    case: str
    bounces: int
    relative: float
    signed: float
    strip: np.ndarray

    def row(self) -> str:
        """Return a line of the table."""
        lit = "one bounce" if self.bounces else "direct"
        return f"{self.case:20} {lit:12} {100 * self.relative:12.2f} % {100 * self.signed:+11.2f} %"


def compare(name: str, cycles: CyclesScene, light: np.ndarray, args: argparse.Namespace) -> Iterator[Difference]:
    """Yield the differences with direct light, and with one bounce.

    Args:
        name: name of the case.
        cycles: scene in Blender.
        light: linear lat-long map (H, W, 3).
        args: parsed options.
    """
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
    """Parse the command line; `argv` is that of the process where None."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", help="of " + ", ".join(CASES) + " (default: all)")
    parser.add_argument("-o", "--output", type=Path, help="folder for images: ours, Cycles, 10 x the difference")
    parser.add_argument("--size", type=int, default=48, help="pixels along a side (default: 48)")
    parser.add_argument("--samples", type=int, default=512, help="our samples per pixel (default: 512)")
    parser.add_argument("--cycles-samples", type=int, default=2048)
    parser.add_argument("--splats", type=int, default=30_000)
    parser.add_argument("--light", choices=LIGHTS, default="studio")
    args = parser.parse_args(argv)
    unknown = set(args.cases) - set(CASES)
    if unknown:
        parser.error(f"no case {', '.join(sorted(unknown))}")
    return args


def main(argv: list[str] | None = None) -> int:
    """Print the differences of the chosen cases and return the exit status."""
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
