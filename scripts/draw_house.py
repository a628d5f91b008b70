# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the packages and the imports between them: `.venv/bin/python scripts/draw_house.py [-o docs/pictures/house.svg]`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from documents.house import draw, read_house

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "pictures" / "house.svg"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the drawing and print the number of packages and layers.

    Returns:
        The exit status: 1 where packages import each other in a circle.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", dest="out", type=Path, default=PICTURE, metavar="FILE.svg")
    out = parser.parse_args(arguments).out
    house = read_house()
    if house.circles:
        print("draw_house: packages import each other: " + "; ".join(" ".join(circle) for circle in house.circles), file=sys.stderr)
        return 1
    draw(house, out)
    inside = [room for room in house.rooms if room.startswith("core.")]
    floors = {house.floor(room) for room in inside}
    print(f"{out}: {len(house.rooms)} packages; core has {len(inside)} in {len(floors)} layers")
    return 0


if __name__ == "__main__":
    sys.exit(main())
