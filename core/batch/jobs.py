# SPDX-License-Identifier: GPL-3.0-or-later
"""Job lists in TOML: datasets to reconstruct, with settings and the commands that follow on each run."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError

Check = Callable[[Sequence[str]], None]  # raises InputError for arguments that are not a valid command
OPTIONS = ("preset", "materials", "device", "seed", "time")
KEYS = {"dataset", "output", "name", "set", "after", *OPTIONS}
AFTER = ("bake", "evaluate", "export", "render")


@dataclass(frozen=True)
class Job:
    """Reconstruction of one dataset and the commands that follow it.

    Attributes:
        name: unique in its list.
        run: its run folder.
        steps: arguments of `irgspp`, one tuple for each command; the first one reconstructs.
        base: folder that relative paths in the arguments start from.
    """

    name: str
    run: Path
    steps: tuple[tuple[str, ...], ...]
    base: Path


def read_jobs(path: Path, check: Check) -> list[Job]:
    """Read the jobs of a TOML file; relative paths start from its folder.

    Args:
        path: of the TOML file.
        check: called with the arguments of each command; raises InputError for invalid ones.

    Raises:
        InputError: when the file is not a job list, has unknown keys or invalid commands, or two jobs would write to the same path; the
            message is one line that names the job and the error.
    """
    tables = _tables(path)
    defaults = _checked_keys(tables.get("defaults", {}), f"{path}: [defaults]", KEYS - {"dataset", "output", "name"})
    jobs = [_job(table, defaults, path, number, check) for number, table in enumerate(tables["job"], 1)]
    _check_outputs(jobs, path)
    return jobs


def _tables(path: Path) -> dict[str, Any]:
    """Parse a job list into its tables "defaults" and "job"."""
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})", "give the path of a job list (TOML)") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, f"is not TOML ({error})", "correct it at that place") from error
    if unknown := sorted(tables.keys() - {"defaults", "job"}):
        raise InputError(path, f"has an unknown {', '.join(unknown)}", "use [defaults] and [[job]]")
    jobs = tables.get("job")
    if not isinstance(jobs, list) or not jobs or not all(isinstance(job, dict) for job in jobs):
        raise InputError(path, "lists no jobs", "begin each with a line [[job]]")
    return tables


def _checked_keys(table: Any, where: str, keys: set[str]) -> dict[str, Any]:
    """Return the table unless it has other keys than `keys`; raises InputError if it does."""
    if not isinstance(table, dict):
        raise InputError(where, "is not a table", "write the keys below a line [defaults]")
    if unknown := sorted(table.keys() - keys):
        raise InputError(where, f"has an unknown {', '.join(unknown)}", f"use {', '.join(sorted(keys))}")
    return table


def _job(table: dict[str, Any], defaults: dict[str, Any], path: Path, number: int, check: Check) -> Job:
    """Turn one table of the list into a job with checked commands."""
    where = f"{path}: job {number}"
    _checked_keys(table, where, KEYS)
    for key in ("dataset", "output"):
        if not isinstance(table.get(key), str) or not table[key]:
            raise InputError(where, f"lacks {key}", f'add {key} = "..."')
    base = path.resolve().parent
    dataset, run = str(base / table["dataset"]), base / table["output"]
    name = table.get("name", run.name)
    if not isinstance(name, str) or not name or any(c in '/\\:*?"<>|' for c in name) or name.startswith("."):
        raise InputError(where, f"{name!r} can't be its name", "use letters, digits and -_")
    arguments = ["reconstruct", dataset, "-o", str(run), *_options(defaults | table, where)]
    arguments += [word for text in (*_overrides(defaults, where), *_overrides(table, where)) for word in ("--set", text)]
    after = _strings((defaults | table).get("after", []), where, "after")
    steps = [tuple(arguments), *(_step(text, name, run, dataset, where) for text in after)]
    for step in steps:
        try:
            check(step)
        except InputError as error:
            raise InputError(f"{where} ({name})", f"{shlex.join(step[:1])}: {error}") from error
    return Job(name, run, tuple(steps), base)


def _options(table: dict[str, Any], where: str) -> list[str]:
    """Return the command-line options of a table's keys."""
    arguments = []
    for key in (key for key in OPTIONS if key in table):
        if isinstance(table[key], bool) or not isinstance(table[key], str | int):
            raise InputError(where, f"{key} = {table[key]} is neither text nor an integer", f'write {key} = "..." or a number')
        arguments += [f"--{key}", str(table[key])]
    return arguments


def _overrides(table: dict[str, Any], where: str) -> list[str]:
    return _strings(table.get("set", []), where, "set")


def _strings(values: Any, where: str, key: str) -> list[str]:
    """Return the values unless they are not a list of strings; raises InputError if so."""
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise InputError(where, f"{key} is not a list of strings", f'write {key} = ["..."]')
    return values


def _step(text: str, name: str, run: Path, dataset: str, where: str) -> tuple[str, ...]:
    """Split one command of `after` into arguments; adds the run folder, and the job's dataset to an `evaluate` without one."""
    try:
        command, *rest = shlex.split(text)
    except ValueError:
        raise InputError(where, f"after: {text!r} is not a command", f"use {', '.join(AFTER)} with their arguments") from None
    if command not in AFTER:
        raise InputError(where, f"after: {command} can't follow a reconstruction", f"use {', '.join(AFTER)}")
    for word, value in (("{output}", str(run)), ("{dataset}", dataset), ("{name}", name)):
        rest = [part.replace(word, value) for part in rest]
    if command == "evaluate" and (not rest or rest[0].startswith("-")):
        rest = [dataset, *rest]
    return (command, str(run), *rest)


def targets(job: Job, step: Sequence[str]) -> list[Path]:
    """Return the paths that a command after the first writes to besides the run folder: the arguments of -o.

    Args:
        job: that the command belongs to.
        step: arguments of the command.
    """
    return [job.base / step[i + 1] for i, word in enumerate(step[:-1]) if word == "-o"]


def _outputs(job: Job) -> list[Path]:
    """Return all paths that the job's commands write to."""
    return [path.resolve() for path in (job.run, *(target for step in job.steps[1:] for target in targets(job, step)))]


def _check_outputs(jobs: Sequence[Job], path: Path) -> None:
    """Raise InputError if two jobs have the same name or write to the same path."""
    for i, job in enumerate(jobs):
        for other in jobs[:i]:
            if job.name.casefold() == other.name.casefold():
                raise InputError(path, f"two jobs are called {job.name}", 'give each its own: name = "..."')
            for mine in _outputs(job):
                for theirs in _outputs(other):
                    if mine == theirs or mine in theirs.parents or theirs in mine.parents:
                        raise InputError(path, f"{other.name} and {job.name} both write to {max(mine, theirs)}", "give each its own output")
