# SPDX-License-Identifier: GPL-3.0-or-later
"""The garbage collector pauses during imports, and is afterwards as it was."""

import gc
import sys

import pytest
from irgspp.core.machine.quick_imports import quick_imports


@pytest.fixture(autouse=True)
def _enabled():
    """Leave the collector enabled, whatever a test did."""
    yield
    gc.enable()


def test_collector_pauses_and_goes_on():
    gc.enable()
    with quick_imports():
        assert not gc.isenabled()
    assert gc.isenabled()


def test_collector_goes_on_after_an_error():
    gc.enable()
    with pytest.raises(ModuleNotFoundError), quick_imports():
        import no_such_module  # noqa: F401
    assert gc.isenabled()


def test_collector_that_was_off_stays_off():
    gc.disable()
    with quick_imports():
        pass
    assert not gc.isenabled()


def test_collector_leaves_out_what_was_loaded(tmp_path, monkeypatch):
    (tmp_path / "module_of_a_test.py").write_text("things = [[]]\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    gc.unfreeze()
    with quick_imports():
        import gc as again  # noqa: F401
    assert gc.get_freeze_count() == 0  # nothing was loaded
    with quick_imports():
        import module_of_a_test
    try:
        assert gc.get_freeze_count() > 0 and not any(thing is module_of_a_test.things for thing in gc.get_objects())
    finally:
        gc.unfreeze()
        monkeypatch.delitem(sys.modules, "module_of_a_test")
