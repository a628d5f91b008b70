# SPDX-License-Identifier: GPL-3.0-or-later
"""The report as one HTML file: figures, and what was rendered beside what is true."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from PIL import Image

from . import image_metrics as similarity
from . import metrics, visualisation
from .cycles import Comparison
from .ground_truth import Truth
from .prediction import Prediction
from .protocols import PLAIN, Protocol

SHOWN = 12  # views with images; figures are of all
SIDE = 320  # pixels of an image's longest side at most
BEST = ("nvs_psnr", "nvs_psnr_ldr", "radiance_psnr", "normal_mae", "albedo_psnr")
BACKDROP = 0.16  # dark for the reason that the contact sheet's is
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 1500px; padding: 0 1rem; background: #18191c; color: #e2e2de }
h1 { font-size: 1.5rem } h2 { font-size: 1.1rem; margin: 2.2rem 0 .5rem } p { color: #a9a9a4 }
table { border-collapse: collapse } td, th { padding: .15rem .9rem .15rem 0; text-align: left; font-weight: normal }
td { font-variant-numeric: tabular-nums; text-align: right }
.row { display: flex; flex-wrap: wrap; gap: 8px; margin-bottom: 10px } figure { margin: 0; width: 210px }
figure img { width: 100%; display: block; border-radius: 3px } figcaption { font-size: .8rem; color: #a9a9a4; padding-top: 2px }
"""


def page(
    report: dict[str, Any], shown: Mapping[str, tuple[Prediction, Truth]], how: Protocol = PLAIN, asset: Sequence[Comparison] = ()
) -> str:
    """The whole page, images of the `shown` views inside; `asset`: what Cycles makes of the exported object."""
    scale = np.array(report["albedo_scale"] or (1.0, 1.0, 1.0))
    shown_views = [_section(name, report["views"][name], *pair, scale, how) for name, pair in shown.items()]
    sections = "".join([*shown_views, _asset_section(asset)])
    rows = [f"<tr><th>{escape(name)}</th><td>{metrics.shown(value)}</td></tr>" for name, value in report["figures"].items()]
    if report["albedo_scale"]:
        rows.append(f"<tr><th>albedo_scale</th><td>{' '.join(f'{s:.3f}' for s in scale)}</td></tr>")
    views = f"{len(report['views']) - report['novel']} {escape(report['split'])} views"
    views += f" and {report['novel']} under other lights" if report["novel"] else ""
    about = f"{escape(str(report['run']))} against the {views} of {escape(str(report['dataset']))}."
    if report["albedo_scale"]:
        about += " Albedo is shown after the scale per channel that the figures use."
    return (
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>Evaluation</title><style>{STYLE}</style>"
        f"<h1>Evaluation</h1><p>{about} PSNR in dB, angles in degrees, lengths in scene units; means over the views. "
        "Heat: dark is exact.</p>"
        f"<table>{''.join(rows)}</table><p>{'<br>'.join(escape(line) for line in report['protocol'])}</p>{sections}</html>\n"
    )


def _section(name: str, figures: dict[str, float], prediction: Prediction, truth: Truth, scale: np.ndarray, how: Protocol) -> str:
    rows = [_image_row(prediction, truth, how), *_layer_rows(prediction, truth, scale), _relit_row(prediction, truth, how)]
    best = ", ".join(f"{key} {figures[key]:.2f}" for key in BEST if key in figures)
    return f"<h2>{escape(name)}</h2><p>{best}</p>" + "".join(f"<div class='row'>{''.join(row)}</div>" for row in rows)


def _asset_section(asset: Sequence[Comparison]) -> str:
    if not asset:
        return ""
    rows = [
        [
            _figure(f"{one.view} under {one.light}", _opaque(one.ours)),
            _figure("the asset in Cycles", _opaque(one.theirs)),
            _figure("difference, to 0.2", visualisation.heat(np.abs(one.ours - one.theirs).max(-1), 0.2)),
        ]
        for one in asset
    ]
    about = "Our image of the Gaussians beside what Blender's path tracer makes of the mesh, its textures and the same light."
    return f"<h2>The asset in Cycles</h2><p>{about}</p>" + "".join(f"<div class='row'>{''.join(row)}</div>" for row in rows)


