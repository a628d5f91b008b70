# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark: directions that must hold, and that no measurement is lost or made twice."""

import importlib
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.datasets.camera import Camera, look_at
from irgspp.core.datasets.dataset import Bound
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.options import parser
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.relight.lighting import prepare
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.ply import save_mesh_ply
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.shading.lights import LIGHTS
from irgspp.core.stages.hull import disks
from sphere_run import sphere

SCRIPTS = Path(__file__).parents[2] / "scripts"
BALLS = ((np.zeros(3), 1.0), (np.array([1.1, -0.4, 0.9]), 0.45))  # they shade each other
MATERIAL = (0.7, 0.5, 0.3, 0.5, 0.0)


@pytest.fixture(scope="module")
def script():
    """A module of the benchmark by name."""
    sys.path.insert(0, str(SCRIPTS))
    yield lambda name: importlib.import_module(name)
    sys.path.remove(str(SCRIPTS))


def write_balls(folder: Path, material: tuple[float, ...]) -> Path:
    """A run's Gaussians, light and mesh: two balls of one material."""
    meshes, splats = [], None
    for centre, radius in BALLS:
        one, count = sphere(48, 96), int(9000 * radius)
        z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * 2.39996322972865
        normal = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
        spacing = np.full(count, radius * np.sqrt(4 * np.pi / count))
        some = disks(centre + radius * normal, normal, np.full((count, 3), 0.5), spacing, 0.99)
        splats = some if splats is None else splats.joined(some)
        meshes.append((one, (centre + radius * one.vertices).astype(np.float32)))
    assert splats is not None
    splats.material = torch.logit(torch.tensor(material).clamp(1e-6, 1 - 1e-6))[:, None].repeat(1, splats.count)
    Reconstruction(splats, torch.full((16, 32, 3), 0.5), Bound((0, 0, 0), 2.0), np.eye(4)).save(folder)
    faces = np.concatenate([one.faces + i * len(one.vertices) for i, (one, _) in enumerate(meshes)])
    n = sum(len(one.vertices) for one, _ in meshes)
    shape = [np.concatenate(parts) for parts in zip(*((v, one.normals, one.uvs) for one, v in meshes), strict=True)]
    filled = [np.full(n, value, np.float32) for value in material[3:]]
    save_mesh_ply(Mesh(*shape, faces, np.tile(np.float32(material[:3]), (n, 1)), *filled), folder / "mesh.ply")
    return folder


def place(script, light: np.ndarray):
    """What a camera sees of the balls under a light; the true picture is left out."""
    camera = Camera(48, 48, 60.0, 60.0, 24.0, 24.0, look_at((1.5, -4.0, 2.0), (0.4, -0.1, 0.3)))
    inside = np.ones((48, 48), bool)
    return script("benchmarks.studio").Place(SimpleNamespace(camera=camera), "light", prepare(light), np.zeros((48, 48, 3)), inside)


@pytest.fixture(scope="module")
def studio(script, tmp_path_factory):
    """The balls in the sun."""
    run = write_balls(tmp_path_factory.mktemp("balls"), MATERIAL)
    light = LIGHTS["sunset"](32, 64)
    return script("benchmarks.studio").Studio(run, [place(script, light)], {"mesh": 2048, "gaussian": 1024})


@pytest.fixture(scope="module")
def error(script, studio):
    """Root mean square error of a way of section relighting at so many samples."""
    ways = script("benchmarks.relighting").WAYS
    return lambda way, samples: studio.errors(ways[way], samples)["rms_error"]


def test_light_sampling_beats_strata(error, script):
    few = error("without denoiser", 64)
    assert few < 0.5 * error(script("benchmarks.relighting").PLAIN, 64)
    assert error("full", 16) < error("without MIS", 16)


def test_the_denoiser_helps_where_samples_are_few(error):
    assert error("full", 16) < 0.9 * error("without denoiser", 16)


def test_error_falls_with_samples_as_it_should(error):
    counts = (16, 64, 256)
    errors = [error("without denoiser", n) for n in counts]
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert -1.1 < slope < -0.4  # -1/2 for random samples, up to -1 for strata of something smooth


def test_both_backends_show_the_same(studio):
    mesh, gaussian = (studio.converged(backend, 0) for backend in ("mesh", "gaussian"))
    assert mesh.max() > 0.3
    assert np.abs(mesh - gaussian).mean() < 0.01


