# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m irgspp`: the command line."""

import sys

from .core.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
