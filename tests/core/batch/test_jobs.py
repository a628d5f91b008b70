# SPDX-License-Identifier: GPL-3.0-or-later
"""Job lists: the commands that they become, and one line for each kind of error in them."""

from pathlib import Path

import pytest
from irgspp.core.batch.jobs import read_jobs
from irgspp.core.capture.source import needs_capture
from irgspp.core.cli.commands import settings_of
from irgspp.core.cli.parser import check_words, parser
from irgspp.core.errors import InputError
from irgspp.core.settings.schema import CaptureSettings

GOOD = """
[defaults]
preset = "draft"
set = ["surface.texture=2048"]
after = ["evaluate --protocol irgs"]

[[job]]
dataset = "captures/bear"
output = "runs/bear"

[[job]]
dataset = "/elsewhere/fox photos"
output = "runs/fox"
name = "the fox"
preset = "balanced"
seed = 3
time = "5m"
set = ["data.masks=no"]
after = ["render --orbit 12 -o '{output} turning'", "export -o {name}.glb"]
"""


def jobs_of(folder: Path, text: str):
    (folder / "jobs.toml").write_text(text, encoding="utf-8")
    return read_jobs(folder / "jobs.toml", check_words)


def test_a_list_becomes_commands(tmp_path):
    bear, fox = jobs_of(tmp_path, GOOD)
    run = str(tmp_path / "runs/bear")
    photos = str(tmp_path / "captures/bear")
    words = ("reconstruct", photos, "-o", run, "--preset", "draft", "--set", "surface.texture=2048")
    assert (bear.name, bear.run, bear.base) == ("bear", Path(run), tmp_path)
    assert bear.steps == (words, ("evaluate", run, photos, "--protocol", "irgs"))
    run = str(tmp_path / "runs/fox")
    words = ("reconstruct", "/elsewhere/fox photos", "-o", run, "--preset", "balanced", "--seed", "3", "--time", "5m")
    words += ("--set", "surface.texture=2048", "--set", "data.masks=no")  # the list's, then the job's own
    after = (("render", run, "--orbit", "12", "-o", f"{run} turning"), ("export", run, "-o", "the fox.glb"))
    assert fox.name == "the fox" and fox.steps == (words, *after)


def test_photographs_without_cameras_are_a_job(tmp_path):
    """One command captures and reconstructs them; settings of the capture are the job's."""
    text = 'set = ["capture.marker=0.05", "capture.centre=0,0,0.1", "capture.radius=0.1"]\n[[job]]\ndataset = "mug"\noutput = "run"'
    photos = tmp_path / "mug"
    photos.mkdir()
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        (photos / name).touch()
    (job,) = jobs_of(tmp_path, f"[defaults]\n{text}\nafter = ['evaluate']")
    assert needs_capture(photos) and job.steps[0][:4] == ("reconstruct", str(photos), "-o", str(tmp_path / "run"))
    assert job.steps[0][4:] == ("--set", "capture.marker=0.05", "--set", "capture.centre=0,0,0.1", "--set", "capture.radius=0.1")
    assert job.steps[1] == ("evaluate", str(tmp_path / "run"), str(photos))  # which finds the capture in the run folder
    args = parser().parse_args(list(job.steps[0]))
    assert settings_of(args).capture == CaptureSettings(marker=0.05, centre=(0.0, 0.0, 0.1), radius=0.1)


JOB = '[[job]]\ndataset = "d"\noutput = "o"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[job]\n", "is not TOML"),
        ("", "lists no jobs"),
        ("job = 3", "lists no jobs"),
        ("[[jobs]]\n", "unknown jobs"),
        ("[[job]]\noutput = 'o'", "job 1: lacks dataset"),
        ("[[job]]\ndataset = 3\noutput = 'o'", "job 1: lacks dataset"),
        (JOB + "presets = 'draft'", "job 1: has an unknown presets"),
        ("[defaults]\noutput = 'o'\n" + JOB, "unknown output"),
        ("defaults = 3\n" + JOB, "is not a table"),
        (JOB + "preset = 'fast'", "job 1 (o): reconstruct: .*invalid choice: 'fast'"),
        (JOB + "set = ['surface.texure=1']", "surface.texture"),
        (JOB + "set = 'surface.texture=64'", "set is not a list of strings"),
        (JOB + "set = ['capture.centre=0,0,1']", r"job 1 (o): reconstruct: capture\.centre: is given without capture\.radius"),
        (JOB + "seed = 1.5", "seed = 1.5 is neither"),
        (JOB + "name = '../a'", "can't be its name"),
        (JOB + "after = ['reconstruct x -o y']", "reconstruct can't follow a reconstruction; use bake, evaluate, export, render"),
        (JOB + "after = ['']", "is not a command"),
        (JOB + "after = ['render \"x']", "is not a command"),
        (JOB + "after = ['render --orbit 3']", "render: .*required: -o"),
        (JOB + "after = ['evaluate --protocol nerf']", "evaluate: .*invalid choice: 'nerf'"),
        (JOB + JOB, "two jobs are called o"),
        (JOB + JOB + "name = 'p'", "o and p both write to"),
        (JOB + JOB.replace("'o'", "").replace('"o"', '"o/inside"'), "o and inside both write to"),
        (JOB + "after = ['export -o a.glb']\n" + JOB.replace('"o"', '"p"') + "after = ['export -o ./a.glb']", "both write to"),
    ],
)
def test_what_is_wrong_is_one_line_that_says_where(tmp_path, text, message):
    with pytest.raises(InputError, match=message.replace("(o)", r"\(o\)")) as error:
        jobs_of(tmp_path, text)
    assert "\n" not in str(error.value) and "jobs.toml" in str(error.value)


def test_a_list_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="can't be read"):
        read_jobs(tmp_path / "jobs.toml", check_words)
    (tmp_path / "jobs.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="is not TOML"):
        read_jobs(tmp_path / "jobs.toml", check_words)
