# SPDX-License-Identifier: GPL-3.0-or-later
"""Reproduction of published tables: scenes are found, each is done once, and results stand next to published rows; commands are stubs."""

import json
import os
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irgspp.core.batch import job_runner as work
from irgspp.core.scene.camera import look_at
from PIL import Image
from scripts_folder import script as script

STUB = """
import json, os, pathlib, sys
_, lock, command, *words = sys.argv[1:]
here = pathlib.Path(__file__).parent
with (here / "commands.txt").open("a") as file:
    print(command, *words, file=file)
if command == "reconstruct":
    if pathlib.Path(words[0]).name == "lego" and not (here / "well").exists():
        print("irgspp: lego: no surface", file=sys.stderr)
        sys.exit(1)
    run = pathlib.Path(words[2])
    run.mkdir(parents=True, exist_ok=True)
    phase = {"seconds": 90, "peak_memory": 1, "finished": True}
    (run / "run.json").write_text(json.dumps({"status": "done", "phases": {"a": phase}, "settings": {}}))
    (run / "contact_sheet.png").write_bytes((here / "sheet.png").read_bytes())
else:
    out = pathlib.Path(words[words.index("-o") + 1])
    out.mkdir(parents=True, exist_ok=True)
    bright = {"hotdog": 30.0, "lego": 32.0}.get(pathlib.Path(words[1]).name, 20.0)
    figures = {"nvs_psnr": bright + 5, "relight_psnr": bright, "normal_mae_full": 4.0, "mesh_chamfer": 0.5}
    protocol = words[words.index("--protocol") + 1]
    said = {"choices": {"name": protocol}, "protocol": [f"Protocol {protocol}: x.", "Scale of the albedo: 1"]}
    (out / "report.json").write_text(json.dumps({"figures": figures, **said}))
"""


def write_scene(folder: Path, kind: str = "plain") -> None:
    """Write three photographs with cameras, as plain transforms or in TensoIR's layout."""
    folder.mkdir(parents=True)
    image = Image.fromarray(np.full((16, 16, 4), 200, np.uint8))
    poses = [look_at(np.array(place)).tolist() for place in ((4.0, 0, 0), (0, 4.0, 0), (0, 0.1, 4.0))]
    frames = []
    for i, pose in enumerate(poses):
        image.save(folder / f"{i}.png")
        frames.append({"file_path": f"{i}.png", "transform_matrix": pose})
        for split in ("train", "test") if kind == "tensoir" else ():
            view = folder / f"{split}_{i:03d}"
            view.mkdir()
            for name in ("rgba", "albedo", "normal"):
                image.save(view / f"{name}.png")
            said = {"cam_transform_mat": ",".join(str(v) for row in pose for v in row), "cam_angle_x": 0.7, "imw": 16, "imh": 16}
            (view / "metadata.json").write_text(json.dumps(said))
    if kind == "plain":
        (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))


@pytest.fixture
def bench(tmp_path, monkeypatch, script):
    """Return a function that runs the script on two scenes of TensoIR, another one and a damaged one, and returns its status."""
    root = tmp_path / "datasets"
    write_scene(root / "tensoir" / "hotdog", "tensoir")
    write_scene(root / "tensoir" / "lego", "tensoir")
    write_scene(root / "mine")
    write_scene(root / "relight_gt" / "mine_golf")
    (root / "empty").mkdir()
    (root / "torn").mkdir()
    (root / "torn" / "transforms.json").write_text("{")
    (tmp_path / "stub.py").write_text(STUB)
    Image.fromarray(np.zeros((40, 90, 3), np.uint8)).save(tmp_path / "sheet.png")
    monkeypatch.setattr(work, "LAUNCHER", tmp_path / "stub.py")
    return lambda *words: script("reproduce").main([str(root), "-o", str(tmp_path / "out"), "--preset", "draft", *words])


def commands(tmp_path: Path) -> list[str]:
    return [line.split()[0] for line in (tmp_path / "commands.txt").read_text().splitlines()]


def test_a_benchmark_ends_in_tables_with_published_rows(bench, tmp_path, capsys):
    (tmp_path / "well").touch()
    assert bench("--scenes", "tensoir_hotdog,tensoir_lego,mine", "--views", "2", "--set", "seed=3") == 0
    text = capsys.readouterr().out
    assert (tmp_path / "out" / "tables.md").read_text() in text
    first = (tmp_path / "commands.txt").read_text().splitlines()[0]
    assert first.startswith("reconstruct") and first.endswith("--preset draft --set seed=3")
    assert "--protocol irgs --views 2" in (tmp_path / "commands.txt").read_text()
    tensoir, other = json.loads((tmp_path / "out" / "tables.json").read_text())
    assert other["title"] == "Other scenes (protocol plain)" and "Protocol plain: x." in other["notes"]
    rows = {(row["of"], row["by"]): row for row in tensoir["rows"]}
    assert rows["mean", "IRGS"]["figures"]["relight_psnr"] == 30.63 and rows["mean", "IRGS"]["source"] == "IRGS++ paper"
    ours = rows["mean of 2", "ours, draft"]["figures"]
    assert ours == {"nvs_psnr": 36.0, "relight_psnr": 31.0, "normal_mae_full": 4.0, "hours": 0.025}
    assert rows["tensoir_lego", "ours, draft"]["figures"]["relight_psnr"] == 32
    assert "relit, full frame, dB ↑" in tensoir["columns"].values() and "mesh_chamfer" not in tensoir["columns"]
    assert any("Ours is not a mean over the published scenes (armadillo, ficus, hotdog, lego)" in note for note in tensoir["notes"])
    html = (tmp_path / "out" / "tables.html").read_text()
    assert html.count("<img") == 3 and set(re.findall(r'src="([^"]{5})', html)) == {"data:"} and html.count('class="ours"') == 5


