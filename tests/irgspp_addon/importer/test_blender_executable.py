# SPDX-License-Identifier: GPL-3.0-or-later
"""A Blender executable writes the .blend if the engine has no module bpy; without either there is an error."""

import os
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from irgspp.core.assets.blend_file import write_blend
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.machine import blender_process as blending
from irgspp.core.machine.blender_process import BLENDER, NoBlender, blender_command
from irgspp.core.progress.protocol import Silent
from irgspp.irgspp_addon.importer.materials import source_of

# Stand-in for Blender: it records its arguments, then runs the script after --python with all of them in sys.argv, as Blender does.
FAKE = """#!{python}
import sys
from pathlib import Path
Path({notes!r}).write_text(" ".join(sys.argv[1:]))
script = Path(sys.argv[sys.argv.index("--python") + 1])
exec(compile(script.read_text(), str(script), "exec"), {{"__name__": "__main__", "__file__": str(script)}})
"""


@pytest.fixture
def blender(tmp_path, monkeypatch) -> Path:
    """Return an executable that behaves like Blender's and writes its arguments to the file `words` next to it."""
    if os.name == "nt":
        pytest.skip("on Windows a script is not an executable")
    program = tmp_path / "blender"
    program.write_text(FAKE.format(python=sys.executable, notes=str(tmp_path / "words")))
    program.chmod(0o755)
    monkeypatch.setenv(BLENDER, str(program))
    return program


def test_named_blender_writes_the_scene(run_folder, tmp_path, blender):
    target = tmp_path / "scene.blend"
    write_blend(run_folder, target, "attributes", Silent())
    words = (tmp_path / "words").read_text().split()
    assert words[:5] == ["--background", "--factory-startup", "--python-exit-code", "1", "--python"]
    bpy.ops.wm.open_mainfile(filepath=str(target))
    assert [source_of(thing.active_material) for thing in bpy.data.objects if thing.type == "MESH"] == ["attributes"]


def test_its_error_is_passed_on(run_folder, tmp_path, blender):
    (tmp_path / "mesh.ply").write_bytes((run_folder / "mesh.ply").read_bytes())
    with pytest.raises(InputError, match=r"cameras\.json") as caught:
        write_blend(tmp_path, tmp_path / "scene.blend", "textures", Silent())
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "scene.blend").exists()


def test_its_crash_is_reported(run_folder, tmp_path, blender):
    blender.write_text(f"#!{sys.executable}\nimport sys\nsys.exit('out of memory')\n")
    with pytest.raises(IrgsppError, match=r"status 1: out of memory"):
        write_blend(run_folder, tmp_path / "scene.blend", "textures", Silent())


def test_named_blender_has_precedence_over_the_module(blender):
    assert blender_command()[0] == str(blender)


def test_neither_executable_nor_module(run_folder, tmp_path, monkeypatch):
    monkeypatch.delenv(BLENDER, raising=False)
    monkeypatch.setattr(blending.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(NoBlender, match=r"bpy.*not installed.*IRGSPP_BLENDER"):
        write_blend(run_folder, tmp_path / "scene.blend", "textures", Silent())


def test_named_blender_that_does_not_exist(tmp_path, monkeypatch):
    """A wrong name is an error; the module is not used instead."""
    monkeypatch.setenv(BLENDER, str(tmp_path / "no blender"))
    with pytest.raises(NoBlender, match="no blender, which is not a program"):
        blender_command()


@pytest.mark.parametrize(("stdin", "status"), [(subprocess.DEVNULL, 1), (subprocess.PIPE, 0)], ids=["gone", "there"])
def test_blender_ends_with_the_process_that_started_it(stdin, status):
    """The parent holds the other end of its stdin, so that the Blender of a killed job does not write while the next one does."""
    command = [sys.executable, str(blending.LAUNCHER), "__main__", "--help"]
    with subprocess.Popen(command, stdin=stdin, stdout=subprocess.DEVNULL, env={**os.environ, "IRGSPP_TIED": "1"}) as process:
        assert process.wait(60) == status