def test_indirect_light_comes_closer_to_the_truth(script, tmp_path):
    """In an even light what absorbs nothing is as bright as the light, wherever it is: no shadow between the balls stays."""
    studio = script("benchmarks.studio")
    run = write_balls(tmp_path, (1.0, 1.0, 1.0, 0.9, 0.0))
    one = studio.Studio(run, [place(script, np.full((16, 32, 3), 0.5, np.float32))], {"mesh": 64, "gaussian": 64})
    dark = []
    for indirect in (True, False):
        relighter = one.relighter(studio.Way(denoise="off", indirect=indirect), 256)
        rgba = relighter.relit(relighter.surface(one.places[0].view.camera), one.places[0].prepared).numpy()
        solid = rgba[..., 3] > 0.99
        dark.append(np.abs(rgba[solid][:, :3] - 0.5).mean())
    assert solid.sum() > 300
    assert dark[0] < 0.5 * dark[1]


# --- records


def section(*tasks, name="things"):
    """A section of these tasks, and a table of its figures."""

    def blocks(results):
        module = importlib.import_module("benchmarks.section")
        yield module.Table("Found", ["", "value ↑"], [[r.configuration, r.figures["value"]] for r in results.records()])
        points = [r.figures["value"] for r in results.records()]
        yield module.Chart("Curve", "x", "y", {"": [module.Series("things", points, points)]}, picture="benchmark_things")
        shown = [[(name, file) for name, file in r.pictures.items()] for r in results.records()]
        yield module.Pictures("Seen", shown)
        yield module.Note("Worse than <others>.")

    return SimpleNamespace(NAME=name, TITLE="Things", ABOUT="Of things.", ONCE=True, tasks=lambda bench, scene: iter(tasks), blocks=blocks)


@pytest.fixture
def work(script, tmp_path, capsys):
    """Do a section's tasks with the results of the folder: the store, and how many failed."""

    def do(one):
        session = script("benchmarks.session")
        bench = script("benchmarks.bench").Bench(tmp_path, [])
        store = script("benchmarks.store").Store(tmp_path, {"cpu": "any", "threads": 2, "simd": [], "versions": {}})
        return store, session.Session(bench, store).work(session.steps_of(bench, [one]))

    return do


@pytest.fixture
def task(script):
    """A task that notes when it is done: (name, what it finds or raises, notes) to a task."""

    def make(name, value, done):
        def measure():
            done.append(name)
            if isinstance(value, BaseException):
                raise value
            picture = np.full((4, 4, 3), 200, np.uint8)
            return script("benchmarks.section").Measurement({"value": value}, {"rays": 7}, {"seen": picture})

        return script("benchmarks.section").Task(name, measure)

    return make


def test_what_is_measured_is_not_measured_again(work, task):
    done = []
    things = section(task("one", np.float32(1.5), done), task("two", 2.0, done))
    work(things)
    store, failures = work(things)
    assert done == ["one", "two"] and failures == 0
    record = store.records["things", "-", "one"]
    assert (record.figures, record.counted, record.status) == ({"value": 1.5}, {"rays": 7}, "done")
    assert store.environments[record.environment]["threads"] == 2
    assert (store.folder / record.pictures["seen"]).is_file()


def test_a_failure_is_noted_and_the_rest_goes_on(work, task, tmp_path):
    done = []
    _, failures = work(section(task("bad", ValueError("no\nsuch thing"), done), task("good", 1.0, done)))
    assert failures == 1 and done == ["bad", "good"]
    record = json.loads((tmp_path / "results.json").read_text())["records"][0]
    assert (record["status"], record["error"]) == ("failed", "ValueError: no such thing")
    assert "Traceback" in (tmp_path / "failures.log").read_text()
    _, failures = work(section(task("bad", 3.0, done), task("good", 1.0, done)))
    assert failures == 0 and done == ["bad", "good", "bad"]  # what failed is tried again


def test_an_interruption_loses_nothing(work, task, script, tmp_path):
    done = []
    with pytest.raises(KeyboardInterrupt):
        work(section(task("one", 1.0, done), task("two", KeyboardInterrupt(), done), task("three", 3.0, done)))
    assert script("benchmarks.store").Store(tmp_path).done(("things", "-", "one"))
    work(section(task("one", 1.0, done), task("two", 2.0, done), task("three", 3.0, done)))
    assert done == ["one", "two", "two", "three"]


def test_a_figure_that_is_no_number_is_kept_as_text(work, task):
    store, _ = work(section(task("one", float("inf"), [])))
    assert store.records["things", "-", "one"].figures == {"value": "inf"}


