# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that one process replaces while another reads them."""

import os
import time
from pathlib import Path


def replace(partial: Path, path: Path) -> None:
    """Put a file in the place of another. Windows refuses while somebody reads the old one, so it is tried again for a while."""
    for _ in range(100):
        try:
            return os.replace(partial, path)
        except PermissionError:
            time.sleep(0.002)
    os.replace(partial, path)
