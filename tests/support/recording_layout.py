# SPDX-License-Identifier: GPL-3.0-or-later
"""Stand-in for Blender's UILayout, which exists only in a window: it records what is drawn and rejects what Blender would reject."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import bpy


class Button:
    """Return value of `layout.operator`, which accepts only properties that the operator has."""

    def __init__(self, idname: str) -> None:
        module, name = idname.split(".")
        kind = getattr(getattr(bpy.ops, module), name).get_rna_type()  # raises if there is no such operator
        self.__dict__.update(idname=idname, values={}, known=set(kind.properties.keys()))

    def __setattr__(self, name: str, value: Any) -> None:
        assert name in self.known, f"{self.idname} has no property {name}"
        self.values[name] = value


class RecordingLayout:
    """Layout that records: all layouts made from it share `drawn`, a list of tuples (kind, ...) in drawing order."""

    def __init__(self, parent: RecordingLayout | None = None) -> None:
        self.drawn: list[tuple] = parent.drawn if parent else []
        self._parent = parent
        self.enabled, self.active, self.alert, self.scale_y, self.alignment = True, True, False, 1.0, "EXPAND"
        self.use_property_split = self.use_property_decorate = False

    @property
    def live(self) -> bool:
        return self.enabled and (self._parent is None or self._parent.live)

    def _child(self, **_: Any) -> RecordingLayout:
        return RecordingLayout(self)

    row = column = box = split = grid_flow = _child

    def label(self, text: str = "", icon: str = "NONE") -> None:
        assert icon in known_icons(), icon
        self.drawn.append(("label", text, icon))

    def separator(self, **_: Any) -> None:
        self.drawn.append(("separator",))

    def prop(self, data: Any, name: str, text: str | None = None, icon: str = "NONE", index: int = -1, **_: Any) -> None:
        own = data.keys() if name.startswith("[") else []
        assert name in data.bl_rna.properties or name.strip('["]') in own, f"{data} has no property {name}"
        assert icon in known_icons(), icon
        self.drawn.append(("prop", name, self.live))

    def prop_enum(self, data: Any, name: str, value: str, text: str | None = None, icon: str = "NONE") -> None:
        assert value in data.bl_rna.properties[name].enum_items, f"{name} has no value {value}"
        assert icon in known_icons(), icon
        self.drawn.append(("choice", name, value, self.live))

    def operator(self, idname: str, text: str = "", icon: str = "NONE", **_: Any) -> Button:
        assert icon in known_icons(), icon
        button = Button(idname)
        self.drawn.append(("operator", idname, text, button.values, self.live))
        return button

    def progress(self, factor: float = 0.0, text: str = "", type: str = "BAR") -> None:
        assert 0.0 <= factor <= 1.0
        self.drawn.append(("progress", factor, text))

    def template_icon_view(self, data: Any, name: str, show_labels: bool = False, scale: float = 6.0, **_: Any) -> None:
        assert name in data.bl_rna.properties, f"{data} has no property {name}"
        self.drawn.append(("icon_view", name))

    def template_icon(self, icon_value: int, scale: float) -> None:
        self.drawn.append(("picture", icon_value, scale))

    def template_ID(self, data: Any, name: str, new: str = "") -> None:
        assert name in data.bl_rna.properties
        self.drawn.append(("prop", name, self.live))

    def template_list(self, kind: str, _: str, data: Any, name: str, active: Any, active_name: str, **__: Any) -> None:
        assert hasattr(bpy.types, kind) and hasattr(data, name) and hasattr(active, active_name)
        self.drawn.append(("list", len(getattr(data, name))))

    # --- access to what was drawn

    @property
    def words(self) -> str:
        """All labels, with wrapped lines joined."""
        return " ".join(entry[1] for entry in self.drawn if entry[0] == "label")

    def buttons(self, idname: str) -> list[SimpleNamespace]:
        """Return the buttons of an operator."""
        found = [entry for entry in self.drawn if entry[:2] == ("operator", idname)]
        return [SimpleNamespace(text=text, values=values, live=live) for _, _, text, values, live in found]

    @property
    def properties(self) -> list[str]:
        return [entry[1] for entry in self.drawn if entry[0] == "prop"]


def known_icons() -> set[str]:
    return set(bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items.keys())


def draw(panel: type, context: Any = None) -> RecordingLayout:
    """Draw a panel in the given or current context and return the record."""
    layout = RecordingLayout()
    panel.draw(SimpleNamespace(layout=layout), context or bpy.context)
    return layout
