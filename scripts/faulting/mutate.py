# SPDX-License-Identifier: GPL-3.0-or-later
"""Mutations of files: bytes, numbers and structure, in the ways that files get damaged and that attackers forge them."""

from __future__ import annotations

import io
import json
import random
import re
import struct
import zipfile
import zlib
from typing import Any

WHOLE = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 1 << 20, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)
REAL = (0.0, -0.0, 1e-320, 1e-30, 1e30, 1e308, float("inf"), float("-inf"), float("nan"), -1.0)
WORDS = ("", "0", "-1", "1e999", "-1e999", "nan", "inf", "1e-320", "9" * 400, "0x10", "1_0", "..")
WORDS += ("../../etc/passwd", "/dev/zero", "a" * 5000, "\0", "\ud800", "é\u202e", "C:\\x", "%s%n")
WORDS += ("${HOME}", "null", "true", "[]", "{}", "\n", "١٢")
ZIP, PNG = b"PK\3\4", b"\x89PNG\r\n\x1a\n"
TOKEN = re.compile(r"[-+]?\d[\w.+-]*|[A-Za-z_]\w*|[^\w\s]")


def mutated(data: bytes, chance: random.Random, others: list[bytes], text: bool) -> bytes:
    """Return a broken version of a valid file.

    Args:
        data: content of the file.
        chance: random numbers.
        others: valid files that parts may come from.
        text: True for text files.
    """
    if data.startswith((ZIP, PNG)) and chance.random() < 0.5:
        return _archive(data, chance) if data.startswith(ZIP) else _png(data, chance)
    for _ in range(1 + min(int(chance.expovariate(0.7)), 8)):
        ways = TEXT if text and chance.random() < 0.6 else BYTES
        data = chance.choice(ways)(data, chance, others)
    return data


def _archive(data: bytes, chance: random.Random) -> bytes:
    """Mutate one of the files in a zip deliberately: with a correct checksum."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(made, "w") as new:
        entries = old.infolist()
        chosen = entries[0] if chance.random() < 0.3 else chance.choice(entries)  # a checkpoint's first file describes the others
        for entry in entries:
            part = old.read(entry)
            new.writestr(entry, mutated(part, chance, [part], False) if entry is chosen else part)
    return made.getvalue()


def _png(data: bytes, chance: random.Random) -> bytes:
    """Mutate one of a PNG's chunks deliberately: with correct checksums."""
    chunks, at = [], len(PNG)
    while at < len(data):
        (size,) = struct.unpack_from(">I", data, at)
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += size + 12
    chosen = chance.randrange(len(chunks))
    kind, body = chunks[chosen]
    if kind == b"IDAT":
        chunks[chosen] = kind, zlib.compress(mutated(zlib.decompress(body), chance, [body], False))
    else:
        chunks[chosen] = kind, mutated(body, chance, [data], False)
    return PNG + b"".join(struct.pack(">I", len(b)) + k + b + struct.pack(">I", zlib.crc32(k + b)) for k, b in chunks)


def _flip(data: bytes, chance: random.Random, others: list[bytes]) -> bytes:
    """Flip a bit."""
    out = bytearray(data)
    if out:
        out[chance.randrange(len(out))] ^= 1 << chance.randrange(8)
    return bytes(out)


def _number(data: bytes, chance: random.Random, others: list[bytes]) -> bytes:
    """Overwrite bytes by an extreme number, mostly in the header."""
    kind = chance.choice("BHIQfd")
    value = chance.choice(REAL) if kind in "fd" else chance.choice(WHOLE) & ((1 << (8 * struct.calcsize(kind))) - 1)
    try:
        packed = struct.pack(chance.choice("<>") + kind, value)
    except OverflowError:
        packed = struct.pack("<f", float("inf"))
    at = chance.randrange(len(data) + 1)
    if chance.random() < 0.7:  # headers hold sizes and counts
        at = min(at, chance.randrange(1, 200))
    return data[:at] + packed + data[at + len(packed) :]


def _cut(data: bytes, chance: random.Random, others: list[bytes]) -> bytes:
    """Truncate the file."""
    return data[: chance.randrange(len(data) + 1)]


def _drop(data: bytes, chance: random.Random, others: list[bytes]) -> bytes:
    """Remove some bytes."""
    at = chance.randrange(len(data) + 1)
    return data[:at] + data[at + chance.randrange(1, 64) :]


def _insert(data: bytes, chance: random.Random, others: list[bytes]) -> bytes:
    """Insert some bytes."""
    at = chance.randrange(len(data) + 1)
    return data[:at] + chance.choice((chance.randbytes(chance.randrange(1, 32)), b"\0" * 16, b"\xff" * 16)) + data[at:]


def _repeat(data: bytes, chance: random.Random, others: list[bytes]) -> bytes:
    """Repeat some bytes."""
    at = chance.randrange(len(data) + 1)
    return data[:at] + data[at : at + chance.randrange(1, 256)] * chance.randrange(2, 40) + data[at:]


def _splice(data: bytes, chance: random.Random, others: list[bytes]) -> bytes:
    """Continue the file with the end of another."""
    other = chance.choice(others)
    return data[: chance.randrange(len(data) + 1)] + other[chance.randrange(len(other) + 1) :]


def _token(data: bytes, chance: random.Random, others: list[bytes]) -> bytes:
    """Replace a word, number or sign of a text."""
    text = data.decode("utf-8", "replace")
    found = list(TOKEN.finditer(text))
    if not found:
        return _insert(data, chance, others)
    token = chance.choice(found)
    other = chance.choice((chance.choice(WORDS), chance.choice(found)[0], "", token[0] * 3))
    return (text[: token.start()] + other + text[token.end() :]).encode("utf-8", "surrogatepass")


def _line(data: bytes, chance: random.Random, others: list[bytes]) -> bytes:
    """Remove, repeat or exchange a line of a text."""
    lines = data.split(b"\n")
    at = chance.randrange(len(lines))
    lines[at : at + 1] = chance.choice(([], [lines[at]] * 2, [lines[chance.randrange(len(lines))]], [lines[at] * 2], [b""]))
    return b"\n".join(lines)


def _tree(data: bytes, chance: random.Random, others: list[bytes]) -> bytes:
    """Replace or remove a value of a JSON tree."""
    try:
        root = json.loads(data)
    except (ValueError, RecursionError):
        return _token(data, chance, others)
    places: list[tuple[Any, Any]] = []
    _collect(root, places)
    if not places:
        return _token(data, chance, others)
    parent, key = chance.choice(places)
    if chance.random() < 0.2:
        del parent[key]
    else:
        parent[key] = chance.choice((_strange(chance), chance.choice(places)[0], _nested(chance)))
    try:
        return json.dumps(root).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):  # it has become a part of itself
        return data


def _collect(value: Any, places: list[tuple[Any, Any]]) -> None:
    """Collect the container and key of each value of a tree."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in list(pairs):
        places.append((value, key))
        _collect(child, places)


def _strange(chance: random.Random) -> Any:
    """Return an unusual value."""
    return chance.choice((*WORDS, *REAL, *WHOLE, None, True, False, [], {}, [[]], {"": {}}, 10**400, -(10**30)))


def _nested(chance: random.Random) -> Any:
    """Return an unusual value in deeply nested lists and objects."""
    value: Any = _strange(chance)
    for _ in range(chance.choice((1, 3, 40, 400))):
        value = [value] if chance.random() < 0.5 else {"a": value}
    return value


BYTES = (_flip, _flip, _number, _number, _number, _cut, _drop, _insert, _repeat, _splice)
TEXT = (_token, _token, _token, _line, _tree, _tree)
