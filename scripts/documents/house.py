# SPDX-License-Identifier: GPL-3.0-or-later
"""The packages of IRGS++ and the imports between them, read from the code, and their drawing as SVG.

A package (`room` in the code) is here a folder or file directly inside `core`, or one of the folders `irgspp_addon`, `operators` and
`panels`. Its layer (`floor`) is one above the highest package that it imports.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path

import grimp

WIDTH, ROW, BOX, GAP = 1120, 76, 40, 16  # pixels
COLOURS = {"core": "#e8f0fe", "irgspp_addon": "#e6f4ea", "operators": "#fef7e0", "panels": "#fce8e6"}


@dataclass(frozen=True)
class House:
    """Packages and imports.

    Attributes:
        rooms: package, without `irgspp` (`core.kernels`, `panels`) -> number of modules inside.
        imports: package -> packages that its modules import.
    """

    rooms: dict[str, int]
    imports: dict[str, set[str]]

    @cached_property
    def circles(self) -> list[list[str]]:
        """Groups of packages that import each other, directly or by way of others."""
        reach = {room: self._reachable(room) for room in self.rooms}
        found = {tuple(sorted(b for b in reach[a] if a in reach[b])) for a in self.rooms if a in reach[a]}
        return [list(circle) for circle in sorted(found)]

    def _reachable(self, room: str) -> set[str]:
        seen: set[str] = set()
        waiting = list(self.imports[room])
        while waiting:
            one = waiting.pop()
            if one not in seen:
                seen.add(one)
                waiting += self.imports[one]
        return seen

    def floor(self, room: str) -> int:
        """Return the layer of a package, 0 for one that imports no other; only where there are no circles."""
        return 1 + max((self.floor(one) for one in self.imports[room]), default=-1)


def read_house(package: str = "irgspp") -> House:
    """Read the imports of the installed package."""
    graph = grimp.build_graph(package)
    rooms: dict[str, int] = {}
    for module in graph.modules:
        if room := room_of(module):
            rooms[room] = rooms.get(room, 0) + 1
    imports: dict[str, set[str]] = {room: set() for room in rooms}
    for module in graph.modules:
        for other in graph.find_modules_directly_imported_by(module):
            a, b = room_of(module), room_of(other)
            if a and b and a != b:
                imports[a].add(b)
    return House(rooms, imports)


def room_of(module: str) -> str:
    """Return the package of a module such as `irgspp.core.kernels.cpu.bvh`; empty for `irgspp`, `core` and other libraries."""
    parts = module.split(".")[1:]
    if not parts or parts[0] not in COLOURS or parts == ["core"]:
        return ""
    return ".".join(parts[:2]) if parts[0] == "core" else parts[0]


def draw(house: House, out: Path) -> None:
    """Write the drawing, top layer first; arrows lead from a package to what it imports.

    Args:
        house: packages and imports without circles.
        out: the SVG file.
    """
    floors: dict[int, list[str]] = {}
    for room in sorted(house.rooms):
        floors.setdefault(house.floor(room), []).append(room)
    place = {}
    for number, floor in enumerate(sorted(floors, reverse=True)):
        step = WIDTH / (len(floors[floor]) + 1)
        place |= {room: (step * (i + 1), 40 + ROW * number) for i, room in enumerate(floors[floor])}
    height = 40 + ROW * len(floors)
    arrows = [_arrow(place[a], place[b]) for a in sorted(place) for b in sorted(house.imports[a]) if _is_direct(house, a, b)]
    boxes = [_box(room, house.rooms[room], *place[room]) for room in sorted(place)]
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" font-size="13">'
    tip = '<path d="M0 1 7 4 0 7z" fill="#9aa0a6"/>'
    marker = f'<marker id="tip" markerWidth="8" markerHeight="8" refX="7" refY="4" orient="auto">{tip}</marker>'
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text("\n".join([head, f"<defs>{marker}</defs>", *arrows, *boxes, "</svg>", ""]), encoding="utf-8")


def _is_direct(house: House, a: str, b: str) -> bool:
    """Leave out arrows that other arrows imply, so that the drawing can be read."""
    return not any(b in house._reachable(one) for one in house.imports[a] if one != b)


def _box(room: str, modules: int, x: float, y: float) -> str:
    name = room.removeprefix("core.")
    width, fill = max(64.0, 12 + 8.2 * len(name)), COLOURS[room.split(".")[0]]
    size = f"{modules} file{'s' if modules > 1 else ''}"
    return (
        f'<rect x="{x - width / 2:.0f}" y="{y - BOX / 2:.0f}" width="{width:.0f}" height="{BOX}" rx="6" fill="{fill}" stroke="#5f6368"/>'
        f'<text x="{x:.0f}" y="{y - 2:.0f}" text-anchor="middle" font-weight="bold">{escape(name)}</text>'
        f'<text x="{x:.0f}" y="{y + 14:.0f}" text-anchor="middle" font-size="10" fill="#5f6368">{size}</text>'
    )


def _arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    (x0, y0), (x1, y1) = start, end
    bend = (y1 - y0) / 2
    path = f"M{x0:.0f} {y0 + BOX / 2:.0f} C{x0:.0f} {y0 + bend:.0f} {x1:.0f} {y1 - bend:.0f} {x1:.0f} {y1 - BOX / 2:.0f}"
    return f'<path d="{path}" fill="none" stroke="#9aa0a6" marker-end="url(#tip)"/>'
