# SPDX-License-Identifier: GPL-3.0-or-later
"""Command line of the package: `python -m irgspp`."""

import sys

from .core.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
