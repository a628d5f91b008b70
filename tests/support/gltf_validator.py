# SPDX-License-Identifier: GPL-3.0-or-later
"""Khronos' validator of glTF files, the package gltf-validator of Node; tests skip where it is not installed."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = """
const validator = require("gltf-validator"), fs = require("fs");
if (process.argv[1])
  validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then((report) => console.log(JSON.stringify(report.issues)));
"""
ERROR, WARNING = 0, 1  # severities


def gltf_problems(path: Path) -> list[str]:
    """Return the errors and warnings of the validator about a .glb; skip the test where Node or the package is missing."""
    node = shutil.which("node")
    if node is None or subprocess.run([node, "-e", SCRIPT], capture_output=True, check=False).returncode:
        pytest.skip("no Node with gltf-validator here (npm install gltf-validator, and NODE_PATH=.../node_modules)")
    done = subprocess.run([node, "-e", SCRIPT, str(path)], capture_output=True, text=True, check=True)
    messages = json.loads(done.stdout)["messages"]
    return [f"{one['code']}: {one['message']} {one.get('pointer', '')}" for one in messages if one["severity"] <= WARNING]
