# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes, reconstructions and options that all sections of the benchmark share."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from irgspp import core
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import IrgsppError
from irgspp.core.evaluation.ground_truth import SceneTruth, Truth, load_scene_truth, load_truth
from irgspp.core.evaluation.report import evaluate
from irgspp.core.machine.devices import devices
from irgspp.core.machine.versions import versions
from irgspp.core.scene.dataset import Dataset, View
from irgspp.core.settings.overrides import from_dict
from irgspp.core.settings.schema import DataSettings

from . import runs
from .runs import Run, RunPlan

FULL_SIZE = 16384  # pixels: test views and their ground truth are never reduced, at whatever size a run was made
PRESETS = ("balanced", "draft")
METAL = 0.5  # mean metallic above which a scene counts as glossy


@dataclass(frozen=True, eq=False)
class Scene:
    """Dataset with ground truth, as scripts/render_dataset.py writes it, read when it is first used."""

    name: str
    path: Path

    @cached_property
    def data(self) -> Dataset:
        """Photographs and cameras in the normalised world frame of a run."""
        return load_dataset(self.path, DataSettings(resolution=FULL_SIZE))

    @cached_property
    def truth(self) -> SceneTruth:
        """Light maps by name and surface samples in that frame."""
        return load_scene_truth(self.path, self.data.to_world)

    @property
    def views(self) -> list[View]:
        """Test views; the training views where there are none."""
        return self.data.test or self.data.train

    def view_truth(self, view: View) -> Truth:
        """Return the ground truth of one view."""
        return load_truth(view, self.truth, self.data.to_world)

    @property
    def relights(self) -> list[str]:
        """Names of the lights that test views are relit by."""
        return [name for name in self.truth.lights if name != self.truth.train_light]

    @cached_property
    def glossy(self) -> bool:
        """True where the mean metallic value of the object in the first test view is above METAL."""
        truth = self.view_truth(self.views[0])
        return truth.metallic is not None and bool(truth.object.any()) and float(truth.metallic[truth.object].mean()) > METAL


