# SPDX-License-Identifier: GPL-3.0-or-later
"""A captured dataset, as `irgspp capture` writes it, of the images of posed_photographs.py: `python captured_dataset.py FOLDER`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from posed_photographs import CENTRE, H, W, write_model

RADIUS = 0.9
MASKED = ("000", "001")  # photographs with a mask; that of the second is doubtful


def write_capture(folder: Path) -> None:
    from PIL import Image

    write_model(folder, "PINHOLE", (90.0, 90.0, W / 2, H / 2), np.eye(4))
    (folder / "masks").mkdir()
    for name in MASKED:
        mask = np.zeros((H, W), np.uint8)
        mask[10:40, 20:70] = 255
        mask[40:44, 20:70] = 128
        Image.fromarray(mask).save(folder / "masks" / f"{name}.png")
    Image.new("RGB", (60, 20), (90, 20, 10)).save(folder / "contact_sheet.png")
    (folder / "report.html").write_text("<html></html>")
    (folder / "exposures.json").write_text(json.dumps({f"{i:03d}": [1.0, 1.0, 1.0] for i in range(12)}))
    write_state(folder)


def write_state(folder: Path, **values: object) -> None:
    """Write capture.json alone into a folder, which is made where it is missing.

    Args:
        folder: of the dataset.
        **values: entries that differ from those of the finished dataset.
    """
    kinds = {"000": "found", "001": "touches the border"}
    state = {
        "format": "irgspp-capture",
        "status": "done",
        "inputs": {"source": str(folder.parent / "photos"), "settings": {}, "seed": 0},
        "source": "photos",
        "bound": {"centre": CENTRE.tolist(), "radius": RADIUS},
        "plane": True,
        "metres_per_unit": None,
        "masked": True,
        "photographs": [{"name": f"{i:03d}", "source": "", "ev": 0.0, "mask": kinds.get(f"{i:03d}", "none")} for i in range(12)],
        "left_out": [{"name": "IMG_7.jpg", "reason": "blurred"}, {"name": "IMG_9.jpg", "reason": "shows something else"}],
        "notes": ["exposure differs"],
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "capture.json").write_text(json.dumps(state | values))


if __name__ == "__main__":
    write_capture(Path(sys.argv[1]))
