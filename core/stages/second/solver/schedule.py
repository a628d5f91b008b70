# SPDX-License-Identifier: GPL-3.0-or-later
"""Schedule of the solver: the better of two starts, then smaller texels of the light where they explain the photographs better."""

from __future__ import annotations

from collections.abc import Callable

from .light_material_solver import STEPS, LightMaterialSolver, Split

SPLIT_STEPS = (14, 22)  # numbers of steps done when texels of the light are split; at the end this must have paid
START_STEPS, CLEARLY = 20, 0.95  # steps after which two starts are compared, and share of the error below which the dark one is better


def run_solver(
    solver: LightMaterialSolver,
    split: Split | None = None,
    step: Callable[[int], bool | None] = lambda done: None,
    try_dark: bool = True,
) -> None:
    """Do all steps of a solver.

    Args:
        solver: at its start; afterwards with the result.
        split: splits texels of the light; None: they stay as they are, and no dark start is tried.
        step: called with the number of steps done; it may raise, and ends the run early by returning True.
        try_dark: also try a dark start, see `LightMaterialSolver.dark_twin`.

    Raises:
        IrgsppError: an estimate is not finite.
    """
    if split:
        _run_beside_coarse_light(solver, split, step, try_dark)
    else:
        for done in range(STEPS):
            solver.advance(done)
            if step(done + 1):
                break
    solver.reduce_tint()


def _run_beside_coarse_light(solver: LightMaterialSolver, split: Split, step: Callable[[int], bool | None], try_dark: bool) -> None:
    """Do all steps from the better start with split texels, and keep the result of the same start without, if it is better."""
    starts = [solver.twin(), solver.dark_twin()] if try_dark else [solver.twin()]
    coarse = _choose_start(solver, starts, step)
    if coarse is None:
        return
    for done in range(SPLIT_STEPS[0], STEPS):
        if done in SPLIT_STEPS:
            solver.split_texels(split)
        solver.advance(done)
        if done < START_STEPS:  # the coarse light is so far already
            continue
        coarse.advance(done)
        if step(done + 1):
            break
    if coarse.total_error() <= solver.total_error():
        solver.become(coarse)


def _choose_start(
    solver: LightMaterialSolver, starts: list[LightMaterialSolver], step: Callable[[int], bool | None]
) -> LightMaterialSolver | None:
    """Choose the better of two starts, where there are two.

    Args:
        solver: afterwards at the first of SPLIT_STEPS of the better one.
        starts: its own, and a dark one or none.
        step: called with the number of steps done; it may raise, and ends the run early by returning True.

    Returns:
        The better one after START_STEPS; None where the run was ended, with the solver where its own start has led to.
    """
    before = []
    for done in range(START_STEPS):
        if done == SPLIT_STEPS[0]:
            before = [start.twin() for start in starts]
        for start in starts:
            start.advance(done)
        if step(done + 1):
            solver.become(starts[0])
            return None
    errors = [start.total_error() for start in starts]
    best = int(errors[-1] < CLEARLY * errors[0])
    solver.become(before[best])
    return starts[best]