@dataclass
class Bench:
    """Options, scenes and reconstructions of a benchmark.

    Attributes:
        folder: folder of results, runs and images.
        scenes: scenes to measure.
        quick: short schedules and few measurements.
        repeats: repeats of each timing, of which the median counts.
        budgets: time budgets in minutes of the section on reconstruction.
        lpips: TorchScript file of the metric, if any.
        on_tick: called now and then during long work.
    """

    folder: Path
    scenes: list[Scene]
    quick: bool = False
    repeats: int = 5
    budgets: tuple[float, ...] = (1, 2, 4)
    lpips: Path | None = None
    on_tick: Callable[[], None] = lambda: None
    _runs: dict[tuple[str, str], Run] = field(default_factory=dict)
    _failed: dict[tuple[str, str], str] = field(default_factory=dict)

    def plan(self, label: str, *options: str, preset: str = "balanced", materials: str = "", time: str = "", seconds: float = 0) -> RunPlan:
        """Return a plan to reconstruct any scene; `quick` shortens all plans alike.

        Args:
            label: name of the plan, unique among a scene's runs.
            *options: further settings as `KEY=VALUE`.
            preset: preset to start from.
            materials: materials option; "" leaves the choice to the job.
            time: time budget as after `--time`; "" for none.
            seconds: expected seconds on two cores; 0 for the preset's.
        """
        expected = seconds or {"draft": 48.0}.get(preset, 120.0)
        if self.quick:
            options, expected = (*options, *QUICK), 9.0
        return RunPlan(label, preset, options, materials, time, expected)

    @property
    def presets(self) -> tuple[str, ...]:
        """Presets that are compared; one alone with `quick`, whose short schedules make all alike."""
        return PRESETS[:1] if self.quick else PRESETS

    def balanced(self) -> RunPlan:
        """Return the plan that most sections share: the preset `balanced` with default settings."""
        return self.plan("balanced")

    @property
    def evaluation_seconds(self) -> float:
        """Expected seconds of `evaluation`."""
        return 2.0 if self.quick else 12.0

    def run_folder(self, scene: Scene, plan: RunPlan) -> Path:
        """Return the folder of a reconstruction, made or not.

        Args:
            scene: scene to reconstruct.
            plan: plan of the reconstruction.
        """
        return self.folder / "runs" / f"{scene.name}-{plan.label}"

    def has_run(self, scene: Scene, plan: RunPlan) -> bool:
        """Return True where a reconstruction is finished.

        Args:
            scene: scene to reconstruct.
            plan: plan of the reconstruction.
        """
        return runs.finished(plan, scene.path, self.run_folder(scene, plan)) is not None

    def run(self, scene: Scene, plan: RunPlan) -> Run:
        """Return a reconstruction, which is made now where it does not exist yet.

        Args:
            scene: scene to reconstruct.
            plan: plan of the reconstruction.

        Raises:
            IrgsppError: where the reconstruction fails, now or at an earlier call.
        """
        key, path = (scene.name, plan.label), self.run_folder(scene, plan)
        if key in self._failed:  # many tasks need it: a failed one is not repeated
            raise IrgsppError(self._failed[key])
        if key not in self._runs:
            try:
                self._runs[key] = runs.finished(plan, scene.path, path) or runs.make(plan, scene.path, path, self.on_tick)
            except IrgsppError as error:
                self._failed[key] = str(error)
                raise
        return self._runs[key]

    def evaluation(self, scene: Scene, folder: Path, settings_of: Path | None = None) -> dict[str, Any]:
        """Return the report of `irgspp evaluate` on a run against the scene's ground truth, which is stored in the run.

        Args:
            scene: scene of the run.
            folder: run folder, or a folder with the result of a first stage alone.
            settings_of: run folder whose settings count; None: `folder`.

        Returns:
            The report with "figures", "albedo_scale", "views" and so on.
        """
        stored = folder / "evaluation" / "report.json"
        reconstruction = folder / "reconstruction.json"
        if not stored.is_file() or stored.stat().st_mtime < reconstruction.stat().st_mtime:
            settings = from_dict(runs.read_run(settings_of or folder)["settings"], reconstruction).data
            evaluate(folder, scene.path, settings=replace(settings, resolution=FULL_SIZE))
        return json.loads(stored.read_text(encoding="utf-8"))

    def in_detail(self, scene: Scene) -> bool:
        """Return True for the first glossy scene and the first other one: the rest would repeat what these two show, at hours of work."""
        return scene is next(other for other in self.scenes if other.glossy == scene.glossy)


# Schedules of seconds for 64x64 pixels: they show that everything works, and the direction of most differences.
QUICK = (
    "first.iterations=150",
    "first.gaussians=6000",
    "first.trial_iterations=30",
    "first.trial_gaussians=2000",
    "second.joint_iterations=40",
    "second.points=500",
    "second.iterations=40",
    "second.samples=32",
    "second.radiance_iterations=20",
    "surface.voxels=64",
    "surface.triangles=5000",
    "surface.texture=256",
)


def machine() -> dict[str, Any]:
    """Return this machine's CPU and the versions of all software that results depend on."""
    cpu = devices()["cpu"]
    about = {"cpu": _cpu_name() or cpu["name"], "threads": cpu["threads"], "cores": cpu["cores"], "simd": cpu["simd"]}
    return {**about, "versions": {**versions(), "platform": _system(), "engine's source": _source()}}


def _system() -> str:
    """Return the versions of the system and its C library; the rest of a kernel's release does not affect results."""
    release, library = ".".join(platform.release().split(".")[:2]), " ".join(platform.libc_ver()).strip()
    return f"{platform.system()} {release}" + (f", {library}" if library else "")


def _source() -> str:
    """Return a digest of the engine's code, which distinguishes the results of two versions of it."""
    files = sorted(Path(core.__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:8]


def _cpu_name() -> str:
    """Return the CPU's name as its maker gives it, where the system knows it."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        line = next((line for line in info.read_text(errors="replace").splitlines() if line.startswith("model name")), "")
        return line.partition(":")[2].strip()
    return platform.processor()
