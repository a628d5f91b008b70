# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings as text and as JSON: `key=value` overrides, checked against the annotations of core/settings/schema.py."""

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
from .schema import MOST_TEXELS, Range, Settings

TRUTH = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False, "off": False, "0": False}


def with_overrides(settings: Settings, overrides: Iterable[str], notify: Callable[[str], None] | None = None) -> Settings:
    """Return settings with overrides such as `first.iterations=600` or `data.centre=0,0,1` applied.

    Args:
        settings: to start from.
        overrides: `key=value` texts; the value `none` clears an optional setting. A key's name of an earlier version is accepted.
        notify: called with one line for each key that has a new name; None prints the line to stderr.

    Raises:
        InputError: a key is unknown (the error names similar ones), or a value is of the wrong type or out of range.
    """
    for text in overrides:
        key, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"--set {text}", "is not of the form key=value", "write such as --set first.iterations=600")
        old, key = key.strip(), current_key(key.strip())
        if key != old:
            (notify or _warn)(f"--set {old} is now --set {key}")
        settings = _replaced(settings, key, value.strip())
    return check(settings)


def _warn(line: str) -> None:
    print(f"irgspp: {line}", file=sys.stderr)


def check(settings: Settings) -> Settings:
    """Return the same settings; raise InputError where a value is not of its annotated type, out of its range, or would be ignored."""
    for key, annotation, value in _leaves(settings):
        _check_value(key, annotation, value)
    second = settings.second
    if second.brdf != "principled" and second.solver != "joint":
        what = f"{second.brdf} is a BRDF of the joint optimisation alone, and second.solver={second.solver} would ignore it"
        raise InputError("second.brdf", what, "add --set second.solver=joint")
    surface = settings.surface
    if surface.texels > MOST_TEXELS:
        tiles = f"{surface.udim_tiles} x {surface.udim_tiles} tiles of {surface.tile_texels} texels"
        what = f"{tiles} are more than {MOST_TEXELS} texels along a side"
        raise InputError("setting surface.udim_tiles", what, "choose fewer tiles, or a smaller texture size")
    return settings


def to_dict(settings: Settings) -> dict[str, Any]:
    """Return the settings as nested dictionaries of lists, numbers and strings, ready for JSON."""
    return dataclasses.asdict(settings, dict_factory=lambda items: {k: list(v) if isinstance(v, tuple) else v for k, v in items})


def from_dict(data: dict[str, Any], where: object = "settings") -> Settings:
    """Return settings from the dictionaries of `to_dict`.

    Args:
        data: nested dictionaries; missing keys keep their defaults, names of earlier versions are accepted.
        where: file that an error names.

    Raises:
        InputError: a key is unknown, or a value is of the wrong type or out of range.
    """
    try:
        return check(_build(Settings, current_names(data)))
    except TypeError as error:
        fix = "open it with that version, or reconstruct again"
        raise InputError(where, f"has settings of another version of irgspp ({error})", fix) from error


def differences(a: Settings, b: Settings) -> list[str]:
    """Return a line `key: value in a -> value in b` for every setting that differs.

    Args:
        a: settings.
        b: settings.
    """
    old, new = ({key: value for key, _, value in _leaves(s)} for s in (a, b))
    return [f"{key}: {old[key]} -> {new[key]}" for key in old if old[key] != new[key]]


def overrides_from(base: Settings, settings: Settings) -> list[str]:
    """Return the overrides that turn `base` into `settings`, except its preset's name; see `with_overrides`.

    Args:
        base: settings, such as those of a preset.
        settings: settings to reach.
    """
    old = {key: value for key, _, value in _leaves(base)}
    changed = [(key, value) for key, _, value in _leaves(settings) if value != old[key] and key != "preset"]
    return [f"{key}={_text(value)}" for key, value in changed]


def _text(value: Any) -> str:
    """Write a value as `_parse` reads it."""
    if isinstance(value, tuple):
        return ",".join(map(_text, value))
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


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
    """Yield key, annotation and value of every setting."""
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
    """Return the keys that resemble `key`, as a whole or in their last part; all keys where none does."""
    last = {k: k.rpartition(".")[2] for k in keys}
    near = difflib.get_close_matches(key, keys, 3, 0.6)
    near += [k for k in keys if difflib.get_close_matches(key.rpartition(".")[2], [last[k]], 1, 0.7) and k not in near]
    return near or keys


def _strip(annotation: Any) -> tuple[Any, Range | None, bool]:
    """Return the type without annotations, its range, and True where None is allowed."""
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
    """Convert a text to a number, truth value, string or tuple of those; ValueError or KeyError where that fails."""
    if get_origin(kind) is tuple:
        parts, kinds = text.strip("()[] ").split(","), get_args(kind)
        if len(parts) != len(kinds):
            raise ValueError(text)
        return tuple(_parse_plain(k, p.strip()) for k, p in zip(kinds, parts, strict=True))
    if kind is bool:
        return TRUTH[text.lower()]
    if get_origin(kind) is Literal:
        return next((choice for choice in get_args(kind) if str(choice) == text), text)  # choices can be numbers
    return kind(text) if kind in (int, float) else text


def _describe(kind: Any) -> str:
    if get_origin(kind) is tuple:
        return f"{len(get_args(kind))} values separated by commas"
    if get_origin(kind) is Literal:
        return f"one of {', '.join(map(str, get_args(kind)))}"
    return {int: "a whole number", float: "a number", bool: "true or false"}.get(kind, "text")


def _fits(kind: Any, value: Any) -> bool:
    """Return True where a value is of an annotated type; an int passes for a float, a bool does not pass for an int."""
    if get_origin(kind) is tuple:
        return isinstance(value, tuple) and len(value) == len(get_args(kind)) and all(map(_fits, get_args(kind), value))
    if get_origin(kind) is Literal:
        return value in get_args(kind)
    if kind in (int, float):
        number = isinstance(value, int if kind is int else (int, float)) and not isinstance(value, bool)
        return number and abs(value) <= sys.float_info.max  # False for NaN, too
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
        raise InputError(f"setting {key}", f"{value!r} is not a multiple of {limits.multiple}")
