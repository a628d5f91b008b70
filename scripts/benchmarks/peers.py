# SPDX-License-Identifier: GPL-3.0-or-later
"""Section on peers: Mitsuba 3 and Cycles relight our asset on the same machine, in the same run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial

import numpy as np
from irgspp.core.evaluation import visualisation
from irgspp.core.evaluation.metrics import on_black, psnr
from irgspp.core.machine.blender_process import NoBlender, blender_command

from . import mitsuba_peer, peer_inverse
from .bench import Bench, Scene
from .peer_relighting import CYCLES, FULL, MITSUBA, OURS, PEERS, QUICK, RENDERERS, RendererComparison, compare_renderers, renderer_of
from .section import Block, Chart, Figures, Images, Measurement, Note, Series, Table, Task
from .store import Results
from .studio import studio

NAME = "peers"
TITLE = "Peers: Mitsuba 3 and Cycles"
ABOUT = (
    "The exported mesh with its textures under a new light, by us, by Mitsuba 3 (path tracer, our BRDF as its plugin, all bounces; it has "
    "no denoiser for a CPU) and by Cycles (all bounces, with and without OpenImageDenoise), in as many threads. Error: PSNR over the "
    "object's pixels, each renderer against its own converged image; the differences of these are listed too. Our camera rays see the "
    "Gaussians, with light reflected between the mesh's vertices; the others see the mesh. Seconds: of a frame with the scene loaded and "
    "everything compiled; all alternate. On the first low-gloss and the first glossy scene; materials and light on all."
)
ONCE = False
PRINCIPLED = "Mitsuba, its own BRDF"
WHITE = 0.1  # difference that is white in the images
SAMPLES = 64  # per pixel, in the comparison of BRDFs


def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]:
    """Yield the measurements of relighting and of inverse rendering by the peers.

    Args:
        bench: options, scenes and reconstructions.
        scene: scene to measure.
    """
    assert scene is not None
    if not scene.relights:
        return
    absent = absent_peers()
    if bench.in_detail(scene):
        yield from _relighting(bench, scene, absent)
    if MITSUBA not in absent and mitsuba_peer.variant()[0] == mitsuba_peer.VARIANTS[0]:
        yield from peer_inverse.tasks(bench, scene)


def _relighting(bench: Bench, scene: Scene, absent: dict[str, str]) -> Iterator[Task]:
    """Yield the measurements of relighting by all renderers but the absent ones."""
    run, effort = [bench.balanced()], QUICK if bench.quick else FULL
    comparisons: dict[str, RendererComparison] = {}

    def comparison() -> RendererComparison:
        """Render by all renderers once, when the first task needs it."""
        if scene.name not in comparisons:
            one = studio(bench, scene)
            comparisons[scene.name] = compare_renderers(one, one.lit_views[0], scene.truth.lights[one.lit_views[0].light], effort, absent)
        return comparisons[scene.name]

    seconds = 25.0 if bench.quick else 240.0
    yield Task("difference", partial(_difference, comparison, absent), seconds, run)
    for name in RENDERERS:
        for samples in () if renderer_of(name) in absent else effort.counts[name]:
            yield Task(f"{name}: {samples} samples", partial(_point, comparison, name, samples), 0.1, run)
    for samples in effort.counts[OURS]:
        yield Task(f"to our error: {samples} samples", partial(_against, comparison, samples), 0.1, run)
    if not bench.quick and MITSUBA not in absent:
        yield Task(PRINCIPLED, partial(_principled, bench, scene), 20.0, run)


def absent_peers() -> dict[str, str]:
    """Return the peers that are not available, each with the reason."""
    reasons = {MITSUBA: mitsuba_peer.missing(), CYCLES: ""}
    try:
        blender_command()
    except NoBlender as error:
        reasons[CYCLES] = str(error)
    return {name: reason for name, reason in reasons.items() if reason}


def _difference(comparison, absent: dict[str, str]) -> Measurement:
    """Compare the converged images over the pixels that show the object in either."""
    shown = comparison().images
    figures: Figures = {"about Mitsuba": absent.get(MITSUBA) or mitsuba_peer.described()}
    figures["about Cycles"] = absent.get(CYCLES) or "of the Blender above"
    made = {name: np.round(255 * image.clip(0, 1)).astype(np.uint8) for name, image in shown.items()}
    for a, b in ((OURS, MITSUBA), (OURS, CYCLES), (MITSUBA, CYCLES)):
        if a in shown and b in shown:
            seen = (shown[a].max(-1) > 0) | (shown[b].max(-1) > 0)
            error = np.abs(shown[a] - shown[b])
            figures |= {f"{a} and {b}, mean": float(error[seen].mean()), f"{a} and {b}, psnr": psnr(shown[a], shown[b])}
            made[f"{a} and {b}, difference to {WHITE}"] = visualisation.over(visualisation.heat(error.max(-1), WHITE), 0.0)
    return Measurement(figures, {}, made)


def _point(comparison, name: str, samples: int) -> Measurement:
    """Return time and error of a renderer with a number of samples."""
    return Measurement(asdict(next(p for p in comparison().points(name) if p.samples == samples)))


def _against(comparison, samples: int) -> Measurement:
    """Return the peers' time to our error, and their error at our time."""
    ours = next(p for p in comparison().points(OURS) if p.samples == samples)
    figures: Figures = {"samples": samples, "psnr": ours.psnr, "seconds": ours.seconds}
    for peer in PEERS:
        figures |= {f"{peer}: times as long": comparison().times_as_long(ours, peer), f"{peer}: psnr": comparison().at_our_time(ours, peer)}
        figures[f"{peer}: times the CPU"] = comparison().times_as_long(ours, peer, "cpu_seconds")
    return Measurement(figures)


