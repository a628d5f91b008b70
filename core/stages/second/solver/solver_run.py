# SPDX-License-Identifier: GPL-3.0-or-later
"""Run of the solver: its start, the course of its steps, and its end.

1. Start: a few steps on some of the points from a medium and from a dark albedo; the better one is the start.
2. Twice in the course of the steps, the brightest texels of the light are split into smaller ones. A copy without the split goes on beside
   the solver; it is given up after COARSE_STEPS unless it is clearly better, and is the result if it is so at the end.
3. At the end, the borders of metal parts are drawn once more and their normals searched, and roughness and light settle. Metal that more
   than doubles so is taken back where the points that were added are explained clearly worse.
4. A copy starts once more with all but metal glossy, lets the light follow, and settles. It is given up after GLOSSY_PASSES unless it
   explains the photographs clearly better than the solver, and than a copy that does the same from the solver's own roughness. Where
   normals change little, as on a board, rough paint under a bright light is found first.
5. A tint of the light moves into the albedo as far as the photographs leave it open.
"""

from __future__ import annotations

from collections.abc import Callable

import torch

from .light_material_solver import STEPS, LightMaterialSolver, Split

START_STEPS, START_POINTS = 20, 400  # steps after which two starts are compared, and about how many points they are compared on
SPLIT_STEPS = (14, 22)  # texels of the light are split when so many steps are done
COARSE_STEPS = 24  # steps done when the copy without the split is given up, unless it is clearly better
MAX_DARK_ERROR_RATIO = 0.95  # ratio of errors below which a dark start is the better one
# Ratio of errors below which the coarse light is clearly better. Errors that differ by less tell nothing: at the end of two runs on
# rocker_corner, the split light's was .3 per cent lower and .8 higher, and its light was better by 2 dB in both; on spot_rough by .6 dB.
MAX_COARSE_ERROR_RATIO = 0.99
NORMAL_SEARCHES = 2  # searches of the normals of metal; a third one changes little
# Ratio of the errors of points that became metal, after to before, above which metal that more than doubled is taken back. The blue walls
# of a captured toy train had the colours of 22 false points: 1.27. The ball of rocker_corner .97; metal of other objects grows less.
MAX_GROWN_ERROR_RATIO = 1.15
# Searches of the roughness at the end, at most, and the root mean square of its change below which they end. On rocker_corner, each brings
# light and roughness nearer to the truth (its error .05 -> .02); two are enough on spot_rough.
SETTLING_PASSES, MIN_ROUGHNESS_CHANGE = 8, 0.002
# Roughness from which a solver starts once more, and steps in which light and albedo follow it. Their prior has its usual last weight: with
# the higher one of settling, colours that were grouped under the wrong light stay so (albedos of chess pieces 14.9 dB in place of 22.2).
GLOSSY_ROUGHNESS, GLOSSY_STEPS = 0.3, 12
# Searches of the roughness after which the ratio of errors must be lower than this. Chess pieces on a board .92, and .91 at the end: their
# roughness was .33 too high, and the albedo 1.6 times too dark. rocker_corner 1.06, suzanne_mixed 1.02, igea_relief 1.01.
GLOSSY_PASSES, MAX_GLOSSY_ERROR_RATIO = 2, 0.97
TOTAL_STEPS = STEPS + SETTLING_PASSES  # that are reported


def run_solver(
    solver: LightMaterialSolver,
    split: Split | None = None,
    on_step: Callable[[int], bool | None] = lambda done: None,
    try_dark: bool = True,
) -> LightMaterialSolver:
    """Do all steps of a solver, and return it, or the copy of it that explains the photographs better.

    Args:
        solver: at its start; it is modified.
        split: splits texels of the light; None: they stay as they are, and no dark start is tried.
        on_step: called with the number of steps done, TOTAL_STEPS at most, and with STEPS after each search of normals; it may raise,
            and ends the run early by returning True.
        try_dark: also try a dark start, see `LightMaterialSolver.start_dark`.

    Raises:
        IrgsppError: an estimate is not finite.
    """
    if split and try_dark and _dark_start_is_better(solver, on_step):
        solver.start_dark()
    coarse, ended = None, False
    for done in range(STEPS):
        if split and done == SPLIT_STEPS[0]:
            coarse = solver.copied()
        if split and done in SPLIT_STEPS:
            solver.split_texels(split)
        solver.advance(done)
        if coarse:
            coarse.advance(done)
        if ended := bool(on_step(done + 1)):
            break
        if coarse and done + 1 == COARSE_STEPS and not _clearly_better(coarse, solver):
            coarse = None
    if coarse and _clearly_better(coarse, solver):
        solver = coarse
    # Of an object that is metal as a whole, the first stage's reflections know the normals better. A tin with a paper label, and a lantern
    # with a candle and a wooden base, both mostly metal, gain: their roughness is .04 and .05 off in place of .10.
    if not ended and not solver.is_all_metal:
        solver, ended = _with_final_metal(solver, on_step)
        if not ended and not _settle(solver, on_step):
            solver = _glossy_where_better(solver, on_step)
    solver.reduce_tint()
    return solver


