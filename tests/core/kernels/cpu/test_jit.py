# SPDX-License-Identifier: GPL-3.0-or-later
"""Cache folder of compiled kernels."""

import os
import stat
import sys
import tempfile

import numba
import pytest
from irgspp.core.kernels.cpu import jit
from irgspp.core.machine import cache_folder


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """Replace the system's temporary folder by an empty one."""
    folder = tmp_path / "system"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def blocked(tmp_path, monkeypatch):
    """Set a cache folder that nobody, root included, can write to: it is a file."""
    (tmp_path / "blocked").write_text("")
    monkeypatch.setenv("IRGSPP_CACHE", str(tmp_path / "blocked"))


def test_cache_is_where_the_user_wants_it(tmp_path, monkeypatch, temporary):
    monkeypatch.setenv("IRGSPP_CACHE", str(tmp_path / "mine"))
    folder = jit.cache_folder()
    assert folder.parent == tmp_path / "mine" and folder.is_dir() and folder.name.startswith("kernels-")
    assert jit.cache_folder() == folder
    assert not list(temporary.iterdir())


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="XDG is Linux's")
def test_cache_follows_xdg(tmp_path, monkeypatch):
    monkeypatch.delenv("IRGSPP_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder.cache_root() == tmp_path / "irgspp"


def test_unwritable_cache_falls_back_to_a_private_folder(tmp_path, monkeypatch, temporary):
    blocked(tmp_path, monkeypatch)
    folder = jit.cache_folder()
    assert folder.is_relative_to(temporary)
    for private in (folder, folder.parent):
        assert stat.S_IMODE(private.stat().st_mode) & 0o077 == 0


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows' temporary folder is the user's own")
def test_folder_others_can_write_to_is_not_trusted(tmp_path, monkeypatch, temporary):
    blocked(tmp_path, monkeypatch)
    planted = temporary / f"irgspp-{os.getuid()}"
    planted.mkdir()
    planted.chmod(0o777)  # whoever made it could plant compiled code
    with pytest.raises(OSError, match="IRGSPP_CACHE"):
        jit.cache_folder()


def test_without_a_writable_folder_the_error_names_the_setting(tmp_path, monkeypatch):
    blocked(tmp_path, monkeypatch)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "blocked"))
    with pytest.raises(OSError, match="IRGSPP_CACHE"):
        jit.cache_folder()


def test_name_changes_with_the_sources(tmp_path, monkeypatch):
    monkeypatch.setenv("IRGSPP_CACHE", str(tmp_path / "cache"))
    before = jit.cache_folder()
    sources = tmp_path / "kernels" / "cpu"
    sources.mkdir(parents=True)
    for name in ("jit.py", "simd.py", "../constants.py"):
        (sources / name).write_text("x = 1\n")
    monkeypatch.setattr(jit, "__file__", str(sources / "jit.py"))
    first = jit.cache_folder()
    (sources / "simd.py").write_text("x = 2\n")
    second = jit.cache_folder()
    (sources.parent / "constants.py").write_text("x = 2\n")
    assert len({before, first, second, jit.cache_folder()}) == 4


def test_processes_that_compile_at_once_keep_their_versions_apart(tmp_path, monkeypatch):
    """Neither process sees the entries of the other in the index, yet both versions stay intact on disk."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def twice(x):
        return x + x

    first, second, later = (jit.kernel(twice) for _ in range(3))
    for compiled in (first, second):
        compiled._cache._cache_file._load_index = dict
    assert (first(2**40), second(1.5)) == (2**41, 3.0)
    assert len({path.read_bytes() for path in tmp_path.rglob("*.nbc")}) == 2
    assert later(2.5) == 5.0 and list(later.stats.cache_hits.values()) == [1]
