# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice of the wheels that get a digest; the index is a page made by the test."""

import io

import pytest
from scripts_folder import scripts_on_path

with scripts_on_path() as script:
    lock_hashes = script("lock_hashes")

SERVE = (
    "thing-1.2-py3-none-any.whl",
    "thing-1.2-cp311-cp311-manylinux_2_17_x86_64.manylinux2014_x86_64.whl",
    "thing-1.2-cp39-abi3-win_amd64.whl",
    "thing-1.2-cp313-cp313-macosx_11_0_arm64.whl",
    "thing-1.2-cp312-cp312-manylinux_2_28_aarch64.whl",
)
DO_NOT = (
    "thing-1.3-py3-none-any.whl",
    "thing-1.2-cp310-cp310-manylinux2014_x86_64.whl",
    "thing-1.2-cp313-cp313t-manylinux2014_x86_64.whl",
    "thing-1.2-cp311-cp311-musllinux_1_2_x86_64.whl",
    "thing-1.2-cp311-cp311-win32.whl",
    "thing-1.2-pp311-pypy311_pp73-win_amd64.whl",
)


@pytest.fixture
def index(monkeypatch):
    """Return the pages of the index by their address."""
    pages = {}

    def opened(request, timeout):
        return io.BytesIO(pages[request.full_url].encode())

    monkeypatch.setattr(lock_hashes.urllib.request, "urlopen", opened)
    return pages


def page(names):
    links = "".join(f'<a href="../../files/ab/{name}#sha256={i:064x}">{name}</a>' for i, name in enumerate(names))
    return f"<html>{links}<a href='other'>thing-1.2.tar.gz</a></html>"


def test_wheels_are_those_that_blenders_pythons_load(index):
    index["https://index/simple/some-thing/"] = page((*SERVE, *DO_NOT))
    found = dict(lock_hashes.wheels("https://index/simple/", "Some_Thing", "1.2"))
    assert found == {name: f"{i:064x}" for i, name in enumerate(SERVE)}


def test_digests_are_written_whole_or_not_at_all(index, tmp_path, monkeypatch, capsys):
    index |= {"https://index/thing/": page(SERVE[:2]), "https://index/other/": page(())}
    (tmp_path / "wheels").mkdir()
    (tmp_path / "wheels" / "own-1.0-py3-none-any.whl").write_bytes(b"")
    monkeypatch.setattr(lock_hashes, "HASHES", tmp_path / "hashes")
    monkeypatch.setattr(lock_hashes, "resolved", lambda index: [("thing", "1.2")])
    monkeypatch.setattr(lock_hashes, "pins", lambda: [("thing", "1.2"), ("other", "3")])
    assert lock_hashes.main(["https://index"]) == 1
    assert "other==3: the index has no wheel" in capsys.readouterr().err and not (tmp_path / "hashes").exists()
    monkeypatch.setattr(lock_hashes, "pins", lambda: [("thing", "1.2")])
    assert lock_hashes.main(["https://index", "--also", str(tmp_path / "wheels")]) == 0
    lines = [line.split("  ") for line in (tmp_path / "hashes").read_text().splitlines()]
    assert [name for _, name in lines] == sorted([*SERVE[:2], "own-1.0-py3-none-any.whl"])
    assert dict((name, digest) for digest, name in lines)["own-1.0-py3-none-any.whl"].startswith("e3b0c442")  # of nothing


def test_pins_are_those_of_the_lock_and_of_cuda_without_blender():
    names = [name for name, _ in lock_hashes.pins()]
    assert {"torch", "numpy", "warp-lang"} <= set(names) and "bpy" not in names
    assert len([name for name in names if name == "numpy"]) == 2  # one for each range of Pythons
