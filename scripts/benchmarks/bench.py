# SPDX-License-Identifier: GPL-3.0-or-later
"""What every section works with: the scenes, their reconstructions, and how thorough to be."""

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
from irgspp.core.run_folder import versions
from irgspp.core.scene.dataset import Dataset, View
from irgspp.core.settings.overrides import from_dict
from irgspp.core.settings.schema import DataSettings

from . import runs
from .runs import Run, RunPlan

WHOLE = 16384  # pixels: test views and their truth are never reduced, whatever a run was made from
PRESETS = ("balanced", "draft")
METAL = 0.5  # mean metallic above which a scene counts as glossy


@dataclass(frozen=True, eq=False)
class Scene:
    """A dataset with ground truth, in the format of the benchmark scenes, read when it is first asked for."""

    name: str
    path: Path

    @cached_property
    def data(self) -> Dataset:
        """Photographs and cameras, in the world that a run of it has."""
        return load_dataset(self.path, DataSettings(resolution=WHOLE))

    @cached_property
    def truth(self) -> SceneTruth:
        """Lights by name, surface samples, in that world."""
        return load_scene_truth(self.path, self.data.to_world)

    @property
    def views(self) -> list[View]:
        """The test views."""
        return self.data.test or self.data.train

    def view_truth(self, view: View) -> Truth:
        """What is known of one view."""
        return load_truth(view, self.truth, self.data.to_world)

    @property
    def relights(self) -> list[str]:
        """Names of the lights that test views are relit by."""
        return [name for name in self.truth.lights if name != self.truth.train_light]

    @cached_property
    def glossy(self) -> bool:
        """Whether most of what the first test view shows is metal."""
        truth = self.view_truth(self.views[0])
        return truth.metallic is not None and bool(truth.object.any()) and float(truth.metallic[truth.object].mean()) > METAL


@dataclass
class Bench:
    """Options, scenes and reconstructions.

    Attributes:
        folder: of results, runs and images. repeats: of timings, whose median counts. budgets: minutes, of section reconstruction.
        lpips: a TorchScript file of the metric, if any. ticked: called now and then while something takes long.
    """

    folder: Path
    scenes: list[Scene]
    quick: bool = False
    repeats: int = 5
    budgets: tuple[float, ...] = (1, 2, 4)
    lpips: Path | None = None
    ticked: Callable[[], None] = lambda: None
    _runs: dict[tuple[str, str], Run] = field(default_factory=dict)
    _failed: dict[tuple[str, str], str] = field(default_factory=dict)

    def plan(self, label: str, *options: str, preset: str = "balanced", materials: str = "", time: str = "", seconds: float = 0) -> RunPlan:
        """How to reconstruct any scene; `quick` shortens all of them alike."""
        expected = seconds or {"draft": 48.0}.get(preset, 120.0)
        if self.quick:
            options, expected = (*QUICK, *options), 9.0
        return RunPlan(label, preset, options, materials, time, expected)

    @property
    def presets(self) -> tuple[str, ...]:
        """Those that are compared; with the same short schedules there is no difference."""
        return PRESETS[:1] if self.quick else PRESETS

    def balanced(self) -> RunPlan:
        """The plan that most sections share: default settings."""
        return self.plan("balanced")

    @property
    def evaluation_seconds(self) -> float:
        """Expected of `evaluation`."""
        return 2.0 if self.quick else 12.0

    def run_folder(self, scene: Scene, plan: RunPlan) -> Path:
        """Where the reconstruction is, or will be."""
        return self.folder / "runs" / f"{scene.name}-{plan.label}"

    def has_run(self, scene: Scene, plan: RunPlan) -> bool:
        """Whether it is made."""
        return runs.finished(plan, scene.path, self.run_folder(scene, plan)) is not None

    def run(self, scene: Scene, plan: RunPlan) -> Run:
        """The reconstruction, made now where it is not there yet. Raises IrgsppError where it can't be made."""
        key, path = (scene.name, plan.label), self.run_folder(scene, plan)
        if key in self._failed:  # once is enough: many tasks need it
            raise IrgsppError(self._failed[key])
        if key not in self._runs:
            try:
                self._runs[key] = runs.finished(plan, scene.path, path) or runs.make(plan, scene.path, path, self.ticked)
            except IrgsppError as error:
                self._failed[key] = str(error)
                raise
        return self._runs[key]

    def evaluation(self, scene: Scene, folder: Path, settings_of: Path | None = None) -> dict[str, Any]:
        """The report of `irgspp evaluate` on a run against the scene's truth ("figures", "albedo_scale", ...), kept beside the run.

        `folder` may hold a first stage alone, with `settings_of` the run that it is of.
        """
        kept = folder / "evaluation" / "report.json"
        made = folder / "reconstruction.json"
        if not kept.is_file() or kept.stat().st_mtime < made.stat().st_mtime:
            settings = from_dict(runs.read_run(settings_of or folder)["settings"], made).data
            evaluate(folder, scene.path, settings=replace(settings, resolution=WHOLE))
        return json.loads(kept.read_text(encoding="utf-8"))

    def of_kind(self, glossy: bool) -> Scene | None:
        """The first scene that is glossy, or that is not."""
        return next((scene for scene in self.scenes if scene.glossy == glossy), None)


# Schedules of seconds, for 64x64 pixels: whether everything works, and the directions of most things.
QUICK = (
    "first.iterations=150",
    "first.gaussians=6000",
    "first.trial_iterations=30",
    "first.trial_gaussians=2000",
    "second.points=500",
    "second.iterations=40",
    "second.samples=32",
    "second.radiance_iterations=20",
    "surface.voxels=64",
    "surface.triangles=5000",
    "surface.texture=256",
)


def machine() -> dict[str, Any]:
    """This machine and the versions of what results depend on."""
    cpu = devices()["cpu"]
    about = {"cpu": _cpu_name() or cpu["name"], "threads": cpu["threads"], "cores": cpu["cores"], "simd": cpu["simd"]}
    return {**about, "versions": {**versions(), "platform": _system(), "engine's source": _source()}}


def _system() -> str:
    """The system and its C library, where that is known, by their versions: the rest of a kernel's release says nothing of results."""
    release, library = ".".join(platform.release().split(".")[:2]), " ".join(platform.libc_ver()).strip()
    return f"{platform.system()} {release}" + (f", {library}" if library else "")


def _source() -> str:
    """A digest of the engine's code, so that results of two states of it are told apart."""
    files = sorted(Path(core.__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:8]


def _cpu_name() -> str:
    """As its maker calls it, where the system says."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        line = next((line for line in info.read_text(errors="replace").splitlines() if line.startswith("model name")), "")
        return line.partition(":")[2].strip()
    return platform.processor()