def _with_final_metal(solver: LightMaterialSolver, on_step: Callable[[int], bool | None]) -> tuple[LightMaterialSolver, bool]:
    """Draw the borders of metal anew, and search its normals.

    Args:
        solver: a solver after its steps; it is modified.
        on_step: called as by `run_solver`.

    Returns:
        The solver with metal that grew, or a copy without that where it is clearly worse; and whether `on_step` ended the run.
    """
    if not bool((solver.metallic > 0).any()):
        return solver, False
    before = solver.copied()
    solver.grow_metal()
    ended = _turn_metal(solver, on_step)
    if ended or not _has_grown_wrongly(before, solver):
        return solver, ended
    return before, _turn_metal(before, on_step)


def _turn_metal(solver: LightMaterialSolver, on_step: Callable[[int], bool | None]) -> bool:
    """Search the normals of metal, if there is any; return True where `on_step` ended the run."""
    for _ in range(NORMAL_SEARCHES if bool((solver.metallic > 0).any()) else 0):
        solver.turn_metal()
        if on_step(STEPS):
            return True
    return False


def _has_grown_wrongly(before: LightMaterialSolver, after: LightMaterialSolver) -> bool:
    """Return True where metal has more than doubled, and the points that were added are explained clearly worse."""
    added = (after.metallic > 0) & ~(before.metallic > 0)
    if int(added.sum()) <= int((before.metallic > 0).sum()):
        return False
    return float(after.point_errors()[added].sum()) > MAX_GROWN_ERROR_RATIO * float(before.point_errors()[added].sum())


def _settle(solver: LightMaterialSolver, on_step: Callable[[int], bool | None]) -> bool:
    """Let roughness and light settle.

    Args:
        solver: it is modified.
        on_step: called as by `run_solver`.

    Returns:
        True where `on_step` ended the run.
    """
    for done in range(STEPS, TOTAL_STEPS):
        if solver.settle() < MIN_ROUGHNESS_CHANGE:
            return False
        if on_step(done + 1):
            return True
    return False


def _glossy_where_better(solver: LightMaterialSolver, on_step: Callable[[int], bool | None]) -> LightMaterialSolver:
    """Return a copy of a solver that started once more from a glossy surface, where that explains the photographs clearly better.

    It must also be better than a copy that does the same from the solver's own roughness: where the model is wrong, as at false surfaces in
    a glossy bowl, the weaker prior of the albedo alone lowers the error by a twentieth.

    Args:
        solver: a solver that has settled.
        on_step: called as by `run_solver`.

    Returns:
        The copy, settled, or the solver itself.
    """
    least = solver.total_error()
    glossy, same = solver.copied(), solver.copied()
    glossy.started_glossy = True
    for one, roughness in ((glossy, torch.full_like(solver.roughness, GLOSSY_ROUGHNESS)), (same, solver.roughness)):
        one.set_roughness(roughness, GLOSSY_STEPS)
        for _ in range(GLOSSY_PASSES):
            one.settle()
            if on_step(TOTAL_STEPS):
                return solver
        least = min(least, same.total_error())  # at first the solver's
        if glossy.total_error() > MAX_GLOSSY_ERROR_RATIO * least:
            return solver
    _settle(glossy, lambda _: on_step(TOTAL_STEPS))  # steps that were told are not told again
    return glossy


def _clearly_better(one: LightMaterialSolver, other: LightMaterialSolver) -> bool:
    """Return True where one solver explains the photographs clearly better than another."""
    return one.total_error() < MAX_COARSE_ERROR_RATIO * other.total_error()


def _dark_start_is_better(solver: LightMaterialSolver, on_step: Callable[[int], bool | None]) -> bool:
    """Return True where a dark start explains some of the points better; `on_step` is called as by `run_solver`."""
    every = max(1, len(solver.albedo) // START_POINTS)
    plain, dark = solver.subsampled(every), solver.subsampled(every)
    dark.start_dark()
    for done in range(START_STEPS):
        if on_step(0):
            return False
        plain.advance(done)
        dark.advance(done)
    return dark.total_error() < MAX_DARK_ERROR_RATIO * plain.total_error()