def _principled(bench: Bench, scene: Scene) -> Measurement:
    """Measure whether our BRDF as a plugin costs Mitsuba time, and how far Mitsuba's own differs from it."""
    one = studio(bench, scene)
    lit_view, asset = one.lit_views[0], mitsuba_peer.textured(one.run)
    views, lights = {"view": lit_view.view.camera}, {"light": scene.truth.lights[lit_view.light]}
    figures, converged = {}, {}
    for brdf in ("ours", "principled"):
        shots = mitsuba_peer.images(asset, views, lights, [SAMPLES], 4 * SAMPLES, brdf)["view", "light"]
        assert shots.converged is not None
        figures[f"{brdf}: seconds"], converged[brdf] = shots.frames[0].seconds, on_black(shots.converged)
    difference = np.abs(converged["ours"] - converged["principled"])[lit_view.inside].mean()
    one_bounce = mitsuba_peer.images(asset, views, lights, [SAMPLES], bounces=1)["view", "light"].frames[0].seconds
    return Measurement({**figures, "one bounce: seconds": one_bounce, "samples": SAMPLES, "difference": float(difference)})


# --- report


def blocks(results: Results) -> Iterator[Block]:
    """Yield the charts, tables and images of the report."""
    if scenes := [scene for scene in results.scenes if results.get(scene, "difference")]:
        yield from _relighting_blocks(results, scenes)
    yield from peer_inverse.blocks(results)


def _relighting_blocks(results: Results, scenes: list[str]) -> Iterator[Block]:
    """Yield the charts, tables and images of relighting."""
    panels = {scene: [series for name in RENDERERS if (series := _series(results, scene, name)).x] for scene in scenes}
    yield Chart(
        "Relighting: error against time",
        "seconds a frame ↓",
        "PSNR to the own converged image, dB ↑",
        panels,
        log_y=False,
        image="benchmark_peers",
    )
    columns = ["scene", "our samples", "our dB", "our seconds"]
    columns += [f"{peer}: {what}" for peer in PEERS for what in ("times as long for that ↓", "times the CPU ↓", "dB in our time ↑")]
    rows = []
    for record in results.records(prefix="to our error"):
        f = record.figures
        values = [f.get(f"{peer}: {what}") for peer in PEERS for what in ("times as long", "times the CPU", "psnr")]
        rows.append([record.scene, f["samples"], f["psnr"], f["seconds"], *values])
    yield Table(
        "Time to our error, and error at our time (dash: not reached with the most samples tried, or no image as soon)", columns, rows
    )
    yield from _differences(results, scenes)
    shown = [[(f"{r.scene}: {name}", file) for name, file in r.images.items()] for r in results.records(prefix="difference")]
    yield Images("Converged images, and where they differ", shown)


def _series(results: Results, scene: str, name: str) -> Series:
    """Return the curve of a renderer on a scene."""
    points = sorted((r.figures for r in results.records(scene, f"{name}: ")), key=lambda f: f["samples"])
    return Series(name, [p["seconds"] for p in points], [p["psnr"] for p in points])


def _differences(results: Results, scenes: list[str]) -> Iterator[Block]:
    """Yield the tables on converged images and BRDFs, and the versions of the peers."""
    pairs = ((OURS, MITSUBA), (OURS, CYCLES), (MITSUBA, CYCLES))
    rows = [
        [scene, *(results.figure(scene, "difference", f"{a} and {b}, {what}") for a, b in pairs for what in ("mean", "psnr"))]
        for scene in scenes
    ]
    columns = ["scene", *(f"{a}, {b}: {what}" for a, b in pairs for what in ("mean ↓", "dB ↑"))]
    yield Table("Converged images: mean difference of encoded values on the object, and PSNR", columns, rows)
    rows = [
        [r.scene, *(r.figures[f"{what}: seconds"] for what in ("ours", "principled", "one bounce")), r.figures["difference"]]
        for r in results.records(prefix=PRINCIPLED)
    ]
    if rows:
        title = f"Mitsuba's seconds for {SAMPLES} samples by BRDF, and how far the two are apart"
        yield Table(title, ("scene", "our BRDF", "principled", "our BRDF, one bounce", "mean difference"), rows)
    for name in (MITSUBA, CYCLES):
        versions = {str(results.figure(scene, "difference", f"about {name}")) for scene in scenes}
        yield Note(f"{name}: {'; '.join(sorted(versions))}.")
