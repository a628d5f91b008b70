# SPDX-License-Identifier: GPL-3.0-or-later
"""Run a module of this very folder as part of the package `irgspp`, whatever Python runs and whatever the folder is called.

python launch.py __main__ ARGUMENTS                  the command line
python launch.py irgspp_addon.importer.write_blend ARGUMENTS  one of its modules
blender --background --python launch.py -- irgspp_addon.importer.write_blend ARGUMENTS
"""

import importlib
import importlib.util
import os
import runpy
import sys
from pathlib import Path


def mount(folder: Path) -> None:
    """Make `import irgspp` mean the package in `folder`."""
    spec = importlib.util.spec_from_file_location("irgspp", folder / "__init__.py", submodule_search_locations=[str(folder)])
    assert spec is not None and spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules["irgspp"] = package
    spec.loader.exec_module(package)


def end_with_parent() -> None:
    """Where it was asked for, end this process once the one that started it is gone."""
    end = importlib.import_module("irgspp.core.machine.parent_watch")
    if os.environ.pop(end.PARENT_WATCH, ""):
        end.on_parent_exit(lambda: os._exit(1))


if __name__ == "__main__":
    if sys.version_info < (3, 11):  # noqa: UP036 (read by whatever Python was chosen)
        print(f"irgspp: this is Python {sys.version_info[0]}.{sys.version_info[1]}, 3.11 or newer is needed", file=sys.stderr)
        sys.exit(2)
    if Path(sys.argv[0]).name != Path(__file__).name:  # a Blender runs this, and left its own words here
        sys.argv = [__file__, *sys.argv[sys.argv.index("--") + 1 :]]
    here = Path(__file__).resolve().parent
    if sys.path and Path(sys.path[0]).resolve() == here:
        del sys.path[0]  # our modules must not be found under their bare names
    mount(here.parent)
    end_with_parent()
    module = f"irgspp.{sys.argv.pop(1)}"
    runpy.run_module(module, run_name="__main__", alter_sys=True)
