# SPDX-License-Identifier: GPL-3.0-or-later
"""A list of jobs in TOML: what is to be reconstructed, and what then happens to each run."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError

Check = Callable[[Sequence[str]], None]  # raises InputError for words that are no command
OPTIONS = ("preset", "materials", "device", "seed", "time")
KEYS = {"dataset", "output", "name", "set", "after", *OPTIONS}
AFTER = ("bake", "evaluate", "export", "render")


@dataclass(frozen=True)
class Job:
    """One capture's way through the program.

    Attributes:
        name: unique in its list. run: its run folder. steps: words after `irgspp`, one command each; the first reconstructs.
        base: the folder that relative paths in them start from.
    """

    name: str
    run: Path
    steps: tuple[tuple[str, ...], ...]
    base: Path


def read_jobs(path: Path, check: Check) -> list[Job]:
    """The jobs of a TOML file, with relative paths taken from its folder.

    Raises InputError, in one line that says which job and what, for a file that is no such list, for unknown keys, for commands that
    `check` refuses and for jobs that would write to the same place.
    """
    listed = _tables(path)
    defaults = _known(listed.get("defaults", {}), f"{path}: [defaults]", KEYS - {"dataset", "output", "name"})
    jobs = [_job(table, defaults, path, number, check) for number, table in enumerate(listed["job"], 1)]
    _apart(jobs, path)
    return jobs


def _tables(path: Path) -> dict[str, Any]:
    try:
        listed = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, f"is not TOML ({error})") from error
    if unknown := sorted(listed.keys() - {"defaults", "job"}):
        raise InputError(path, f"has an unknown {', '.join(unknown)}", "use [defaults] and [[job]]")
    tables = listed.get("job")
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise InputError(path, "lists no jobs", "begin each with a line [[job]]")
    return listed


def _known(table: Any, where: str, keys: set[str]) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise InputError(where, "is not a table")
    if unknown := sorted(table.keys() - keys):
        raise InputError(where, f"has an unknown {', '.join(unknown)}", f"use {', '.join(sorted(keys))}")
    return table


def _job(table: dict[str, Any], defaults: dict[str, Any], path: Path, number: int, check: Check) -> Job:
    where = f"{path}: job {number}"
    _known(table, where, KEYS)
    for key in ("dataset", "output"):
        if not isinstance(table.get(key), str) or not table[key]:
            raise InputError(where, f"lacks {key}", f'add {key} = "..."')
    base = path.resolve().parent
    dataset, run = str(base / table["dataset"]), base / table["output"]
    name = table.get("name", run.name)
    if not isinstance(name, str) or not name or any(c in '/\\:*?"<>|' for c in name) or name.startswith("."):
        raise InputError(where, f"{name!r} is no name for it", "use letters, digits and -_")
    words = ["reconstruct", dataset, "-o", str(run), *_options(defaults | table, where)]
    words += [word for text in (*_overrides(defaults, where), *_overrides(table, where)) for word in ("--set", text)]
    after = _texts((defaults | table).get("after", []), where, "after")
    steps = [tuple(words), *(_step(text, name, run, dataset, where) for text in after)]
    for step in steps:
        try:
            check(step)
        except InputError as error:
            raise InputError(f"{where} ({name})", f"{shlex.join(step[:1])}: {error}") from error
    return Job(name, run, tuple(steps), base)


def _options(table: dict[str, Any], where: str) -> list[str]:
    words = []
    for key in (key for key in OPTIONS if key in table):
        if isinstance(table[key], bool) or not isinstance(table[key], str | int):
            raise InputError(where, f"{key} = {table[key]} is neither a text nor a whole number")
        words += [f"--{key}", str(table[key])]
    return words


def _overrides(table: dict[str, Any], where: str) -> list[str]:
    return _texts(table.get("set", []), where, "set")


def _texts(values: Any, where: str, key: str) -> list[str]:
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise InputError(where, f"{key} is not a list of texts")
    return values


def _step(text: str, name: str, run: Path, dataset: str, where: str) -> tuple[str, ...]:
    """The words of one command: it is told the run folder, and `evaluate` without a dataset the job's own."""
    try:
        command, *rest = shlex.split(text)
    except ValueError:
        raise InputError(where, f"after: {text!r} is no command") from None
    if command not in AFTER:
        raise InputError(where, f"after: {command} is no step", f"use {', '.join(AFTER)}")
    for word, value in (("{output}", str(run)), ("{dataset}", dataset), ("{name}", name)):
        rest = [part.replace(word, value) for part in rest]
    if command == "evaluate" and (not rest or rest[0].startswith("-")):
        rest = [dataset, *rest]
    return (command, str(run), *rest)


def targets(job: Job, step: Sequence[str]) -> list[Path]:
    """Where a command after the first puts things besides the run folder: what stands after -o."""
    return [job.base / step[i + 1] for i, word in enumerate(step[:-1]) if word == "-o"]


def written(job: Job) -> list[Path]:
    """Where its commands put things."""
    return [path.resolve() for path in (job.run, *(target for step in job.steps[1:] for target in targets(job, step)))]


def _apart(jobs: Sequence[Job], path: Path) -> None:
    """Raise InputError where two jobs have one name, or one writes into what another writes."""
    for i, job in enumerate(jobs):
        for other in jobs[:i]:
            if job.name.casefold() == other.name.casefold():
                raise InputError(path, f"two jobs are called {job.name}", 'tell them apart: name = "..."')
            for mine in written(job):
                for theirs in written(other):
                    if mine == theirs or mine in theirs.parents or theirs in mine.parents:
                        raise InputError(path, f"{other.name} and {job.name} both write to {max(mine, theirs)}", "give each its own output")
