# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenUSD's validators, of the package usd-core: `python usd_validator.py FILE` prints what they find as JSON; tests skip without it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest


def usd_problems(path: Path) -> list[str]:
    """Return what all validators find in a USD file; skip the test where usd-core is missing.

    In a process of its own, as Blender's process holds another copy of USD.
    """
    done = subprocess.run([sys.executable, __file__, str(path)], capture_output=True, text=True, check=False)
    if "No module named 'pxr'" in done.stderr:
        pytest.skip("no usd-core here (pip install usd-core)")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def main(path: str) -> None:
    from pxr import Usd, UsdValidation

    stage = Usd.Stage.Open(path)
    found = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators()).Validate(stage)
    print(json.dumps([f"{one.GetName()}: {one.GetMessage()}" for one in found]))


if __name__ == "__main__":
    main(sys.argv[1])
