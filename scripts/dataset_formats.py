# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a rendered scene in the layout of another dataset, with its axes, file names and special cases."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from formats import WRITERS
from formats.source import load_source
from irgspp.core.errors import InputError, IrgsppError


def main(argv: list[str] | None = None) -> int:
    """Write the dataset and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path, help="folder that scripts/render_dataset.py wrote")
    parser.add_argument("--format", required=True, choices=sorted(WRITERS))
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write, must not exist or be empty")
    args = parser.parse_args(argv)
    try:
        if args.output.exists() and any(args.output.iterdir()):
            raise InputError(args.output, "is not empty", "name a new folder")
        print(WRITERS[args.format](load_source(args.scene), args.output)[0])
    except IrgsppError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