def test_the_report_holds_everything_itself(work, task, script, tmp_path):
    store, _ = work(section(task("one", 1.25, []), task("two", 2.0, []), task("bad", ValueError("broke"), [])))
    store.scenes["ball"] = {"glossy": True, "size": 64}
    text = script("benchmarks.page").write(store, [section()]).read_text()
    assert "<svg" in text and "data:image/jpeg;base64," in text and "<td>1.25</td>" in text
    assert "Worse than &lt;others&gt;." in text and "ValueError: broke" in text and "ball (glossy, 64 px)" in text
    assert "src='pictures" not in text and "http" not in text.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    ).replace("https://matplotlib.org", "")
    store.write_tables()
    header, row, *_ = (tmp_path / "things.csv").read_text().splitlines()
    assert header.startswith("scene,configuration,status") and row.startswith("-,one,done") and ",1.25," in row


def test_documents_are_written_between_their_marks(work, task, script, tmp_path):
    store, _ = work(section(task("one", 1.25, []), name="skipping"))
    (tmp_path / "pictures").mkdir(exist_ok=True)
    (tmp_path / "skipping.md").write_text("# Rules\n\nBy hand.\n")
    documents = script("benchmarks.documents")
    for _ in range(2):  # the second time replaces what the first wrote
        documents.write(store, [section(name="skipping")], tmp_path)
    page = (tmp_path / "skipping.md").read_text()
    assert page.startswith("# Rules\n\nBy hand.\n") and page.count("| one | 1.25 |") == 1
    page = (tmp_path / "benchmark.md").read_text()
    assert "## Things" in page and "| one | 1.25 |" in page and "![Curve](pictures/benchmark_things.png)" in page
    assert (tmp_path / "pictures" / "benchmark_things.png").is_file()


def test_results_of_something_else_are_refused(script, tmp_path):
    (tmp_path / "results.json").write_text("[1]")
    with pytest.raises(InputError, match="is no benchmark's results"):
        script("benchmarks.store").Store(tmp_path)


# --- scenes and reconstructions


def test_scenes_are_found_in_folders(script, tmp_path):
    scenes = script("benchmarks.scenes")
    (tmp_path / "all").mkdir()
    (tmp_path / "all" / "demo").symlink_to(DEMO_DATA)
    assert [scene.name for scene in scenes.named([tmp_path / "all"])] == ["demo"]
    with pytest.raises(InputError, match="is no scene"):
        scenes.named([tmp_path])
    with pytest.raises(InputError, match="one name"):
        scenes.named([tmp_path / "all", tmp_path / "all" / "demo"])


def test_every_section_lists_tasks_that_the_command_line_understands(script, tmp_path):
    """Names are unique, nothing is measured by listing, and plans of reconstructions are valid options."""
    benchmark, bench = script("benchmark"), script("benchmarks.bench")
    scene = script("benchmarks.scenes").embedded()[0]
    steps = script("benchmarks.session").steps_of(bench.Bench(tmp_path, [scene]), benchmark.chosen(",".join(benchmark.SECTIONS)))
    assert len({step.key for step in steps}) == len(steps) > 50
    plans = {plan for step in steps for plan in step.task.runs}
    assert len({plan.label for plan in plans}) == len(plans) > 3
    for plan in plans:
        parser().parse_args(["reconstruct", "photos", "-o", "run", *plan.words()])
    assert not list(tmp_path.iterdir())


def test_a_plan_is_not_taken_for_another(script, tmp_path):
    runs = script("benchmarks.runs")
    plan, run = runs.RunPlan("a"), tmp_path / "a"
    run.mkdir()
    phase = {"seconds": 2.0, "peak_memory": 5, "finished": True}
    (run / "run.json").write_text(json.dumps({"status": "done", "settings": {}, "phases": {"read": phase}}))
    about = {"plan": runs._plan(plan, DEMO_DATA), "done": True, "process_seconds": 3.0, "cpu_seconds": 4.0}
    (tmp_path / "a.json").write_text(json.dumps(about))
    found = runs.finished(plan, DEMO_DATA, run)
    assert (found.seconds, found.cpu_seconds, found.peak_memory) == (2.0, 4.0, 5)
    assert runs.finished(runs.RunPlan("a", options=("seed=1",)), DEMO_DATA, run) is None
    assert runs.finished(plan, tmp_path, run) is None


