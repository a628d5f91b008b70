# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the renderer that `render` and `evaluate` share: device, geometry of secondary rays, sampling, denoiser, BRDF."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, get_args

from ..settings.schema import Brdf

if TYPE_CHECKING:
    from ..relight.relight_settings import RelightSettings


def add_renderer_options(one: argparse.ArgumentParser) -> None:
    """Add the options to a command's parser."""
    one.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="device to compute on (default: auto)")
    backend = "geometry for shadows and reflections (default: mesh where the run has one)"
    one.add_argument("--backend", choices=("mesh", "gaussian"), help=backend)
    one.add_argument(
        "--sampling", choices=("mis", "stratified"), default="mis", help="light sampling (default: mis, which needs far fewer samples)"
    )
    one.add_argument(
        "--denoiser",
        choices=("demodulated", "paper"),
        default="demodulated",
        help="filter the light without the albedo (default), or the image as in the paper",
    )
    one.add_argument("--no-denoise", action="store_true", help="images without denoising")
    one.add_argument("--no-indirect", action="store_true", help="shadows, but no interreflections of the object")
    unshadowed = "light that surfaces reflect onto each other arrives there without shadows, as in the paper"
    seen_through = "the object does not hide the light from itself (for comparison; with --no-indirect: direct light alone)"
    one.add_argument("--no-shadows", action="store_true", help=seen_through)
    one.add_argument("--no-transfer", action="store_true", help=unshadowed)
    one.add_argument("--no-ratio", action="store_true", help="sample the unoccluded diffuse light, too, which is known (as in the paper)")
    one.add_argument("--no-divide", action="store_true", help="shade every pixel as one point, also at edges (as in the paper)")
    proportions = "proportions of cosine, visible-normal and light samples (default: 1:1:2; 1:4:3 for metal)"
    one.add_argument("--allocation", type=_proportions, metavar="C:G:E", help=proportions)
    share = "share of the mesh's normals in the shading normals, 0 (those of the Gaussians) to 1 (default: 0.75; 0.5 for metal)"
    one.add_argument("--mesh-normals", type=_fraction, metavar="W", help=share)
    diffuse = "conserving (default) reduces diffuse by a dielectric's reflection, as Blender's Principled does; lambert does not"
    one.add_argument("--diffuse", choices=("lambert", "conserving"), help=diffuse)
    brdf = "reflectance model: principled, or irgs for the baseline IRGS' (default: the one that the run's materials were fitted with)"
    one.add_argument("--brdf", choices=get_args(Brdf), help=brdf)


def relight_settings(args: argparse.Namespace) -> RelightSettings:
    """Return the relighter's settings that the options give; all others are at their defaults."""
    from ..relight.relight_settings import RelightSettings  # imports torch

    return RelightSettings(
        sampling=args.sampling,
        denoise="off" if args.no_denoise else args.denoiser,
        allocation=args.allocation,
        mesh_normals=args.mesh_normals,
        indirect=not args.no_indirect,
        shadows=not args.no_shadows,
        transfer=not args.no_transfer,
        ratio=not args.no_ratio,
        divide=not args.no_divide,
        conserving=None if args.diffuse is None else args.diffuse == "conserving",
        brdf=args.brdf,
    )


def _proportions(text: str) -> tuple[int, int, int]:
    parts = text.split(":")
    if len(parts) != 3 or not all(part.isdecimal() for part in parts) or not any(map(int, parts)):
        raise argparse.ArgumentTypeError(f"{text} is not of the form 1:1:2")
    cosine, ggx, light = map(int, parts)
    return cosine, ggx, light


def _fraction(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text} is not a number from 0 to 1")
    return value
