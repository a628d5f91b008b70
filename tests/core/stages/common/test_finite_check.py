# SPDX-License-Identifier: GPL-3.0-or-later
"""A value that is not finite ends the job with status 1 and one line, and keeps the checkpoint before it."""

import math
import shutil
from pathlib import Path

import pytest
import torch
from irgspp.core import pipeline
from irgspp.core.cli.main import main
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import Cancelled
from irgspp.core.run_folder import read_run
from irgspp.core.settings.schema import preset
from irgspp.core.stages.first import trainer as trainer_module
from irgspp.core.stages.first.trainer import Trainer
from irgspp.core.stages.second import radiance_refit, solve
from irgspp.core.stages.second.refinement.refinement import Refinement
from irgspp.core.stages.second.solver import light_materials
from irgspp.core.stages.second.solver.light_material_solver import LightMaterialSolver
from small_scenes import small_scene
from unwrapped_here import unwrap_here

SCENE = small_scene("bowl")  # it has half as many views as the demo's
SETTINGS = [
    "first.stereo=off",
    "first.iterations=8",
    "first.gaussians=600",
    "first.light_height=16",
    "surface.voxels=32",
    "surface.triangles=1000",
    "surface.texture=64",
]
SETTINGS += [
    "second.points=100",
    "second.views=4",
    "second.rows=4",
    "second.iterations=4",
    "second.pixels=32",
    "second.samples=8",
    "second.pool=1000",
    "second.radiance_iterations=4",
]
SETTINGS += ["second.normal_iterations=4"]
FINISHED = {"read", "first stage", "geometry"}  # phases before the second stage
FAULT = 5  # the iteration in which a value becomes non-finite
COMMAND = [str(SCENE), "--preset", "draft", *(word for setting in SETTINGS for word in ("--set", setting))]


@pytest.fixture(scope="module", autouse=True)
def read_once():
    """Read the dataset once for all jobs, leave the Blender scene out of them, and unwrap here."""
    data = load_dataset(SCENE, preset("draft").data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline, "load_dataset", lambda path, *_: {SCENE: data}[path])
        patch.setattr(pipeline, "write_blend", lambda *_: None)
        unwrap_here(patch)
        yield


def bad_gradient(trainer: Trainer, name: str) -> None:
    """Make one gradient of this iteration infinite."""
    trainer.optimizer.leaves[name].register_hook(lambda g: g.reshape(-1).index_fill(0, torch.tensor([11]), math.inf).view_as(g))


def bad_value(trainer: Trainer, name: str) -> None:
    with torch.no_grad():
        trainer.optimizer.leaves[name].view(-1)[11] = math.nan


@pytest.fixture
def breaking(monkeypatch):
    """Break a parameter right before iteration FAULT; every iteration writes a checkpoint."""
    step = Trainer.step
    monkeypatch.setattr(trainer_module, "CHECKPOINT_SECONDS", -1.0)

    def install(fault, name: str) -> None:
        def broken(self: Trainer) -> float:
            if self.done == FAULT - 1:
                fault(self, name)
            return step(self)

        monkeypatch.setattr(Trainer, "step", broken)

    return install


@pytest.mark.parametrize(
    ("fault", "name", "message", "materials"),
    [
        (bad_gradient, "position", f"position is not finite after iteration {FAULT}", "low-gloss"),
        (bad_gradient, "sh", f"sh_dc is not finite after iteration {FAULT}", "low-gloss"),
        (bad_value, "opacity", f"opacity is not finite after iteration {FAULT}", "low-gloss"),
        (bad_value, "material", f"albedo is not finite after iteration {FAULT - 1}", "glossy"),  # the image already shows it
    ],
)
def test_the_last_good_checkpoint_is_kept(breaking, tmp_path, capsys, fault, name, message, materials):
    breaking(fault, name)
    run = tmp_path / "run"
    arguments = ["reconstruct", *COMMAND, "-o", str(run), "--materials", materials, "--set", "first.trial_iterations=1"]
    assert main(arguments) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if "not finite" in line]
    assert len(lines) == 1 and message in lines[0]
    state = read_run(run)
    assert state["status"] == "failed" and message in state["error"]
    saved = torch.load(run / "checkpoint" / "first_stage.pt", weights_only=True)
    assert saved["done"] == FAULT - 1
    assert all(torch.isfinite(v).all() for v in saved["optimizer"]["values"].values())
    assert not (run / "gaussians.ply").exists()


