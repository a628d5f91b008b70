# SPDX-License-Identifier: GPL-3.0-or-later
"""No module of the extension, and no test of it, imports the engine's libraries into Blender's process."""

import subprocess
import sys

from blender_side import ROOT

REFUSE = """
import sys
HEAVY = {"torch", "numba", "llvmlite", "scipy", "cv2", "PIL", "embreex", "warp", "OpenEXR", "plyfile", "trimesh", "skimage", "xatlas",
         "fast_simplification", "sklearn", "pandas"}

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in HEAVY:
            raise ImportError(f"{name} must not enter Blender's process")

sys.meta_path.insert(0, Refuse())
"""
IMPORT_ALL = """
import bpy, importlib, pathlib, pkgutil, runpy
root = pathlib.Path(sys.argv[1])
runpy.run_path(str(root / "irgspp_addon" / "launch.py"))["mount"](root)
count = 0
for package in ("irgspp_addon", "operators", "panels"):
    package = importlib.import_module(f"irgspp.{package}")
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
        count += 1
import irgspp, os, traceback
try:
    irgspp.register()
    irgspp.unregister()
except BaseException:
    traceback.print_exc()
    os._exit(1)  # Blender as a module hangs at its end where something is left registered
print(count, sorted(HEAVY & set(sys.modules)))
"""


COLLECT_TESTS = """
import os, pytest, sys
status = pytest.main(["--collect-only", "-qq", "-p", "no:cacheprovider", *sys.argv[1:]])
sys.stdout.flush()
os._exit(status)
"""


def run(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run code in a Python that refuses to import the engine's libraries."""
    command = [sys.executable, "-c", REFUSE + code, *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300, cwd=ROOT)


def test_every_module_imports_and_registers_without_the_engines_libraries():
    done = run(IMPORT_ALL, str(ROOT))
    assert done.returncode == 0, done.stderr
    count, found = done.stdout.strip().splitlines()[-1].split(maxsplit=1)
    assert int(count) > 20 and found == "[]"


def test_every_test_of_blenders_side_can_be_collected_without_the_engines_libraries():
    done = run(COLLECT_TESTS, "tests/irgspp_addon", "tests/operators", "tests/panels")
    assert done.returncode == 0, done.stdout + done.stderr
