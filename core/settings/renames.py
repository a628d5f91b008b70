# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of settings in earlier versions, so that old commands, job lists and run folders keep working."""

from __future__ import annotations

from typing import Any

GROUPS = {"reflective": "first", "transport": "second"}  # groups of settings: version 0.1 -> now
KEYS = {  # single settings: version 0.1 -> now
    "skip.outside": "skip.background",
    "skip.constants": "skip.cache_hits",
    "skip.open": "skip.reuse_visibility",
    "skip.kept": "skip.cache_rays",
}


def current_key(key: str) -> str:
    """Return today's name of a setting such as `reflective.iterations`; any other name is returned unchanged."""
    group, dot, name = key.partition(".")
    key = GROUPS.get(group, group) + dot + name
    return KEYS.get(key, key)


def current_names(data: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of settings as nested dictionaries (see `to_dict`) with today's names in place of old ones."""
    renamed: dict[str, Any] = {}
    for name, value in data.items():
        group = GROUPS.get(name, name)
        if isinstance(value, dict):
            value = {current_key(f"{group}.{key}").partition(".")[2]: one for key, one in value.items()}
        renamed[group] = value
    return renamed
