# SPDX-License-Identifier: GPL-3.0-or-later
"""HTML page of an evaluation: its metrics, and rendered images next to the ground truth, in one self-contained file."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from PIL import Image

from . import image_metrics as similarity
from . import metrics, visualisation
from .calibration import NAMES
from .cycles import Comparison
from .ground_truth import Truth
from .light_comparison import LightComparison
from .prediction import Prediction
from .protocols import PLAIN, Protocol

TEMPLATE = "report.html.jinja"  # next to this module
SHOWN = 12  # views with images; the metrics are of all views
SIDE = 320  # pixels of an image's longest side at most
HEADLINE = ("nvs_psnr", "nvs_psnr_ldr", "radiance_psnr", "normal_mae", "albedo_psnr")  # metrics in a view's subtitle
BACKDROP = 0.16  # dark for the same reason as the contact sheet's checkerboard
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 1500px; padding: 0 1rem; background: #18191c; color: #e2e2de }
h1 { font-size: 1.5rem } h2 { font-size: 1.1rem; margin: 2.2rem 0 .5rem } p { color: #a9a9a4 }
table { border-collapse: collapse } td, th { padding: .15rem .9rem .15rem 0; text-align: left; font-weight: normal }
td { font-variant-numeric: tabular-nums; text-align: right }
.row { display: flex; flex-wrap: wrap; gap: 8px; margin-bottom: 10px } figure { margin: 0; width: 210px }
figure.bars div { display: flex; align-items: flex-end; height: 120px; gap: 3px }
figure.bars i { flex: 1; background: #7f9cc0; min-height: 1px }
.wide figure { width: 320px }
figure img { width: 100%; display: block; border-radius: 3px } figcaption { font-size: .8rem; color: #a9a9a4; padding-top: 2px }
"""


@dataclass(frozen=True)
class Tile:
    """Captioned image of the page: the JPEG file, base64-encoded."""

    caption: str
    jpeg: str


@dataclass(frozen=True)
class Section:
    """Part of the page: title, one line of text, and rows of images, `wide` for those of twice their height."""

    title: str
    text: str
    rows: Sequence[Sequence[Tile]]
    wide: bool = False


def page(
    report: dict[str, Any],
    shown: Mapping[str, tuple[Prediction, Truth]],
    protocol: Protocol = PLAIN,
    asset: Sequence[Comparison] = (),
    light: LightComparison | None = None,
) -> str:
    """Render the page as HTML text with all images inside.

    Args:
        report: the evaluation's JSON, see `evaluate` in report.py.
        shown: by name, prediction and ground truth of the views that are shown with images.
        protocol: how images are prepared for their comparison.
        asset: images of the exported mesh by Cycles next to ours; none: no such section.
        light: recovered and true light; None: no such section.
    """
    scale = np.array(report["albedo_scale"] or (1.0, 1.0, 1.0))
    views = f"{len(report['views']) - report['novel']} {report['split']} views"
    views += f" and {report['novel']} under other lights" if report["novel"] else ""
    rows = [(name, metrics.format_metric(value)) for name, value in report["figures"].items()]
    rows += [("albedo_scale", " ".join(f"{s:.3f}" for s in scale))] if report["albedo_scale"] else []
    sections = [] if light is None else [_light_section(light)]
    sections += [_view_section(name, report["views"][name], *pair, scale, protocol) for name, pair in shown.items()]
    sections += [_asset_section(asset)] if asset else []
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(TEMPLATE).render(
        style=STYLE,
        run=report["run"],
        dataset=report["dataset"],
        views=views,
        albedo_scaled=bool(report["albedo_scale"]),
        metrics=rows,
        calibration={name: _bars(curve) for name, curve in report["calibration"].items()},
        protocol=report["protocol"],
        sections=sections,
    )


def _bars(curve: Sequence[dict[str, float]]) -> list[tuple[float, str]]:
    """Return height, in per cent of the largest, and label of each bar of a calibration curve."""
    largest = max((part["error"] for part in curve), default=0) or 1
    return [(100 * part["error"] / largest, f"confidence {part['confidence']:.2f}, error {part['error']:.4f}") for part in curve]


def _light_section(light: LightComparison) -> Section:
    tiles = [_tile(caption, image) for caption, image in light.pictures().values()]
    text = (
        "Lat-long maps: up is +Z, the middle +X. The recovered one is shown after the scale per channel of environment_psnr, both with one "
    )
    text += "exposure. Striped: hardly any light from there reaches the photographs, so that the map holds a guess."
    return Section("Light", text, [tiles], wide=True)


def _view_section(
    name: str, values: dict[str, float], prediction: Prediction, truth: Truth, scale: np.ndarray, protocol: Protocol
) -> Section:
    text = ", ".join(f"{key} {values[key]:.2f}" for key in HEADLINE if key in values)
    rows = [_image_row(prediction, truth, protocol), *_layer_rows(prediction, truth, scale), _relit_row(prediction, truth, protocol)]
    return Section(name, text, rows)


