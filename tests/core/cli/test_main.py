# SPDX-License-Identifier: GPL-3.0-or-later
"""Command line: exit statuses, one line per error, the line that resumes, no heavy imports before they are needed."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from irgspp.core import pipeline
from irgspp.core.cli.commands import settings_of
from irgspp.core.cli.main import main, resume_line
from irgspp.core.cli.parser import parser
from irgspp.core.errors import Cancelled, InputError, IrgsppError
from irgspp.core.run_folder import RunFolder, read_run
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings, preset


@pytest.fixture
def job(monkeypatch):
    """Replace the reconstruction: `job.error` is raised, arguments are recorded."""

    class Job:
        error = None
        calls: list = []  # noqa: RUF012

        def __call__(self, dataset, run, settings, **options):
            self.calls.append((dataset, run, settings, options))
            if self.error:
                raise self.error
            return run

    fake = Job()
    fake.calls = []
    monkeypatch.setattr(pipeline, "reconstruct", fake)
    return fake


@pytest.mark.parametrize(
    "line", ["", "paint", "reconstruct photos", "inspect", "render r --views d -o o --layers rgb", "demo --fast", "devices --json=3"]
)
def test_bad_usage_is_status_2(line, capsys):
    assert main(line.split()) == 2
    assert "usage: irgspp" in capsys.readouterr().err


def test_help_is_status_0(capsys):
    assert main(["--help"]) == 0
    assert "reconstruct" in capsys.readouterr().out


def test_help_imports_nothing_heavy():
    heavy = "{'torch', 'numba', 'scipy', 'bpy'}"
    code = f"import sys; from irgspp.core.cli.main import main; main(['--help']); sys.exit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-P", "-c", code], capture_output=True).returncode == 0


def test_a_bake_that_is_refused_or_changes_the_size_alone_does_not_wait_for_torch():
    code = "import sys, irgspp.core.assets.rebake; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-P", "-c", code], check=False).returncode == 0


def test_module_runs(tmp_path):
    command = [sys.executable, "-P", "-m", "irgspp", "inspect", str(tmp_path / "missing")]
    process = subprocess.run(command, capture_output=True, text=True)
    assert process.returncode == 2
    assert process.stdout == ""
    assert process.stderr.startswith("irgspp: ")
    assert process.stderr.count("\n") == 1
    assert "missing" in process.stderr


def test_inspect_prints_a_summary(capsys):
    assert main(["inspect", str(pipeline.DEMO_DATA)]) == 0
    out = capsys.readouterr().out
    for words in ("transforms", "40 training, 6 test", "64x64", "39.6 degrees", "40 of 40 training views"):
        assert words in out


@pytest.mark.parametrize(("compiled", "words"), [(3, "the kernels are compiled"), (0, "the kernels were compiled before")])
def test_compile(capsys, monkeypatch, compiled, words):
    monkeypatch.setattr("irgspp.core.kernel_cache.fill_kernel_cache", lambda progress: compiled)
    assert main(["compile"]) == 0
    assert capsys.readouterr().out.strip() == words


def test_devices(capsys):
    assert main(["devices", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["cpu"]["threads"] >= 1
    assert main(["devices"]) == 0
    assert found["cpu"]["name"] in capsys.readouterr().out


@pytest.mark.parametrize(
    ("error", "status"), [(InputError("a.png", "truncated"), 2), (IrgsppError("no surface"), 1), (Cancelled("asked"), 130)]
)
def test_errors_end_with_their_status_and_one_line(job, tmp_path, capsys, error, status):
    job.error = error
    assert main(["reconstruct", "photos", "-o", str(tmp_path / "run")]) == status
    captured = capsys.readouterr()
    assert str(error) in captured.err.splitlines()[0]
    assert "Traceback" not in captured.err
    assert captured.out == ""


def test_cancel_prints_the_line_that_resumes(job, tmp_path, capsys):
    job.error = Cancelled("asked")
    main(["reconstruct", "my photos", "-o", str(tmp_path / "run"), "--preset", "draft", "--overwrite"])
    line = capsys.readouterr().err.splitlines()[-1].partition("resume with: ")[2]
    words = shlex.split(line)
    assert words == ["irgspp", "reconstruct", "my photos", "-o", str(tmp_path / "run"), "--preset", "draft", "--resume"]
    assert parser().parse_args(words[1:]).resume
    assert resume_line(["demo", "--resume"]).split() == ["irgspp", "demo", "--resume"]


def test_cancelled_capture_prints_the_same_line(monkeypatch, tmp_path, capsys):
    def stopped(*_):
        raise Cancelled("stopped while photographs were matched")

    monkeypatch.setattr("irgspp.core.capture.capture.capture", stopped)
    words = ["capture", "my photos", "-o", str(tmp_path / "captured"), "--seed", "3"]
    assert main(words) == 130
    cancelled, line = capsys.readouterr().err.splitlines()
    assert cancelled == "irgspp: cancelled: stopped while photographs were matched"
    assert shlex.split(line.partition("resume with: ")[2]) == ["irgspp", *words]


def test_unexpected_error_keeps_its_traceback_in_the_log(job, tmp_path, capsys):
    RunFolder.open(tmp_path / "run", Settings(), "photos").log("began")
    job.error = ZeroDivisionError("division\nby zero")
    assert main(["reconstruct", "photos", "-o", str(tmp_path / "run")]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "log.txt" in error
    assert "Traceback" in (tmp_path / "run" / "log.txt").read_text()


def test_result_goes_to_stdout_alone(job, tmp_path, capsys):
    assert main(["reconstruct", "photos", "-o", str(tmp_path / "run")]) == 0
    captured = capsys.readouterr()
    assert captured.out == f"{tmp_path / 'run'}\n"
    assert captured.err == ""


def test_settings_come_from_preset_options_and_overrides():
    line = "reconstruct d -o r --preset draft --seed 3 --materials glossy --set data.resolution=100 --set data.masks=no"
    settings = settings_of(parser().parse_args(line.split()))
    assert settings == with_overrides(preset("draft"), ["seed=3", "materials=glossy", "data.resolution=100", "data.masks=no"])
    assert settings_of(parser().parse_args(["reconstruct", "d", "-o", "r"])) == Settings()


def test_bare_resume_takes_the_settings_of_the_run(tmp_path):
    settings = with_overrides(preset("draft"), ["seed=5"])
    RunFolder.open(tmp_path / "run", settings, "d").close()
    assert settings_of(parser().parse_args(["reconstruct", "d", "-o", str(tmp_path / "run"), "--resume"])) == settings


def test_another_sphere_resumes_with_the_other_settings_of_the_run(tmp_path):
    settings, line = with_overrides(preset("draft"), ["seed=5"]), f"reconstruct d -o {tmp_path / 'run'} --resume"
    RunFolder.open(tmp_path / "run", settings, "d").close()
    moved = settings_of(parser().parse_args([*line.split(), "--sphere", "-0.5", "0", "0.25", "0.3"]))
    assert moved == with_overrides(settings, ["capture.centre=-0.5,0,0.25", "capture.radius=0.3"])
    assert settings_of(parser().parse_args([*line.split(), "--set", "capture.radius=none"])) == settings
    assert settings_of(parser().parse_args([*line.split(), "--set", "seed=6"])).first == preset("balanced").first


def test_options_of_captures_are_those_of_reconstruct(job, tmp_path, capsys):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").touch()
    words = ["--marker", "5cm", "--turntable", "on", "--sphere", "0", "-1", "2", "0.5", "-o", str(tmp_path / "run")]
    assert main(["reconstruct", str(tmp_path / "photos"), *words]) == 0
    found = job.calls[-1][2].capture
    assert (found.marker, found.turntable, found.centre, found.radius) == (0.05, "on", (0.0, -1.0, 2.0), 0.5)
    assert main(["reconstruct", str(pipeline.DEMO_DATA), *words]) == 2
    assert "--marker --turntable --sphere: is for photographs without cameras" in capsys.readouterr().err
    assert main(["reconstruct", str(tmp_path / "photos"), "--marker", "5", "-o", "r"]) == 2
    assert main(["reconstruct", str(tmp_path / "photos"), "--sphere", "1", "2", "3", "-o", "r"]) == 2
    assert main(["reconstruct", str(tmp_path / "photos"), "--sphere", "1", "2", "3", "-4", "-o", "r"]) == 2
    assert len(job.calls) == 1


def test_bad_override_is_status_2(job, tmp_path, capsys):
    assert main(["reconstruct", "photos", "-o", str(tmp_path / "run"), "--set", "first.iteration=3"]) == 2
    assert "first.iterations" in capsys.readouterr().err
    assert job.calls == []


def test_demo_replaces_an_earlier_demo_and_nothing_else(job, tmp_path):
    def make(dataset):
        RunFolder.open(tmp_path / "demo", Settings(), dataset, overwrite=True).close()
        assert main(["demo", "-o", str(tmp_path / "demo")]) == 0
        return job.calls[-1][3]["overwrite"]

    assert make(str(pipeline.DEMO_DATA)) is True
    assert make("my photos") is False


def test_demo_takes_a_preset(job, tmp_path):
    for words, name in (([], "balanced"), (["--preset", "draft"], "draft")):
        assert main(["demo", "-o", str(tmp_path / "demo"), *words]) == 0
        assert (job.calls[-1][2].preset, job.calls[-1][2].first.gaussians) == (name, 10_000)


@pytest.mark.parametrize("command", [["render", "RUN", "--views", "d", "-o", "o"], ["export", "RUN", "-o", "a.glb"]])
def test_commands_on_a_folder_that_is_no_run(tmp_path, capsys, command):
    (tmp_path / "empty").mkdir()
    assert main([str(tmp_path / "empty") if word == "RUN" else word for word in command]) == 2
    assert "not a run folder" in capsys.readouterr().err


def test_export_of_an_unfinished_run(tmp_path, capsys):
    RunFolder.open(tmp_path / "run", Settings(), "d").close()
    target = tmp_path / "a.glb"
    assert main(["export", str(tmp_path / "run"), "-o", str(target)]) == 2
    assert not target.exists()
    assert read_run(tmp_path / "run")["status"] == "running"
    assert main(["export", str(tmp_path / "run"), "-o", str(tmp_path / "a.fbx")]) == 2
    assert "mesh.ply: no such file" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "run"), "-o", str(tmp_path / "a.stl")]) == 2
    assert "can't export to .stl" in capsys.readouterr().err


def test_package_has_the_demo_data():
    assert (pipeline.DEMO_DATA / "transforms_train.json").is_file()
    assert isinstance(pipeline.DEMO_DATA, Path)


def test_tiles_are_a_setting():
    settings = settings_of(parser().parse_args(["reconstruct", "photos", "-o", "run", "--texture", "2k", "--udim", "3"]))
    assert (settings.surface.udim_tiles, settings.surface.tile_texels, settings.surface.texels) == (3, 2048, 6144)
    with pytest.raises(InputError, match=r"surface.udim_tiles: 5 is out of range; must be at least 1 and at most 4"):
        settings_of(parser().parse_args(["reconstruct", "photos", "-o", "run", "--udim", "5"]))
