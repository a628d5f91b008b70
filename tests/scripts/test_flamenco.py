# SPDX-License-Identifier: GPL-3.0-or-later
"""Flamenco's job script: its tasks are valid `irgspp` commands that together render every frame once."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from irgspp.core.cli.parser import parser

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "flamenco" / "irgspp_relight.js"
SETTINGS = {
    "run": "/farm/runs/bear",
    "output": "/farm/frames",
    "orbit": 25,
    "views": "",
    "frames": "0-24",
    "chunk_size": 10,
    "environment": "/farm/sun set.exr",
    "rotation": -90.5,
    "strength": 2,
    "samples": "efficient",
    "layers": "rgba,normal",
    "command": "blender",
}
# What Flamenco's manager gives to scripts, as far as this one asks for it.
MANAGER = """
const author = {
    Task: (name, type) => ({ name, type, commands: [], addCommand(command) { this.commands.push(command); } }),
    Command: (name, parameters) => ({ name, parameters }),
};
function frameChunker(frames, size) {
    const all = frames.split(",").flatMap(part => {
        const [a, b] = part.split("-").map(Number);
        return Array.from({ length: (b ?? a) - a + 1 }, (_, i) => a + i);
    });
    const chunks = [];
    for (let i = 0; i < all.length; i += size) chunks.push(all.slice(i, i + size).join(","));
    return chunks;
}
const job = { settings: SETTINGS, tasks: [], addTask(task) { this.tasks.push(task); } };
try { compileJob(job); console.log(JSON.stringify(job.tasks)); } catch (error) { console.log(JSON.stringify({ error })); }
"""

node = pytest.mark.skipif(shutil.which("node") is None, reason="there is no JavaScript engine")


def compiled(**changes):
    """Return the tasks of a job, or the error that the script threw."""
    program = SCRIPT.read_text("utf-8") + MANAGER.replace("SETTINGS", json.dumps(SETTINGS | changes))
    done = subprocess.run(["node", "-"], input=program, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_settings_are_those_that_the_script_reads():
    """Every setting is declared and used; this needs no JavaScript engine."""
    text = SCRIPT.read_text("utf-8")
    declared = set(re.findall(r'\{ key: "(\w+)"', text))
    assert declared == set(re.findall(r"settings\.(\w+)", text)) == set(SETTINGS)
    assert all(text.count(bracket[0]) == text.count(bracket[1]) for bracket in ("()", "[]", "{}"))


@node
def test_tasks_are_renders_that_make_every_frame_once():
    tasks = compiled()
    assert [(task["type"], len(task["commands"])) for task in tasks] == [("blender", 1)] * 3
    frames = []
    for task in tasks:
        command = task["commands"][0]
        words = command["parameters"]["args"]
        assert command["name"] == "exec" and command["parameters"]["exe"] == "{blender}"
        assert words[:3] == ["--background", "--command", "irgspp"]
        args = parser().parse_args(words[3:])
        assert (args.run, args.out, args.orbit) == (Path("/farm/runs/bear"), Path("/farm/frames"), 25)
        assert (args.environment, args.rotation, args.strength) == ([Path("/farm/sun set.exr")], [-90.5], [2.0])
        assert (args.samples, args.layers, args.views) == ("efficient", ("rgba", "normal"), None)
        frames += args.frames
    assert frames == list(range(25))


@node
def test_cameras_of_a_dataset_and_the_engine_alone():
    (task,) = compiled(orbit=0, views="/farm/photos:test", environment="", frames="3,5-7", command="irgspp")
    parameters = task["commands"][0]["parameters"]
    args = parser().parse_args(parameters["args"])
    assert parameters["exe"] == "{irgspp}" and args.frames == [3, 5, 6, 7]
    assert (args.views, args.orbit, args.environment) == ("/farm/photos:test", None, [])


@node
def test_a_job_without_cameras_is_refused():
    assert "give the frames of a turn" in compiled(orbit=0)["error"]
