# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the pictures of the presets that the panel Reconstruct shows, from runs of the embedded demo.

    .venv/bin/python -m irgspp reconstruct core/demo_data -o runs/draft --preset draft           # and so on
    .venv/bin/python scripts/preset_pictures.py runs/draft runs/balanced

Each run's object is rendered from the same place under the demo's studio light. The preset is read from run.json.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
VIEW = 6  # of eight around the object: the face, above the metal ring
RENDERED = 640  # pixels of the rendered view
SIZE = 160  # pixels of a picture
BOX = (0.13, 0.16, 0.74)  # left, top and side of the part that the object fills, as fractions of the view


def main() -> int:
    """Draw a picture of each run; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="finished runs of core/demo_data, of different presets")
    parser.add_argument("-o", dest="output", type=Path, default=ROOT / "irgspp_addon" / "pictures", help="folder for the pictures")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    for run in args.runs:
        preset = json.loads((run / "run.json").read_text("utf-8"))["settings"]["preset"]
        cut(rendered(run)).save(args.output / f"{preset}.png", optimize=True)
        print(args.output / f"{preset}.png")
    return 0


def rendered(run: Path) -> Image.Image:
    """Return the view of a run under the studio light, RGBA.

    Args:
        run: folder of a finished run.
    """
    with tempfile.TemporaryDirectory() as folder:
        words = ["render", str(run), "-o", folder, "--orbit", "8", "--frames", str(VIEW), "--resolution", str(RENDERED), "--layers", "rgba"]
        light = ROOT / "core" / "demo_data" / "envs" / "studio.exr"
        subprocess.run([sys.executable, "-P", "-m", "irgspp", *words, "--environment", str(light)], check=True)
        (file,) = Path(folder).rglob("rgba_*.png")
        with Image.open(file) as image:
            return image.convert("RGBA")


def cut(view: Image.Image) -> Image.Image:
    """Return the part of a view that the object fills, reduced to the size of a picture."""
    left, top, side = (fraction * RENDERED for fraction in BOX)
    return view.resize((SIZE, SIZE), Image.Resampling.LANCZOS, box=(left, top, left + side, top + side))


if __name__ == "__main__":
    sys.exit(main())