def bad_light(monkeypatch):
    """Make the light NaN in step 3 of the second stage."""
    step = LightMaterialSolver._step

    def broken(self, done):
        step(self, done)
        if done == 2:
            self.light[11, 1] = math.nan

    monkeypatch.setattr(LightMaterialSolver, "_step", broken)


def bad_roughness(monkeypatch):
    """Make the first search return an infinite roughness."""
    search = LightMaterialSolver._search_materials

    def broken(self, done):
        search(self, done)
        self.roughness[5] = math.inf

    monkeypatch.setattr(LightMaterialSolver, "_search_materials", broken)


def bad_tracing(monkeypatch):
    trace = light_materials.trace_radiance_transfer

    def broken(*args, **options):
        transfer = trace(*args, **options)
        transfer.indirect[7] = math.nan
        return transfer

    monkeypatch.setattr(light_materials, "trace_radiance_transfer", broken)


def bad_assignment(monkeypatch):
    assign_materials = solve.assign_materials

    def broken(*args, **options):
        materials = assign_materials(*args, **options)
        materials[2, 9] = math.nan
        return materials

    monkeypatch.setattr(solve, "assign_materials", broken)


def bad_refinement(monkeypatch):
    """Make one albedo NaN before the second iteration."""
    loss = Refinement._loss

    def broken(self):
        if self.optimizer.iteration == 1:
            with torch.no_grad():
                self.optimizer.leaves["material"][1, 5] = math.nan
        return loss(self)

    monkeypatch.setattr(Refinement, "_loss", broken)


def bad_radiance(monkeypatch):
    """Make the loss of the images infinite."""
    monkeypatch.setattr(radiance_refit, "photometric_loss", lambda image, photograph: image.sum() * math.inf)


@pytest.fixture(scope="module")
def half_done(tmp_path_factory):
    """A run that was stopped before its second stage."""
    run = tmp_path_factory.mktemp("half") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trainer, "test", lambda self: None)
        patch.setattr("irgspp.core.pipeline.solve_second_stage", lambda *_: (_ for _ in ()).throw(Cancelled("here")))
        arguments = ["reconstruct", *COMMAND, "-o", str(run), "--materials", "low-gloss", "--set", "first.iterations=40"]
        assert main(arguments) == 130
    return run


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (bad_tracing, "the indirect light is not finite before the second stage (3 of"),
        (bad_light, "light is not finite after step 3 of the second stage (1 of 96 values)"),
        (bad_roughness, "roughness is not finite after step 9 of the second stage (1 of"),
        (bad_assignment, "a material is not finite at the end of the second stage (1 of"),
        (bad_refinement, "albedo is not finite after iteration 1 (1 of"),
    ],
)
def test_second_stage_stops_and_keeps_the_first(half_done, monkeypatch, tmp_path, capsys, fault, message):
    check_that_it_stops(half_done, monkeypatch, tmp_path / "run", capsys, fault, message)


def check_that_it_stops(half_done, monkeypatch, run, capsys, fault, message):
    """Check that what a resumed run reads is as before the failure."""
    shutil.copytree(half_done, run)
    with monkeypatch.context() as patch:
        fault(patch)
        assert main(["reconstruct", str(SCENE), "-o", str(run), "--resume"]) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if "not finite" in line]
    assert len(lines) == 1 and message in lines[0]
    state = read_run(run)
    assert state["status"] == "failed" and message in state["error"]
    assert (run / "checkpoint" / "first" / "gaussians.ply").exists() and not (run / "gaussians.ply").exists()
    assert not list((run / "textures").glob("*")) and saved_files(run) == saved_files(half_done)
    assert {name for name, phase in state["phases"].items() if phase["finished"]} == FINISHED


def saved_files(run: Path) -> dict[Path, bytes]:
    """Return the content of all files of the checkpoint."""
    folder = run / "checkpoint"
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_failed_second_stage_can_be_resumed(half_done, monkeypatch, tmp_path, capsys):
    """Here after the latest fault of all."""
    run = tmp_path / "run"
    check_that_it_stops(half_done, monkeypatch, run, capsys, bad_radiance, "the radiance's loss is not finite at iteration 1")
    assert main(["reconstruct", str(SCENE), "-o", str(run), "--resume"]) == 0
    assert read_run(run)["status"] == "done"