def _asset_section(asset: Sequence[Comparison]) -> Section:
    rows = [
        [
            _tile(f"{one.view} under {one.light}", _opaque(one.ours)),
            _tile("the asset in Cycles", _opaque(one.theirs)),
            _tile("difference, to 0.2", visualisation.heat(np.abs(one.ours - one.theirs).max(-1), 0.2)),
        ]
        for one in asset
    ]
    text = "Our image of the Gaussians next to what Blender's path tracer renders of the mesh and its textures under the same light."
    return Section("The asset in Cycles", text, rows)


def _image_row(prediction: Prediction, truth: Truth, protocol: Protocol) -> list[Tile]:
    if prediction.shaded is None:
        return []
    photograph = similarity.prepare_truth(truth.image, truth, protocol)
    shaded = similarity.prepare_image("nvs", prediction.shaded, truth, protocol)
    radiance = similarity.prepare_image("radiance", prediction.buffers.image, truth, protocol)
    return [
        _tile("photograph", _opaque(photograph)),
        _tile("rendered by its light", _opaque(shaded)),
        _tile("error, to 0.2", visualisation.heat(np.abs(shaded - photograph).max(-1), 0.2)),
        _tile("radiance", _opaque(radiance)),
        _tile("error, to 0.2", visualisation.heat(np.abs(radiance - photograph).max(-1), 0.2)),
    ]


def _layer_rows(prediction: Prediction, truth: Truth, scale: np.ndarray) -> list[list[Tile]]:
    """Show each layer of the G-buffer, next to the true one and its error where that is known."""
    alpha, inside = prediction.buffers.alpha, truth.object
    albedo, normal = prediction.layer("albedo") * scale, prediction.layer("normal")
    rows = [[_tile("albedo", visualisation.colour(albedo, alpha))], [_tile("normal", visualisation.normal(normal, alpha))]]
    if truth.albedo is not None:
        error = np.where(inside, np.abs(albedo - truth.albedo).max(-1), 0)
        rows[0] += [
            _tile("true albedo", visualisation.colour(truth.albedo, truth.alpha)),
            _tile("error, to 0.2", visualisation.heat(error, 0.2)),
        ]
    if truth.normal is not None:
        error = np.where(inside, metrics.normal_angles(normal, truth.normal), 0)
        rows[1] += [
            _tile("true normal", visualisation.normal(truth.normal, truth.alpha)),
            _tile("error, to 20°", visualisation.heat(error, 20)),
        ]
    for name in ("roughness", "metallic"):
        row, true = [_tile(name, visualisation.grey(prediction.layer(name), alpha))], getattr(truth, name)
        if true is not None:
            error = np.where(inside, np.abs(prediction.layer(name) - true), 0)
            row += [
                _tile(f"true {name}", visualisation.grey(true, truth.alpha)),
                _tile("error, to 0.5", visualisation.heat(error, 0.5)),
            ]
        rows.append(row)
    layers = [rows[0] + rows[1], rows[2] + rows[3]]
    if prediction.buffers.confidence is not None:
        known = prediction.layer("confidence")
        layers.append([_tile(f"confidence of {name}", visualisation.grey(known[..., i], alpha)) for i, name in enumerate(NAMES)])
    return layers


def _relit_row(prediction: Prediction, truth: Truth, protocol: Protocol) -> list[Tile]:
    row = []
    for name in (light for light in truth.relit if light in prediction.relit):
        relit = similarity.prepare_image("relight", prediction.relit[name], truth, protocol)
        true = similarity.prepare_truth(truth.relit[name], truth, protocol)
        error = np.abs(relit - true).max(-1)
        row += [_tile(f"true, {name}", _opaque(true)), _tile(f"relit by {name}", _opaque(relit))]
        row.append(_tile("error, to 0.2", visualisation.heat(error, 0.2)))
    return row


def _opaque(rgb: np.ndarray) -> np.ndarray:
    return visualisation.with_alpha(rgb, np.ones(rgb.shape[:2]))


def png_bytes(pixels: np.ndarray) -> bytes:
    """Encode an opaque image (H, W, 4) as PNG."""
    data = io.BytesIO()
    Image.fromarray(visualisation.over(pixels, BACKDROP)).save(data, "PNG")
    return data.getvalue()


def _tile(caption: str, pixels: np.ndarray) -> Tile:
    """Encode an image (H, W, 4) as JPEG, SIDE pixels along its longest side at most."""
    image = Image.fromarray(visualisation.over(pixels, BACKDROP))
    image.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
    data = io.BytesIO()
    image.save(data, "JPEG", quality=92, subsampling=0)
    return Tile(caption, base64.b64encode(data.getvalue()).decode())
