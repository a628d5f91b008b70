# SPDX-License-Identifier: GPL-3.0-or-later
"""Atomic writing: a file is replaced completely or not at all."""

import pytest
from irgspp.core.io.atomic import atomic_file, replaced_folder, write_atomic


def test_file_appears_after_the_block_and_not_before(tmp_path):
    with atomic_file(tmp_path / "a.png") as partial:
        partial.write_bytes(b"new")
        assert partial.suffix == ".png" and not (tmp_path / "a.png").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]
    assert (tmp_path / "a.png").read_bytes() == b"new"


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_failure_keeps_the_old_file_and_frees_the_disk_space(tmp_path, failure):
    write_atomic(tmp_path / "a", b"old")
    with pytest.raises(type(failure)), atomic_file(tmp_path / "a") as partial:
        partial.write_bytes(b"half")
        raise failure
    assert [p.name for p in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_bytes() == b"old"


def test_a_folder_is_replaced_with_all_that_was_in_it(tmp_path):
    for name in ("old", "new"):
        with replaced_folder(tmp_path / "a" / "0") as partial:
            assert not list(partial.iterdir())
            (partial / name).write_bytes(b"")
    assert [p.relative_to(tmp_path).as_posix() for p in sorted(tmp_path.rglob("*"))] == ["a", "a/0", "a/0/new"]


def test_a_failure_keeps_the_old_folder(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(KeyboardInterrupt), replaced_folder(tmp_path / "a") as partial:
        (partial / "half").write_bytes(b"")
        raise KeyboardInterrupt
    assert [p.name for p in tmp_path.iterdir()] == ["a"] and not list((tmp_path / "a").iterdir())


def test_content_is_flushed_before_the_name_is_replaced(tmp_path, monkeypatch):
    """A test can't cut the power, but it can check the order of the calls that protect against its loss."""
    from irgspp.core.io import atomic

    done = []
    for name in ("fsync", "replace"):
        real = getattr(atomic.os, name)
        monkeypatch.setattr(atomic.os, name, lambda *words, name=name, real=real: (done.append(name), real(*words)))
    write_atomic(tmp_path / "a", b"new")
    assert done[:2] == ["fsync", "replace"]
