# SPDX-License-Identifier: GPL-3.0-or-later
"""Measurements on a GPU: correctness, iterations, relighting, a whole job, memory, bandwidth and profile."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from irgspp.core.pipeline import reconstruct
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.relight.relighter import Relighter
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import FirstStageSettings, SecondStageSettings, preset
from irgspp.core.stages.first.material_class import MATERIAL_CLASSES
from irgspp.core.stages.first.trainer import Trainer
from irgspp.core.stages.second.refinement.pixel_pool import pool_pixels
from irgspp.core.stages.second.refinement.refinement import Refinement

from .scene import RADIUS, Work, ring

ROOT = Path(__file__).resolve().parents[2]
PROFILED = 12  # operations that the profile lists
PROFILED_STEPS = 5  # iterations, or frames, that are profiled
PROFILED_CALLS = 6  # calls of CUDA's driver that the profile lists
DRIVER_CALLS = ("cuda", "cuLaunch", "cuMem", "cuStream", "cuEvent", "cuCtx")  # how names of launches, copies and waits begin
JOB_TARGETS = {"balanced": "<= 1 min", "paper": "<= 10 min (paper: 40)"}


@dataclass(frozen=True)
class Measurement:
    """Line of the table: name, measured value, and target."""

    name: str
    measured: str
    target: str = ""


@dataclass(frozen=True)
class Size:
    """Size of the work; the defaults are the sizes that the targets are stated for.

    Attributes:
        gaussians: number of Gaussians.
        image: pixels along a side of the images.
        triangles: triangles of the mesh.
        pixels: pixels of an iteration of the second stage.
        samples: secondary rays per pixel; 2^18 rays with the default.
        repeats: timed calls.
        warm: calls before the clock starts.
    """

    gaussians: int = 100_000
    image: int = 800
    triangles: int = 200_000
    pixels: int = 512
    samples: int = 512
    repeats: int = 50
    warm: int = 10


QUICK = Size(2000, 64, 2000, 32, 16, 3, 1)


def synchronised(device: torch.device) -> float:
    """Return the time in seconds once all queued work is done."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()


def seconds_each(work: Callable[[], object], size: Size, device: torch.device) -> float:
    """Return the mean seconds of a call within many in a row, as in an optimisation.

    Args:
        work: function to time.
        size: repeats and warm-up calls.
        device: device to wait for.
    """
    for _ in range(size.warm):
        work()
    began = synchronised(device)
    for _ in range(size.repeats):
        work()
    return (synchronised(device) - began) / size.repeats


def correctness(device: torch.device, quick: bool) -> Measurement:
    """Run the kernels' tests on a device.

    Args:
        device: device of the kernels.
        quick: True for the tests of one file.
    """
    what = ["tests/core/kernels/test_devices.py"] if quick else ["tests/core/kernels", "-m", "cuda"]
    words = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *what, *(["-k", "warp"] if quick else [])]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    last_line = (done.stdout.strip().splitlines() or ["no output"])[-1]
    return Measurement(f"correctness: tests on {device.type}", f"{'green' if done.returncode == 0 else 'FAILED'}: {last_line}", "green")


def refinement(work: Work, size: Size) -> Refinement:
    """Return the second stage's refinement, ready for its iterations.

    Args:
        work: torus to reconstruct.
        size: size of an iteration.
    """
    tracer = SecondaryTracer(work.reconstruction)
    pool = pool_pixels(work.dataset.train, tracer, 100_000, np.random.default_rng(0))
    settings = replace(SecondStageSettings(), iterations=10_000, pixels=size.pixels, samples=size.samples)
    return Refinement(work.reconstruction, pool, tracer, settings, 0)


def trainer(work: Work, size: Size) -> Trainer:
    """Return the first stage's trainer, ready for its iterations.

    Args:
        work: torus to reconstruct.
        size: size of the work.
    """
    settings = replace(FirstStageSettings(), iterations=10_000, gaussians=size.gaussians)
    return Trainer(work.dataset, settings, work.reconstruction.gaussians, MATERIAL_CLASSES[1], 0, 0)


def steps(work: Work, size: Size, device: torch.device) -> list[Measurement]:
    """Measure the iterations of both stages.

    Args:
        work: torus to reconstruct.
        size: size of the work.
        device: device of the kernels.
    """
    second, first = refinement(work, size), trainer(work, size)
    rays = size.pixels * size.samples
    about = f"{size.gaussians:,} Gaussians, {size.image}x{size.image}"
    later = seconds_each(second.step, size, device)
    sooner = seconds_each(first.step, size, device)
    return [
        Measurement(f"second stage's iteration, {about}, {rays:,} rays", f"{1000 * later:.2f} ms", "<= 12 ms"),
        Measurement(f"first stage's iteration, {about}", f"{1000 * sooner:.2f} ms", "<= 9 ms (for 50,000 in 10 minutes)"),
    ]


def relit_frames(work: Work, size: Size, samples: int, device: torch.device) -> Callable[[], object]:
    """Return a function that relights the next frame, with the mesh backend and a camera of its own.

    Args:
        work: torus to relight.
        size: size of the work, and number of frames.
        samples: light samples per pixel.
        device: device of the kernels.
    """
    query, light = MeshQuery(work.mesh, RADIUS, device), prepare_light(work.reconstruction.environment_map(), device)
    relighter = Relighter(work.reconstruction, query, RelightSettings(samples=samples), query)
    cameras = iter(ring(size.warm + size.repeats, size.image))
    return lambda: relighter.relit(relighter.surface(next(cameras)), light)