def test_a_reconstruction_that_fails_is_tried_once(script, tmp_path, monkeypatch):
    """In a process of its own it has no say; the error is the job's own line."""
    bench = script("benchmarks.bench").Bench(tmp_path, script("benchmarks.scenes").embedded())
    plan, tried = script("benchmarks.runs").RunPlan("bad", options=("nonsense=1",)), []
    make = script("benchmarks.runs").make
    monkeypatch.setattr(script("benchmarks.runs"), "make", lambda *args: tried.append(1) or make(*args))
    for _ in range(2):
        with pytest.raises(IrgsppError, match=r"ended with status 2: irgspp: .*nonsense"):
            bench.run(bench.scenes[0], plan)
    assert len(tried) == 1 and not bench.has_run(bench.scenes[0], plan)


def test_bad_usage_ends_with_a_line(script, tmp_path, capsys):
    main = script("benchmark").main
    assert main([str(tmp_path / "none"), "-o", str(tmp_path / "out")]) == 2
    assert main(["--sections", "nonsense", "-o", str(tmp_path)]) == 2
    assert main(["--report-only", "-o", str(tmp_path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3 and all(line.startswith("benchmark: ") for line in lines)


# --- what sections make of their records


@pytest.fixture
def shown(script, tmp_path):
    """Blocks of a section for (configuration, figures) of one scene: kind of block to those blocks."""

    def show(name, records):
        module, store = script(f"benchmarks.{name}"), script("benchmarks.store")
        kept = store.Store(tmp_path)
        for configuration, figures in records.items():
            kept.add(store.Record(name, "ball", configuration, figures=figures, counted={"samples": 1}))
        found = {}
        for block in module.blocks(store.Results(kept, name)):
            found.setdefault(type(block).__name__, []).append(block)
        return found

    return show


def test_skipped_work_is_told_as_what_it_saves_and_what_it_costs(shown):
    job = {"chosen": "", "evidence": "", "cpu_seconds": 1.0}
    records = {
        "auto": {**job, "seconds": 80.0, "relight_psnr": 30.0, "normal_mae": 2.5},
        "all off": {**job, "seconds": 100.0, "relight_psnr": 30.1, "normal_mae": 2.4},
        "trials": {**job, "chosen": "on", "evidence": "0.9 dB behind", "seconds": 90.0, "relight_psnr": 30.0, "normal_mae": 2.5},
        "converged": {"chosen": "off", "evidence": "still gaining"},
    }
    together, alone = shown("skipping", records)["Table"]
    row = dict(zip(together.columns, together.rows[0], strict=True))
    assert (row["seconds with ↓"], row["saved"]) == (80.0, "20 %")
    assert (row["relit dB ↑ added"], row["normals ° ↓ added"]) == ("-0.10", "+0.10")
    rows = {row[0]: row for row in alone.rows}
    assert rows["converged, ball"][-1] == "kept: still gaining" and rows["converged, ball"][1] is None
    assert rows["trials, ball"][3] == "11 %" and rows["trials, ball"][-1] == "0.9 dB behind"


def test_time_budgets_are_curves_beside_the_presets(shown):
    figures = {
        "relight_psnr": 30.0,
        "nvs_psnr": 31.0,
        "normal_mae": 3.0,
        "cpu_seconds": 1.0,
        "peak_memory_bytes": 2**30,
        "read_seconds": 0.5,
    }
    records = {f"balanced, {m} min": {**figures, "seconds": 60.0 * m, "relight_psnr": 28.0 + m} for m in (2, 1)}
    records |= {"balanced": {**figures, "seconds": 110.0}, "without indirect light": {**figures, "seconds": 100.0, "relight_psnr": 29.0}}
    blocks = shown("reconstruction", records)
    curves = {series.label: series for series in blocks["Chart"][0].panels["ball"]}
    assert (list(curves["balanced --time"].x), list(curves["balanced --time"].y)) == ([60.0, 120.0], [29.0, 30.0])
    assert (list(curves["balanced"].x), curves["balanced"].line) == ([110.0], False)
    parts = next(table for table in blocks["Table"] if "2DGRT" in table.title)
    assert [row[:3] for row in parts.rows] == [["ball, balanced", 110.0, 30.0], ["ball, without indirect light", 100.0, 29.0]]


def test_the_slope_of_random_samples_is_told(shown):
    points = {n: {"samples": n, "rms_error": n**-0.5, "converged_psnr": 30.0, "seconds": 0.1, "true_psnr": 20.0} for n in (16, 64, 256)}
    blocks = shown("relighting", {f"without denoiser, {n} samples": figures for n, figures in points.items()})
    table = next(t for t in blocks["Table"] if "slope (−0.5: Monte Carlo)" in t.columns)
    assert table.rows[0][table.columns.index("slope (−0.5: Monte Carlo)")] == pytest.approx(-0.5)
