# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark: no measurement is lost or repeated, and the report contains all of them."""

import importlib
import json
import os
import signal
from types import SimpleNamespace

import numpy as np
import pytest
from irgspp.core.cli.parser import parser
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.relight.sample_counts import sample_counts
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from scripts_folder import script as script


def section(*tasks, name="things"):
    """Return a section of these tasks with a table of its metrics."""

    def blocks(results):
        module = importlib.import_module("benchmarks.section")
        yield module.Table("Found", ["", "value ↑"], [[r.configuration, r.figures["value"]] for r in results.records()])
        points = [r.figures["value"] for r in results.records()]
        yield module.Chart("Curve", "x", "y", {"": [module.Series("things", points, points)]}, image="benchmark_things")
        shown = [[(name, file) for name, file in r.images.items()] for r in results.records()]
        yield module.Images("Seen", shown)
        yield module.Note("Worse than <others>.")

    return SimpleNamespace(NAME=name, TITLE="Things", ABOUT="Of things.", ONCE=True, tasks=lambda bench, scene: iter(tasks), blocks=blocks)


@pytest.fixture
def work(script, tmp_path, capsys):
    """Return a function that does a section's tasks with the results in the folder, and returns the store and the number of failures."""

    def do(one, source="abc"):
        session = script("benchmarks.session")
        bench = script("benchmarks.bench").Bench(tmp_path, [])
        store = script("benchmarks.store").Store(
            tmp_path, {"cpu": "any", "threads": 2, "simd": [], "versions": {"engine's source": source}}
        )
        return store, session.Session(bench, store).work(session.steps_of(bench, [one]))

    return do


@pytest.fixture
def task(script):
    """Return a function that makes a task, which records that it is done, from a name and the value it finds or raises."""

    def make(name, value, done):
        def measure():
            done.append(name)
            if isinstance(value, BaseException):
                raise value
            image = np.full((4, 4, 3), 200, np.uint8)
            return script("benchmarks.section").Measurement({"value": value}, {"rays": 7}, {"seen": image})

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
    assert (store.folder / record.images["seen"]).is_file()


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


def test_sigterm_stops_as_ctrl_c_does(script, tmp_path, monkeypatch, capsys):
    benchmark = script("benchmark")
    monkeypatch.setattr(benchmark, "scenes_of", lambda args: [])
    monkeypatch.setattr(benchmark.Session, "work", lambda self, steps: os.kill(os.getpid(), signal.SIGTERM))
    before = signal.getsignal(signal.SIGTERM)
    try:
        _, status = benchmark.measure(benchmark.arguments(["--quick", "-o", str(tmp_path)]), [])
    finally:
        signal.signal(signal.SIGTERM, before)
    assert status == 130 and "the same command continues" in capsys.readouterr().err


def test_a_figure_that_is_no_number_is_kept_as_text(work, task):
    store, _ = work(section(task("one", float("inf"), [])))
    assert store.records["things", "-", "one"].figures == {"value": "inf"}


def test_the_report_holds_everything_itself(work, task, script, tmp_path):
    store, _ = work(section(task("one", 1.25, []), task("two", 2.0, []), task("bad", ValueError("broke"), [])))
    store.scenes["ball"] = {"glossy": True, "size": 64}
    text = script("benchmarks.page").write(store, [section()]).read_text()
    assert "<svg" in text and "data:image/jpeg;base64," in text and "<td>1.25</td>" in text
    assert "Worse than &lt;others&gt;." in text and "ValueError: broke" in text and "ball (glossy, 64 px)" in text
    assert 'src="pictures' not in text and "http" not in text.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
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


def test_sections_tell_their_engines_apart_where_there_are_several(work, task, script):
    page, (old, new) = script("benchmarks.page"), (section(task(name, 1.0, []), name=name) for name in ("old", "new"))
    store, _ = work(old, source="abc")
    assert page.engines(store, old) == ""
    store, _ = work(new, source="def")
    assert page.engines(store, old) == "Measured on the engine of source abc."
    assert page.engines(store, new) == "Measured on the engine of source def."
    assert page.engines(store, new) in page.write(store, [old, new]).read_text()


def test_results_of_something_else_are_refused(script, tmp_path):
    (tmp_path / "results.json").write_text("[1]")
    with pytest.raises(InputError, match="does not hold results of a benchmark"):
        script("benchmarks.store").Store(tmp_path)


# --- scenes and reconstructions


def test_scenes_are_found_in_folders(script, tmp_path):
    scenes = script("benchmarks.scenes")
    (tmp_path / "all").mkdir()
    (tmp_path / "all" / "demo").symlink_to(DEMO_DATA)
    assert [scene.name for scene in scenes.find_scenes([tmp_path / "all"])] == ["demo"]
    with pytest.raises(InputError, match="is neither a scene"):
        scenes.find_scenes([tmp_path])
    with pytest.raises(InputError, match="two scenes have the same name"):
        scenes.find_scenes([tmp_path / "all", tmp_path / "all" / "demo"])


def test_every_section_lists_tasks_that_the_command_line_understands(script, tmp_path):
    """Names are unique, listing measures nothing, and plans of reconstructions are valid options."""
    benchmark, bench = script("benchmark"), script("benchmarks.bench")
    scene = script("benchmarks.scenes").demo_scenes()[0]
    steps = script("benchmarks.session").steps_of(bench.Bench(tmp_path, [scene]), benchmark.sections_of(",".join(benchmark.SECTIONS)))
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
    """It fails in a process of its own; the error has the job's last line."""
    bench = script("benchmarks.bench").Bench(tmp_path, script("benchmarks.scenes").demo_scenes())
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


def test_of_the_system_the_report_says_its_version_and_no_more(script, monkeypatch):
    bench = script("benchmarks.bench")
    monkeypatch.setattr(bench.platform, "system", lambda: "Linux")
    monkeypatch.setattr(bench.platform, "release", lambda: "6.12.48+deb13-cloud-amd64")
    for library, expected in ((("glibc", "2.41"), "Linux 6.12, glibc 2.41"), (("", ""), "Linux 6.12")):
        monkeypatch.setattr(bench.platform, "libc_ver", lambda library=library: library)
        assert bench.machine()["versions"]["platform"] == expected


@pytest.mark.parametrize("quick", [False, True])
def test_irgs_is_trained_and_relit_as_its_own_method(script, tmp_path, quick):
    """Its own BRDF, start and sampling, whatever the object's class; `--quick` shortens it as all others."""
    bench = script("benchmarks.bench").Bench(tmp_path, script("benchmarks.scenes").demo_scenes(), quick)
    baseline = script("benchmarks.irgs_baseline")
    plan = script("benchmarks.reconstruction").plans(bench, bench.scenes[0])[baseline.NAME]
    settings = with_overrides(preset(plan.preset), plan.options)
    second = settings.second
    assert (second.solver, second.brdf, second.geometry_rate, second.sampling) == ("joint", "irgs", 0, "stratified")
    assert (second.joint_iterations, second.samples) == ((40, 32) if quick else (800, 64))
    assert plan.materials == "" and settings.materials == "auto"
    _, variant, samples = script("benchmarks.reconstruction").HEADLINE[baseline.NAME]
    relight = RelightSettings(samples, variant.sampling, variant.denoise, **dict(variant.others))
    assert sample_counts(samples, False, relight.allocation) == sample_counts(samples, True, relight.allocation) == (512, 0, 256)
    assert not relight.transfer and not relight.ratio and relight.brdf is None and variant.backend == "gaussian"
    assert f"one of {20_000 * 256 / (800 * 64):.0f} rays" in baseline.ABOUT