def _image_row(prediction: Prediction, truth: Truth, how: Protocol) -> list[str]:
    if prediction.shaded is None:
        return []
    photograph = similarity.shown_truth(truth.image, truth, how)
    shaded = similarity.shown("nvs", prediction.shaded, truth, how)
    radiance = similarity.shown("radiance", prediction.buffers.image, truth, how)
    return [
        _figure("photograph", _opaque(photograph)),
        _figure("rendered by its light", _opaque(shaded)),
        _figure("error, to 0.2", visualisation.heat(np.abs(shaded - photograph).max(-1), 0.2)),
        _figure("radiance", _opaque(radiance)),
        _figure("error, to 0.2", visualisation.heat(np.abs(radiance - photograph).max(-1), 0.2)),
    ]


def _layer_rows(prediction: Prediction, truth: Truth, scale: np.ndarray) -> list[list[str]]:
    """Each layer, beside the true one and its error where that is known."""
    alpha, inside = prediction.buffers.alpha, truth.object
    albedo, normal = prediction.layer("albedo") * scale, prediction.layer("normal")
    rows = [[_figure("albedo", visualisation.colour(albedo, alpha))], [_figure("normal", visualisation.normal(normal, alpha))]]
    if truth.albedo is not None:
        error = np.where(inside, np.abs(albedo - truth.albedo).max(-1), 0)
        rows[0] += [
            _figure("true albedo", visualisation.colour(truth.albedo, truth.alpha)),
            _figure("error, to 0.2", visualisation.heat(error, 0.2)),
        ]
    if truth.normal is not None:
        error = np.where(inside, metrics.normal_angles(normal, truth.normal), 0)
        rows[1] += [
            _figure("true normal", visualisation.normal(truth.normal, truth.alpha)),
            _figure("error, to 20°", visualisation.heat(error, 20)),
        ]
    for name in ("roughness", "metallic"):
        row, true = [_figure(name, visualisation.grey(prediction.layer(name), alpha))], getattr(truth, name)
        if true is not None:
            error = np.where(inside, np.abs(prediction.layer(name) - true), 0)
            row += [
                _figure(f"true {name}", visualisation.grey(true, truth.alpha)),
                _figure("error, to 0.5", visualisation.heat(error, 0.5)),
            ]
        rows.append(row)
    return [rows[0] + rows[1], rows[2] + rows[3]]


def _relit_row(prediction: Prediction, truth: Truth, how: Protocol) -> list[str]:
    row = []
    for name in (light for light in truth.relit if light in prediction.relit):
        relit, true = similarity.shown("relight", prediction.relit[name], truth, how), similarity.shown_truth(truth.relit[name], truth, how)
        error = np.abs(relit - true).max(-1)
        row += [_figure(f"true, {name}", _opaque(true)), _figure(f"relit by {name}", _opaque(relit))]
        row.append(_figure("error, to 0.2", visualisation.heat(error, 0.2)))
    return row


def _opaque(rgb: np.ndarray) -> np.ndarray:
    return visualisation.with_alpha(rgb, np.ones(rgb.shape[:2]))


def _figure(caption: str, pixels: np.ndarray) -> str:
    """An <img> with its bytes inside."""
    image = Image.fromarray(visualisation.over(pixels, BACKDROP))
    image.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
    data = io.BytesIO()
    image.save(data, "JPEG", quality=92, subsampling=0)
    source = base64.b64encode(data.getvalue()).decode()
    return f"<figure><img alt='{escape(caption)}' src='data:image/jpeg;base64,{source}'><figcaption>{escape(caption)}</figcaption></figure>"
