# SPDX-License-Identifier: GPL-3.0-or-later
"""Substitute for the engine in a job, with the same files and no libraries: `counter.py STEPS` counts until cancelled, or to its end."""

import json
import os
import sys
import time


def main(folder: str, steps: int) -> int:
    """Count, write events and look for the request to cancel; return the exit status.

    Args:
        folder: folder of the job.
        steps: number to count to.
    """
    print("starting", file=sys.stderr, flush=True)
    for step in range(1, steps + 1):
        with open(os.path.join(folder, "events.jsonl"), "a", encoding="utf-8") as file:
            file.write(json.dumps({"time": time.time(), "phase": "count", "step": step, "of": steps, "loss": 1 / step}) + "\n")
        if os.path.exists(os.path.join(folder, "cancel")):
            return 130
        time.sleep(0.02)
    print("counted", steps)
    return 0


if __name__ == "__main__":
    sys.exit(main(os.environ["IRGSPP_JOB"], int(sys.argv[1])))
