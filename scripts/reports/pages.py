# SPDX-License-Identifier: GPL-3.0-or-later
"""Renderer of the templates next to it, which escape every value, and the parts that all pages share: table rows and embedded images."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from PIL import Image

ENVIRONMENT = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


@dataclass(frozen=True)
class Cell:
    """Cell of a table: its text, and whether it is aligned to the left as text or to the right as a number."""

    content: str
    is_text: bool = True


@dataclass(frozen=True)
class Row:
    """Row of a table; `kind` is its CSS class, if any."""

    cells: Sequence[Cell]
    kind: str = ""


def render(template: str, **values: Any) -> str:
    """Render a page.

    Args:
        template: name of a file in `templates/` without its suffix `.html.jinja`.
        **values: variables of the template; they are escaped unless they are marked as safe.

    Returns:
        The HTML text.
    """
    return ENVIRONMENT.get_template(f"{template}.html.jinja").render(**values)


def embedded_jpeg(file: Path, longest: int, **options: Any) -> str:
    """Return an image file as the `data:` address of a JPEG.

    Args:
        file: image in any format that Pillow reads.
        longest: pixels of the longer side at most; larger images are reduced.
        **options: options of Pillow's JPEG writer, such as `quality`.
    """
    with Image.open(file) as opened:
        image = opened.convert("RGB")
    image.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    data = io.BytesIO()
    image.save(data, "JPEG", **options)
    return "data:image/jpeg;base64," + base64.b64encode(data.getvalue()).decode()