def relighting(work: Work, size: Size, device: torch.device) -> list[Measurement]:
    """Measure frames per second with the mesh backend, each with a camera of its own, so that nothing is cached.

    Args:
        work: torus to relight.
        size: size of the work.
        device: device of the kernels.
    """
    found = []
    for samples in (16, 32):
        each = seconds_each(relit_frames(work, size, samples, device), size, device)
        name = f"relighting, {size.image}x{size.image}, {samples} samples, mesh of {len(work.mesh.faces):,} triangles"
        found.append(Measurement(name, f"{1 / each:.1f} FPS", ">= 60 FPS (paper, RTX 3090: 25)"))
    return found


def memory(device: torch.device) -> Measurement:
    """Return the peak of the GPU's memory in use."""
    if device.type != "cuda":
        return Measurement("the GPU's memory at most", "no GPU", "about 10 GB (paper)")
    return Measurement("the GPU's memory at most", f"{torch.cuda.max_memory_allocated(device) / 1e9:.2f} GB", "about 10 GB (paper)")


def job(name: str, dataset: Path, run: Path, device: str, changes: tuple[str, ...]) -> list[Measurement]:
    """Measure a whole reconstruction.

    Args:
        name: preset of the job, one of JOB_TARGETS.
        dataset: folder of the dataset.
        run: run folder.
        device: device option of the job.
        changes: settings as `KEY=VALUE`.
    """
    settings = with_overrides(replace(preset(name), device=device), changes)
    reconstruct(dataset, run, settings, overwrite=True)
    state = json.loads((run / "run.json").read_text())
    phases = {name: phase["seconds"] for name, phase in state["phases"].items()}
    psnr = state["training"].get("test_radiance_psnr")
    found = [Measurement(f"whole job, {name}, {dataset.name}", f"{sum(phases.values()) / 60:.1f} min", JOB_TARGETS[name])]
    found += [Measurement(f"  of it: {name}", f"{seconds:.0f} s") for name, seconds in phases.items()]
    return found + ([] if psnr is None else [Measurement("its test views", f"{psnr:.2f} dB PSNR (own radiance)")])


def profile(work: Work, size: Size, device: torch.device) -> list[Measurement]:
    """Measure the longest operations of both stages' iterations and of a relit frame, and the longest calls of CUDA's driver.

    Args:
        work: torus to reconstruct.
        size: size of the work.
        device: device of the kernels.
    """
    works = {"second stage": refinement(work, size).step, "first stage": trainer(work, size).step}
    works["relighting"] = relit_frames(work, replace(size, repeats=PROFILED_STEPS), 16, device)
    kinds = [torch.profiler.ProfilerActivity.CPU, *([torch.profiler.ProfilerActivity.CUDA] if device.type == "cuda" else [])]
    found = []
    for name, step in works.items():
        for _ in range(size.warm):
            step()
        with torch.profiler.profile(activities=kinds) as watched:
            for _ in range(PROFILED_STEPS):
                step()
            synchronised(device)
        events = watched.key_averages()
        spent = [(e.self_device_time_total, e) for e in events if e.device_type.name == "CUDA"]
        if device.type != "cuda":
            spent = [(e.self_cpu_time_total, e) for e in events]
        total, calls = sum(duration for duration, _ in spent) or 1, sum(event.count for _, event in spent) // PROFILED_STEPS
        found.append(Measurement(f"{name}: on the {device.type}", f"{total / 1000 / PROFILED_STEPS:.2f} ms an iteration, {calls} calls"))
        found += [_operation(name, duration, event, f", {duration / total:.0%}") for duration, event in _longest(spent, PROFILED)]
        driver_calls = [(e.self_cpu_time_total, e) for e in events if e.device_type.name == "CPU" and e.key.startswith(DRIVER_CALLS)]
        found += [_operation(f"{name}, host", duration, event) for duration, event in _longest(driver_calls, PROFILED_CALLS)]
    return found


def _longest(spent: list[tuple[float, Any]], count: int) -> list[tuple[float, Any]]:
    """Return the `count` longest of operations, which are given as microseconds and profiled event."""
    return sorted(spent, key=lambda pair: -pair[0])[:count]


def _operation(name: str, spent: float, event: Any, further: str = "") -> Measurement:
    """Return the line of a profiled operation.

    Args:
        name: name of the stage.
        spent: its time in microseconds, in all PROFILED_STEPS.
        event: the profiler's event.
        further: text that follows the time.
    """
    each, calls = spent / 1000 / PROFILED_STEPS, event.count / PROFILED_STEPS
    return Measurement(f"  {name}: {event.key[:70]}", f"{each:.3f} ms an iteration{further}, {calls:g} calls")


def bandwidth(work: Work, size: Size, device: torch.device) -> Measurement:
    """Measure the memory bandwidth of the photometric loss, whose passes read and write planes in order and compute little.

    Args:
        work: unused.
        size: pixels along a side of the images.
        device: device of the kernels.
    """
    from irgspp.core.kernels.photometric import photometric_loss

    a, b = (torch.rand(3, size.image, size.image, device=device) for _ in range(2))
    a.requires_grad_()
    each = seconds_each(lambda: photometric_loss(a, b), size, device)
    planes = (2 + 5) + (5 + 4) + (3 + 3) + (5 + 1) + (3 + 1)  # read and written by each of its four passes, and by the means
    moved = planes * a.numel() * 4
    return Measurement("bandwidth of the loss's passes", f"{moved / each / 1e9:.0f} GB/s", "4,800 GB/s is an H200's peak")
