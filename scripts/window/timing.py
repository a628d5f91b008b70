# SPDX-License-Identifier: GPL-3.0-or-later
"""Measurements of a story: times that have limits, and how long calls block Blender's interface."""

from __future__ import annotations

import os
import statistics
import time

import bpy
from extension import extension_module

BLOCKED = 0.05  # seconds for which a call may block Blender's interface
FINDING = 3.0  # seconds in which a person finds a button; the robot moves the mouse down the whole sidebar
LOAD = os.getloadavg()[0]  # processes that wanted to compute before the story began

figures: dict[str, str] = {}  # what a story has measured, for its result
searches: list[float] = []  # seconds that the robot took to find each button
_times: dict[str, list[float]] = {}  # seconds of each call, by its label
_before: dict[str, int] = {}  # number of calls before `begin`, by label


def within(name: str, seconds: float, limit: float) -> None:
    """Note a time, and fail where it is longer than its limit on an idle machine, or than its share of a busy one allows.

    Args:
        name: of what took this time.
        seconds: that it took.
        limit: seconds that it may take where nothing else computes.
    """
    processors = os.cpu_count() or 1
    allowed = limit * max(1.0, (LOAD + 2.0) / processors)  # Blender and the engine want two processors themselves
    busy = f", {allowed:.0f} s at a load of {LOAD:.1f} on {processors} processors" if allowed > limit else ""
    figures[name] = f"{seconds:.1f} s (limit {limit:g} s{busy})"
    assert seconds <= allowed, f"{name}: {figures[name]}"


def by_person(seconds: float, begun: int) -> float:
    """Return the seconds that a person would have taken, who finds each button in FINDING, and note the robot's.

    Args:
        seconds: that the robot took.
        begun: number of `searches` when it began.
    """
    searched = searches[begun:]
    figures["with the robot's search"] = f"{seconds:.1f} s, {sum(searched):.1f} s of them in search of {len(searched)} buttons"
    return seconds - sum(searched) + FINDING * len(searched)


def begin() -> None:
    """Begin to watch for slow calls: earlier ones do not count for `slowest_call`."""
    _before.update({name: len(seconds) for name, seconds in _times.items()})


def slowest_call() -> tuple[float, str]:
    """Return the longest time since `begin` for which a call has blocked Blender's interface, in seconds, and the call."""
    watched = {name: seconds[_before.get(name, 0) :] for name, seconds in _times.items()}
    return max(((max(seconds), name) for name, seconds in watched.items() if seconds), default=(0.0, "none"))


def check_never_blocked(call: tuple[float, str]) -> None:
    """Note the slowest call, and fail where it blocked Blender's interface for longer than BLOCKED.

    Args:
        call: seconds and name, from `slowest_call`.
    """
    figures["slowest call"] = f"{1000 * call[0]:.1f} ms, {call[1]} (limit {1000 * BLOCKED:g} ms of processor time)"
    assert call[0] <= BLOCKED, figures["slowest call"]


def summary() -> dict[str, str]:
    """Return the longest and the median time of the calls, by label."""
    return {
        name: f"{max(seconds) * 1000:.1f} ms, median {statistics.median(seconds) * 1000:.2f} ms of {len(seconds)}"
        for name, seconds in _times.items()
        if seconds
    }


def time_calls(owner: object, name: str, label: str) -> None:
    """Record the processor time of each call of a method: the time that Blender's interface is blocked.

    Args:
        owner: class or module.
        name: name of the method.
        label: label in the result.
    """
    method, seconds = getattr(owner, name), _times.setdefault(label, [])

    def timed(*args: object) -> object:
        """Call the method and record its time."""
        began = time.thread_time()
        try:
            return method(*args)
        finally:
            seconds.append(time.thread_time() - began)

    # Blender passes as many arguments as the method's code says it takes.
    takes = {
        0: lambda: timed(),
        1: lambda one: timed(one),
        2: lambda self, context: timed(self, context),
        3: lambda self, context, event: timed(self, context, event),
    }
    setattr(owner, name, takes[method.__code__.co_argcount])


def time_callbacks() -> None:
    """Time what blocks Blender: every panel's drawing, every operator's start, the polling of jobs, the live shape and the live image."""
    for cls in extension_module("panels.registration").CLASSES:
        for name in ("draw", "invoke"):
            if name in vars(cls) and issubclass(cls, bpy.types.Panel | bpy.types.Operator):
                time_calls(cls, name, f"{cls.__name__}.{name}")
    time_calls(extension_module("irgspp_addon.jobs.queue"), "poll", "jobs.queue.poll")
    time_calls(extension_module("operators.live_shape"), "follow", "live_shape.follow")
    time_calls(extension_module("irgspp_addon.relight.live_image"), "beat", "relight.live_image.beat")
