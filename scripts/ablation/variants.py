# SPDX-License-Identifier: GPL-3.0-or-later
"""Variants that the paper's ablation tables compare, as settings of the relighter and of the second stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from irgspp.core.relight.backends import Backend
from irgspp.core.relight.sample_counts import EFFICIENT, EFFICIENT_METALLIC, HQ


@dataclass(frozen=True)
class Variant:
    """One way to render a run.

    Attributes:
        label: name in the table.
        samples: light samples per pixel.
        settings: fields of `RelightSettings` that differ from the default.
        backend: geometry of secondary rays.
    """

    label: str
    samples: int
    settings: dict[str, Any] = field(default_factory=dict)
    backend: Backend = "mesh"

    @property
    def options(self) -> dict[str, Any]:
        """All choices, for JSON."""
        return {"samples": self.samples, "backend": self.backend, **self.settings}


@dataclass(frozen=True)
class Training:
    """One way to train.

    Attributes:
        label: name in the table.
        changes: overrides of the run's settings.
        as_trained: options of `irgspp evaluate` that shade as this training does; its views under the recovered light are rendered so.
    """

    label: str
    changes: tuple[str, ...]
    as_trained: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name of its folders."""
        return self.label.replace(" ", "-").replace(",", "")


FULL = "full"
TRAININGS = (
    Training("without 2DGRT", ("second.indirect=false", "second.shadows=false"), ("--no-indirect", "--no-shadows")),
    Training("without indirect light", ("second.indirect=false",), ("--no-indirect",)),
    Training("without visibility", ("second.shadows=false",), ("--no-shadows",)),
)


def relighting_tables(glossy: bool, counts: Sequence[int]) -> dict[str, list[Variant]]:
    """Return the variants of each table.

    Args:
        glossy: the object is mostly metal.
        counts: numbers of samples at which MIS and strata are compared.
    """
    few = EFFICIENT_METALLIC if glossy else EFFICIENT
    unfiltered = {"denoise": "off"}
    modules: list[tuple[str, dict[str, Any], Backend]] = [
        (FULL, {}, "mesh"),
        ("without the denoiser", unfiltered, "mesh"),
        ("the paper's denoiser", {"denoise": "paper"}, "mesh"),
        ("without MIS (strata)", {"sampling": "stratified"}, "mesh"),
        ("without the mesh (Gaussian backend)", {}, "gaussian"),
        ("without ratio correction", {"ratio": False}, "mesh"),
        ("without radiance transfer", {"transfer": False}, "mesh"),
    ]
    return {
        "Secondary rays": [
            Variant(FULL, HQ),
            Variant("without indirect light", HQ, {"indirect": False}),
            Variant("without visibility", HQ, {"shadows": False}),
            Variant("without both", HQ, {"indirect": False, "shadows": False}),
        ],
        "Efficiency modules": [Variant(label, count, *rest) for count in (few, HQ) for label, *rest in modules],
        "MIS and strata, not denoised": [
            Variant(label, count, unfiltered | {"sampling": method})
            for label, method in (("MIS", "mis"), ("strata", "stratified"))
            for count in counts
        ],
        "Allocation of samples to cosine : GGX : light, not denoised": [
            Variant(":".join(map(str, parts)), few, unfiltered | {"allocation": parts}) for parts in ((1, 1, 2), (1, 4, 3), (2, 1, 1))
        ],
        "Shading normals": [
            Variant("of the Gaussians", HQ, {"mesh_normals": 0.0}),
            Variant("mean of both", HQ),
            Variant("of the mesh", HQ, {"mesh_normals": 1.0}),
        ],
    }