def test_what_is_done_is_not_done_again_and_what_failed_is(bench, tmp_path, capsys):
    assert bench() == 1
    text = capsys.readouterr().out
    assert "| tensoir_lego | ours, draft | no run: lego: no surface | – |" in text and "mean of 1" in text
    assert "transforms.json" in (tmp_path / "out" / "tables.html").read_text()  # the damaged one is told of
    assert commands(tmp_path) == ["reconstruct", "evaluate"] * 2 + ["reconstruct"]
    (tmp_path / "well").touch()
    assert bench() == 1  # still one that is damaged
    assert commands(tmp_path)[5:] == ["reconstruct", "evaluate"]


def test_scenes_are_found_by_their_content(bench, script, tmp_path):
    found = script("reproduction.scenes").find_scenes(tmp_path / "datasets")
    assert [(scene.name, scene.format) for scene in found] == [
        ("mine", "transforms"),
        ("tensoir_hotdog", "tensoir"),
        ("tensoir_lego", "tensoir"),
        ("torn", ""),
    ]
    assert found[3].trouble and found[1].known_as == "hotdog"


@pytest.mark.parametrize(
    ("words", "said"), [(["--scenes", "chair"], "unknown scene chair; use mine, tensoir_hotdog"), (["--set", "seeds=1"], "--set: .*seed")]
)
def test_bad_wishes_start_nothing(bench, tmp_path, capsys, words, said):
    assert bench(*words) == 2
    assert re.search(said.replace("--set: ", ""), capsys.readouterr().err)
    assert not (tmp_path / "out").exists() and not (tmp_path / "commands.txt").exists()


def test_a_root_without_scenes(script, tmp_path, capsys):
    assert script("reproduce").main([str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert "no dataset in it or below" in capsys.readouterr().err


def test_published_tables_are_whole(script):
    """Each table has a known protocol and headings for all its metrics; each row names its source."""
    tables = script("reproduction.tables")
    for known in tables.PUBLISHED.values():
        assert known["protocol"] in script("reproduce").PROTOCOLS and known["title"]
        for row in known.get("rows", []):
            assert row["source"] and row["method"]
            for figures in (row["figures"], *row.get("scenes", {}).values()):
                assert figures.keys() <= known["columns"].keys()
    glossy = tables.PUBLISHED["glossy-synthetic"]
    scenes = glossy["rows"][0]["scenes"]
    assert set(scenes) == set(glossy["scenes"])
    mean = np.mean([figures["relight_psnr_scaled"] for figures in scenes.values()])
    assert mean == pytest.approx(glossy["rows"][0]["figures"]["relight_psnr_scaled"], abs=0.006)  # as the paper rounds


def test_scenes_of_a_paper_have_its_rows_beside_them(script):
    tables = script("reproduction.tables")
    report = {"figures": {"relight_psnr": 20.0, "relight_psnr_scaled": 25.5}, "protocol": [], "choices": {"name": "glossy"}}
    result = tables.Result("glossy_cat_blender", "cat", "glossy-synthetic", report)
    (table,) = tables.tables_of([result], "ours")
    assert [(row.of, row.by) for row in table.rows[-2:]] == [("glossy_cat_blender", "IRGS++, 512 samples"), ("glossy_cat_blender", "ours")]
    assert table.rows[-2].figures["relight_psnr_scaled"] == 27.21
    (table,) = tables.tables_of([replace(result, stand_in=True)], "ours")
    assert [row.by for row in table.rows if row.of == result.scene] == ["ours"]  # the published cat is another one
    assert "stand-ins" in table.title and any("can't be compared" in note for note in table.notes)


def test_protocols_are_never_mixed_in_a_table(script):
    tables = script("reproduction.tables")
    results = [
        tables.Result(name, name, "tensoir", {"figures": {"relight_psnr": value}, "protocol": [], "choices": {"name": protocol}})
        for name, value, protocol in (("lego", 30.0, "irgs"), ("hotdog", 25.0, "plain"))
    ]
    irgs, plain = tables.tables_of(results, "ours")
    assert irgs.title == "TensoIR synthetic (protocol irgs)" and plain.title == "TensoIR synthetic (protocol plain)"
    assert {row.of for row in irgs.rows} == {"mean", "mean of 1", "lego"} and {row.of for row in plain.rows} == {
        "mean",
        "mean of 1",
        "hotdog",
    }
    assert any(note.startswith("Ours are by protocol plain, published rows by irgs") for note in plain.notes)
    assert "lego has no true albedo, true normals, true light." in irgs.notes


def test_a_changed_setting_evaluates_again_and_so_does_a_newer_run(bench, tmp_path):
    (tmp_path / "well").touch()
    only = ("--scenes", "mine")
    assert bench(*only) == bench(*only) == 0
    assert commands(tmp_path) == ["reconstruct", "evaluate"]
    assert bench(*only, "--set", "seed=4") == 0
    assert commands(tmp_path) == ["reconstruct", "evaluate"] * 2
    later = time.time() + 100
    os.utime(tmp_path / "out" / "runs" / "mine" / "run.json", (later, later))
    assert bench(*only, "--set", "seed=4") == 0
    assert commands(tmp_path) == ["reconstruct", "evaluate"] * 2 + ["evaluate"]
