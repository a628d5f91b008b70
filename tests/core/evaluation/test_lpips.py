# SPDX-License-Identifier: GPL-3.0-or-later
"""LPIPS from a TorchScript file; other files are refused."""

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.evaluation.lpips import find_lpips


def test_lpips_comes_from_a_file_or_not_at_all(tmp_path):
    class Distance(torch.nn.Module):
        def forward(self, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
            return (a - b).abs().mean() / 2

    torch.jit.trace(Distance(), (torch.zeros(1, 3, 8, 8), torch.ones(1, 3, 8, 8))).save(str(tmp_path / "metric.pt"))
    lpips = find_lpips(tmp_path / "metric.pt")
    image = np.random.default_rng(0).random((8, 8, 3))
    assert lpips(image, image) == 0
    assert lpips(np.zeros((8, 8, 3)), np.full((8, 8, 3), 0.25)) == pytest.approx(0.25)  # 0..1 is given to it as -1..1
    (tmp_path / "text.pt").write_text("no module")
    with pytest.raises(InputError, match="is not a TorchScript module"):
        find_lpips(tmp_path / "text.pt")
