# SPDX-License-Identifier: GPL-3.0-or-later
"""LPIPS, a learned perceptual distance of images, where its weights are installed."""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
# (the package lpips is optional, and pyright takes this file for it)

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from ..errors import InputError

NO_LPIPS = (
    "LPIPS is missing: install the package lpips with its weights, or give the network as a TorchScript file (--lpips FILE). "
    "This program downloads no weights."
)


class Lpips:
    """Perceptual distance of two images.

    Args:
        name: of the network or its file, for the report.
        distance: function of two images (1, 3, H, W) in -1..1 that returns a tensor of one number.
    """

    def __init__(self, name: str, distance: Callable[[torch.Tensor, torch.Tensor], torch.Tensor]) -> None:
        self.name, self._distance = name, distance

    def __call__(self, a: np.ndarray, b: np.ndarray) -> float:
        """Return the distance of two images (H, W, 3) in 0..1; 0 where they are equal."""
        with torch.no_grad():
            return float(self._distance(*(torch.from_numpy(p.astype(np.float32)).permute(2, 0, 1)[None] * 2 - 1 for p in (a, b))))


def find_lpips(file: Path | None, network: str = "alex") -> Lpips | None:
    """Load LPIPS from a TorchScript file, or else from the package lpips.

    Args:
        file: TorchScript module; None: use the package.
        network: of the package, "alex" or "vgg".

    Returns:
        None where neither a file is given nor the package with its weights is installed.

    Raises:
        InputError: when the file is not a TorchScript module.
    """
    if file is not None:
        try:
            return Lpips(file.name, torch.jit.load(str(file), map_location="cpu").eval())
        except (RuntimeError, ValueError, OSError) as error:
            raise InputError(file, f"is not a TorchScript module ({' '.join(str(error).split())[:80]})") from error
    if importlib.util.find_spec("lpips") is None:
        return None
    import lpips

    try:
        return Lpips(f"lpips, {network}", lpips.LPIPS(net=network, verbose=False).eval())
    except OSError as error:  # the package is installed, its weights are not
        logging.getLogger(__name__).warning("lpips has no weights: %s", error)
        return None
