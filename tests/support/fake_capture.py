# SPDX-License-Identifier: GPL-3.0-or-later
"""Substitute for `irgspp capture PHOTOS -o FOLDER ...` in a job: copies the captured dataset that $IRGSPP_CAPTURED names.

Without a file `go` in PHOTOS it waits until it is cancelled. Where PHOTOS is a capture, only its sphere is changed, as
`--set capture.centre=... --set capture.radius=...` say.
"""

import json
import os
import shutil
import sys
import time
from pathlib import Path


def main(photographs: Path, folder: Path) -> int:
    job, captured = Path(os.environ["IRGSPP_JOB"]), Path(os.environ["IRGSPP_CAPTURED"])
    state = json.loads((captured / "capture.json").read_text())
    state["inputs"]["source"] = str(photographs)
    folder.mkdir(exist_ok=True)
    (folder / "capture.json").write_text(json.dumps({**state, "status": "running"}))
    (job / "events.jsonl").write_text(json.dumps({"phase": "match photographs", "step": 1, "of": 4}) + "\n")
    while not (photographs / "go").exists():
        time.sleep(0.02)
        if (job / "cancel").exists():
            return 130
    shutil.copytree(captured, folder, dirs_exist_ok=True)
    (folder / "capture.json").write_text(json.dumps(state))
    print(folder)
    return 0


def cut_again(folder: Path, words: list[str]) -> int:
    state = json.loads((folder / "capture.json").read_text())
    values = dict(word.removeprefix("capture.").split("=") for word in words if word.startswith("capture."))
    state["bound"] = {"centre": [float(value) for value in values["centre"].split(",")], "radius": float(values["radius"])}
    (folder / "capture.json").write_text(json.dumps(state))
    return 0


if __name__ == "__main__":
    if (Path(sys.argv[2]) / "capture.json").exists():
        sys.exit(cut_again(Path(sys.argv[2]), sys.argv[3:]))
    sys.exit(main(Path(sys.argv[2]), Path(sys.argv[sys.argv.index("-o") + 1])))
