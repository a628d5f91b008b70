# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows that the IRGS++ paper publishes of its ablations, beside ours by the title of the table."""

from __future__ import annotations

from typing import NamedTuple


class PublishedRow(NamedTuple):
    """Row of a published ablation.

    Attributes:
        label: variant, by our name for it.
        of: scene or scenes of GlossySynthetic.
        samples: light samples per pixel.
        psnr: of relit images, dB.
        full: dB of the full method that it is compared with, on the same scenes.
    """

    label: str
    of: str
    samples: int
    psnr: float
    full: float


CAT = {16: 27.26, 512: 27.34}  # the full method, by samples
ROWS = {
    "Efficiency modules": [
        PublishedRow("full", "cat", 16, CAT[16], CAT[16]),
        PublishedRow("without the denoiser", "cat", 16, 25.74, CAT[16]),
        PublishedRow("without MIS (strata)", "cat", 16, 17.83, CAT[16]),
        PublishedRow("without the mesh (Gaussian backend)", "cat", 16, 27.24, CAT[16]),
        PublishedRow("full", "cat", 512, CAT[512], CAT[512]),
        PublishedRow("without the denoiser", "cat", 512, 26.48, CAT[512]),
        PublishedRow("without MIS (strata)", "cat", 512, 22.22, CAT[512]),
    ],
    "MIS and strata, not denoised": [
        PublishedRow("MIS", "teapot", 16, 23.55, 23.55),
        PublishedRow("strata", "teapot", 1024, 16.15, 23.55),
    ],
    "2DGRT in training": [
        PublishedRow("full", "mean of 8", 16, 25.08, 25.08),
        PublishedRow("without 2DGRT", "mean of 8", 16, 24.25, 25.08),
    ],
}
NOTE = (
    "Rows of the IRGS++ paper are of GlossySynthetic (NeRO's scenes, 800 x 800 pixels), full frame. It does not say how its images were "
    "scaled; they stand where those by GS-ROR's protocol do (--protocol glossy), and their differences are to the paper's full method. On "
    "other scenes or by another protocol, compare the differences alone."
)
