# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine before torch, as it settles how torch's threads wait; what tests in several processes need; cameras; a finished run."""

import gc
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import irgspp.core  # noqa: F401
import numpy as np
import pytest
from irgspp.core.scene.camera import Camera, look_at

gc.disable()  # until the tests' modules are imported, which stay: it would search the growing heap again and again
hypothesis.settings.register_profile("patient", deadline=None)  # a busy machine is no fault
hypothesis.settings.load_profile("patient")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # where it is set, each of many engine processes would compile the package again
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.pop("BLENDER_USER_RESOURCES", None)  # the first process may have chosen one folder already, which the others inherit


WITHOUT_KERNELS = {Path(__file__).parent / name for name in ("irgspp_addon", "operators", "panels")}
# Whole jobs on small scenes, which several threads make slower. Tests of kernels and of equal results keep all threads.
SMALL_JOBS = {Path(__file__).parent / name for name in ("operators", "irgspp_addon", "core/datasets", "test_tiny.py")}
SMALL_JOBS.add(Path(__file__).parent / "core" / "stages" / "common" / "test_finite_check.py")
WITH_ENGINE = {Path(__file__).parent / name for name in ("operators", "irgspp_addon/jobs/test_engine_jobs.py")}


def ring(count: int, size: int = 64, distance: float = 4.0, lowest: float = -0.9, highest: float = 0.9) -> list[Camera]:
    """Cameras on a spiral over the sphere between two heights of the unit sphere, looking at the origin."""
    z, angle = np.linspace(lowest, highest, count), np.arange(count) * 2.399963
    r = np.sqrt(1 - z**2)
    places = distance * np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)
    return [Camera(size, size, 1.3 * size, 1.3 * size, size / 2, size / 2, look_at(p)) for p in places]


@pytest.fixture(scope="session")
def camera_ring() -> Callable[..., list[Camera]]:
    return ring


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """For tests in Blender's process, a finished run: mesh, textures, light and cameras with photographs."""
    from blender_side import write_sphere_run

    return write_sphere_run(tmp_path_factory.mktemp("runs") / "sphere")


@pytest.fixture(scope="session")
def captured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """For tests in Blender's process, a captured dataset; it must not be changed."""
    from blender_side import in_engine

    folder = tmp_path_factory.mktemp("captured") / "photos_capture"
    in_engine(Path(__file__).parent / "support" / "captured_dataset.py", folder)
    return folder


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest tests first: at the end, one process would be at work on them and the others done.

    Of several processes each begins with its part of the list. The tests in Blender's process come in the middle: with the kernels' cache
    empty, the second process would else compile what the first is compiling. For the same reason those of them come last that run jobs of
    the engine, and after them those that share relighting workers, which stay until the last of them.
    """
    marks = {item: item.get_closest_marker("long") for item in items}
    items.sort(key=lambda item: 0 if (mark := marks[item]) is None else -mark.kwargs.get("seconds", 30))
    in_blender = [item for item in items if not WITHOUT_KERNELS.isdisjoint(item.path.parents)]
    in_blender.sort(key=lambda item: (not WITH_ENGINE.isdisjoint((item.path, *item.path.parents)), "warm" in item.fixturenames))
    others = [item for item in items if WITHOUT_KERNELS.isdisjoint(item.path.parents)]
    half = len(items) // 2
    items[:] = others[:half] + in_blender + others[half:]


def pytest_collection_finish() -> None:
    gc.freeze()  # what was imported is left out of the search for garbage
    gc.enable()


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Let small jobs work on one thread where another process of the tests works beside this one."""
    alone = "PYTEST_XDIST_WORKER" not in os.environ or "IRGSPP_THREADS" in os.environ
    if alone or SMALL_JOBS.isdisjoint((item.path, *item.path.parents)):
        yield
        return
    os.environ["IRGSPP_THREADS"] = "1"
    yield
    os.environ.pop("IRGSPP_THREADS", None)


_ended: list[int] = []  # pytest's exit status, once it is known


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    _ended.append(int(exitstatus))
    gc.unfreeze()  # Blender's module must be released


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove Blender's files, and leave before the interpreter's end where its module would spoil it.

    What still refers to the module then makes 4.5 hang (a failed test's traceback does, and with torch in the same process any test can)
    and 4.2 crash (any fixture does); timers that are left behind do so too, and show in the later versions without torch.
    """
    side, blender = sys.modules.get("blender_side"), sys.modules.get("bpy")
    if side is not None and side.RESOURCES is not None:
        side.RESOURCES.cleanup()
    if blender is not None and _ended and (_ended[-1] or blender.app.version < (4, 3) or "torch" in sys.modules):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(_ended[-1])
