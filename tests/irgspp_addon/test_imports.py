# SPDX-License-Identifier: GPL-3.0-or-later
"""No module of the extension, and no test of it, imports the engine's libraries into Blender's process."""

import subprocess
import sys

import pytest
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


IMPORT_TESTS = """
sys.path.insert(0, str(root / "tests" / "support"))
for folder in ("irgspp_addon", "operators", "panels"):
    for file in sorted((root / "tests" / folder).rglob("*.py")):
        runpy.run_path(str(file))
print(sorted(HEAVY & set(sys.modules)))
sys.stdout.flush()
os._exit(0)
"""


@pytest.fixture(scope="module")
def printed() -> list[str]:
    """Lines that a Python prints which refuses the engine's libraries, imports the extension, and then its tests."""
    command = [sys.executable, "-c", REFUSE + IMPORT_ALL + IMPORT_TESTS, str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.strip().splitlines()


def test_every_module_imports_and_registers_without_the_engines_libraries(printed):
    count, found = printed[-2].split(maxsplit=1)
    assert int(count) > 20 and found == "[]"


def test_every_test_of_blenders_side_is_imported_without_the_engines_libraries(printed):
    assert printed[-1] == "[]"
