# SPDX-License-Identifier: GPL-3.0-or-later
"""Launcher: run a module of this source folder as part of the package `irgspp`, in any Python and whatever the folder is called.

python launch.py __main__ ARGUMENTS                                                       the command line
python launch.py irgspp_addon.importer.write_blend ARGUMENTS                              one module of the package
blender --background --python launch.py -- irgspp_addon.importer.write_blend ARGUMENTS    the same in a Blender
"""

import importlib
import importlib.util
import os
import runpy
import sys
from pathlib import Path


def mount(folder: Path) -> None:
    """Load the package in `folder` under the name `irgspp`."""
    spec = importlib.util.spec_from_file_location("irgspp", folder / "__init__.py", submodule_search_locations=[str(folder)])
    assert spec is not None and spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules["irgspp"] = package
    spec.loader.exec_module(package)


def end_with_parent() -> None:
    """End this process with its parent where the environment variable of `core.machine.parent_watch` requests it."""
    parent_watch = importlib.import_module("irgspp.core.machine.parent_watch")
    if os.environ.pop(parent_watch.PARENT_WATCH, ""):
        parent_watch.on_parent_exit(lambda: os._exit(1))


if __name__ == "__main__":
    if sys.version_info < (3, 11):  # noqa: UP036 (this file is run by any Python that a user chose)
        print(f"irgspp: this is Python {sys.version_info[0]}.{sys.version_info[1]}, 3.11 or newer is needed", file=sys.stderr)
        sys.exit(2)
    if Path(sys.argv[0]).name != Path(__file__).name:  # a Blender executable runs this, and sys.argv holds its own arguments too
        sys.argv = [__file__, *sys.argv[sys.argv.index("--") + 1 :]]
    own_folder = Path(__file__).resolve().parent
    if sys.path and Path(sys.path[0]).resolve() == own_folder:
        del sys.path[0]  # the package's modules must not be importable as top-level modules
    mount(own_folder.parent)
    end_with_parent()
    module = f"irgspp.{sys.argv.pop(1)}"
    runpy.run_module(module, run_name="__main__", alter_sys=True)
