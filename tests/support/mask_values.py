# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's reading of a mask file, printed as JSON, top row first: `python mask_values.py FILE`."""

import json
import sys
from pathlib import Path

from irgspp.core.io.image import read_mask

print(json.dumps(read_mask(Path(sys.argv[1])).tolist()))
