# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings as text and as JSON: `key=value` overrides checked against the annotations of core/settings/schema.py."""

from __future__ import annotations

import dataclasses
import difflib
import math
import sys
import types
from collections.abc import Callable, Iterable, Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from ..errors import InputError
from .renames import current_key, current_names
from .schema import Range, Settings

TRUTH = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False, "off": False, "0": False}


def with_overrides(settings: Settings, overrides: Iterable[str], notify: Callable[[str], None] | None = None) -> Settings:
    """Return settings changed by texts such as `first.iterations=600` or `data.centre=0,0,1`; `none` empties an optional one.

    Args:
        settings: what to start from.
        overrides: `key=value` texts. A key's name of an earlier version is accepted.
        notify: called with one line for each key that has a new name; None prints the line to stderr.

    Raises:
        InputError: an unknown key (the error names similar ones), a value of the wrong type, or one out of range.
    """
    for text in overrides:
        key, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"--set {text}", "is not of the form key=value")
        old, key = key.strip(), current_key(key.strip())
        if key != old:
            (notify or _warn)(f"--set {old} is now --set {key}")
        settings = _replaced(settings, key, value.strip())
    return check(settings)


def _warn(line: str) -> None:
    print(f"irgspp: {line}", file=sys.stderr)


def check(settings: Settings) -> Settings:
    """The same settings. Raises InputError where a value is not of its annotated type or range."""
    for key, annotation, value in _leaves(settings):
        _check_value(key, annotation, value)
    return settings


def to_dict(settings: Settings) -> dict[str, Any]:
    """Plain nested dictionaries, lists, numbers and strings, ready for JSON."""
    return dataclasses.asdict(settings, dict_factory=lambda items: {k: list(v) if isinstance(v, tuple) else v for k, v in items})


def from_dict(data: dict[str, Any], where: object = "settings") -> Settings:
    """The inverse of `to_dict`; missing keys keep their defaults. Raises InputError for unknown keys and wrong values, naming `where`."""
    try:
        return check(_build(Settings, current_names(data)))
    except TypeError as error:
        raise InputError(where, f"settings of another version of this tool ({error})") from error


def differences(a: Settings, b: Settings) -> list[str]:
    """Lines `key: value in a -> value in b` for every setting that differs."""
    old, new = ({key: value for key, _, value in _leaves(s)} for s in (a, b))
    return [f"{key}: {old[key]} -> {new[key]}" for key in old if old[key] != new[key]]


def _build(cls: type, data: dict[str, Any]) -> Any:
    hints = get_type_hints(cls)
    values: dict[str, Any] = {}
    for name, value in data.items():
        kind = hints.get(name)
        if isinstance(value, dict) and isinstance(kind, type) and dataclasses.is_dataclass(kind):
            values[name] = _build(kind, value)
        else:
            values[name] = tuple(value) if isinstance(value, list) else value
    return cls(**values)


def _leaves(group: Any, prefix: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Key, annotation and value of every setting."""
    hints = get_type_hints(type(group), include_extras=True)
    for entry in dataclasses.fields(group):
        value = getattr(group, entry.name)
        if dataclasses.is_dataclass(value):
            yield from _leaves(value, f"{prefix}{entry.name}.")
        else:
            yield prefix + entry.name, hints[entry.name], value


def _replaced(settings: Settings, key: str, text: str) -> Settings:
    annotations = {k: a for k, a, _ in _leaves(settings) if k != "preset"}
    if key not in annotations:
        raise InputError(f"--set {key}", "no such setting", f"similar: {', '.join(_similar(key, list(annotations)))}")
    value = _parse(key, annotations[key], text)
    group, _, name = key.rpartition(".")
    if not group:
        return dataclasses.replace(settings, **{name: value})
    return dataclasses.replace(settings, **{group: dataclasses.replace(getattr(settings, group), **{name: value})})


def _similar(key: str, keys: list[str]) -> list[str]:
    """Keys that look alike, as a whole or in their last part; all of them where none does."""
    last = {k: k.rpartition(".")[2] for k in keys}
    near = difflib.get_close_matches(key, keys, 3, 0.6)
    near += [k for k in keys if difflib.get_close_matches(key.rpartition(".")[2], [last[k]], 1, 0.7) and k not in near]
    return near or keys


def _strip(annotation: Any) -> tuple[Any, Range | None, bool]:
    """The bare type, its range, and whether None is allowed."""
    limits = None
    if get_origin(annotation) is Annotated:
        annotation, *extras = get_args(annotation)
        limits = next((e for e in extras if isinstance(e, Range)), None)
    if get_origin(annotation) in (Union, types.UnionType):
        inner = [a for a in get_args(annotation) if a is not types.NoneType]
        return inner[0], limits, True
    return annotation, limits, False


def _parse(key: str, annotation: Any, text: str) -> Any:
    kind, _, optional = _strip(annotation)
    if optional and text.lower() == "none":
        return None
    try:
        return _parse_plain(kind, text)
    except (ValueError, KeyError) as error:
        raise InputError(f"--set {key}={text}", f"is not {_describe(kind)}") from error


def _parse_plain(kind: Any, text: str) -> Any:
    """Text as a number, truth value, text or tuple of those."""
    if get_origin(kind) is tuple:
        parts, kinds = text.strip("()[] ").split(","), get_args(kind)
        if len(parts) != len(kinds):
            raise ValueError(text)
        return tuple(_parse_plain(k, p.strip()) for k, p in zip(kinds, parts, strict=True))
    if kind is bool:
        return TRUTH[text.lower()]
    return kind(text) if kind in (int, float) else text


def _describe(kind: Any) -> str:
    if get_origin(kind) is tuple:
        return f"{len(get_args(kind))} values separated by commas"
    if get_origin(kind) is Literal:
        return f"one of {', '.join(map(str, get_args(kind)))}"
    return {int: "a whole number", float: "a number", bool: "true or false"}.get(kind, "text")


def _fits(kind: Any, value: Any) -> bool:
    """True where a value is of an annotated type; an int is a float, a bool is no int."""
    if get_origin(kind) is tuple:
        return isinstance(value, tuple) and len(value) == len(get_args(kind)) and all(map(_fits, get_args(kind), value))
    if get_origin(kind) is Literal:
        return value in get_args(kind)
    if kind in (int, float):
        known = isinstance(value, int if kind is int else (int, float)) and not isinstance(value, bool)
        return known and abs(value) <= sys.float_info.max  # false for NaN, too
    return isinstance(value, kind)


def _check_value(key: str, annotation: Any, value: Any) -> None:
    kind, limits, optional = _strip(annotation)
    if optional and value is None:
        return
    if not _fits(kind, value):
        raise InputError(f"setting {key}", f"{value!r} is not {_describe(kind)}")
    if limits and not limits.low <= value <= limits.high:
        above = f" and at most {limits.high:g}" if math.isfinite(limits.high) else ""
        raise InputError(f"setting {key}", f"{value!r} is out of range", f"must be at least {limits.low:g}{above}")
    if limits and limits.multiple and value % limits.multiple:
        raise InputError(f"setting {key}", f"{value!r} is no multiple of {limits.multiple}")
