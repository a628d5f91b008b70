# SPDX-License-Identifier: GPL-3.0-or-later
"""Drive the extension in a real Blender window by real clicks, and take images at each step.

    python scripts/build_extension.py -o dist
    python scripts/window/run.py --zip dist/irgspp-0.1.0.zip --engine .venv/bin/python -o images
    python scripts/window/run.py ... --story story_eight_clicks     # from the open window to the relit demo, in at most 8 clicks

Needs Linux with Blender, xdotool and ImageMagick (`import`); without a screen also Xvfb (`xvfb-run`). Blender starts with settings of its
own in a temporary folder. Exit status: 0 done, 1 a step failed, 2 bad usage, 3 Blender ended or took too long.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
STORIES = sorted(path.stem for path in HERE.glob("story_*.py"))


def main() -> int:
    """Install the extension, run a story, and return the exit status."""
    args = arguments()
    for tool in ("xdotool", "import", *([] if os.environ.get("DISPLAY") else ["xvfb-run"])):
        if shutil.which(tool) is None:
            print(f"window: {tool} is not installed", file=sys.stderr)
            return 2
    args.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="irgspp-window-") as user:
        os.environ["BLENDER_USER_RESOURCES"] = user
        blender(args, "--command", "extension", "install-file", "-r", "user_default", "--enable", str(args.zip.resolve()))
        blender(args, "--background", "--python-exit-code", "1", "--python-expr", PREFERENCES)
        return drive(args)


PREFERENCES = (
    "import bpy; view = bpy.context.preferences.view; view.show_splash = False; view.show_developer_ui = False; "
    "bpy.context.preferences.use_preferences_save = False; bpy.ops.wm.save_userpref()"
)


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--zip", type=Path, required=True, help="zip of the extension")
    parser.add_argument("--engine", default=os.environ.get("IRGSPP_PYTHON", ""), help="Python with the engine (default: $IRGSPP_PYTHON)")
    parser.add_argument("-o", dest="output", type=Path, required=True, help="folder for the images")
    parser.add_argument("--story", choices=STORIES, default="story_first_day", help="story to run (default: story_first_day)")
    parser.add_argument("--run", type=Path, help="a finished run's folder, for the stories of one; a copy is used")
    parser.add_argument("--photographs", type=Path, help="a folder of photographs without cameras, for story_capture; a copy is used")
    parser.add_argument("--blender", default="blender", help="Blender's executable")
    parser.add_argument("--size", default="1600x1000", help="of the window (default: 1600x1000)")
    parser.add_argument("--timeout", type=float, default=900.0, help="seconds (default: 900)")
    args = parser.parse_args()
    if args.run:
        os.environ["IRGSPP_RUN"] = str(args.run.resolve())
    elif args.story in ("story_library", "story_relight", "story_result"):
        parser.error(f"--run is needed for {args.story}")
    if args.photographs:
        os.environ["IRGSPP_PHOTOGRAPHS"] = str(args.photographs.resolve())
    elif args.story == "story_capture":
        parser.error("--photographs is needed for story_capture")
    return args


def blender(args: argparse.Namespace, *words: str) -> None:
    """Run Blender in the background, and show its output where it fails.

    Args:
        args: parsed options.
        *words: arguments of Blender.
    """
    done = subprocess.run([args.blender, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"window: blender {words[0]} failed: {(done.stdout + done.stderr).strip()}")


def drive(args: argparse.Namespace) -> int:
    """Run the story in a window, or in two one after the other, and return the exit status."""
    end, again = args.output / "end.json", args.output / "again"
    for file in (end, again):
        file.unlink(missing_ok=True)
    run_window(args, end, "blender.log")
    if again.exists():  # the story has quit Blender, and goes on in the next one
        again.unlink()
        os.environ["IRGSPP_AGAIN"] = "1"
        run_window(args, end, "blender_again.log")
    if not end.exists():
        print(f"window: Blender ended or took too long; see {args.output / 'blender.log'}", file=sys.stderr)
        return 3
    result = json.loads(end.read_text())
    print(result["error"] or f"window: images in {args.output}", file=sys.stderr if result["error"] else sys.stdout)
    for name, figure in result["figures"].items():
        print(f"  {name}: {figure}")
    for name, time_taken in result["slowest"].items():
        print(f"  slowest {name}: {time_taken}")
    return 1 if result["error"] else 0


def run_window(args: argparse.Namespace, end: Path, log_name: str) -> None:
    """Run the story in a window until it or Blender ends.

    Args:
        args: parsed options.
        end: file that the story writes at its end.
        log_name: name of the file for Blender's output.
    """
    width, height = args.size.split("x")
    command = [args.blender, "--window-geometry", "0", "0", width, height, "--python", str(HERE / f"{args.story}.py")]
    command += ["--", str(args.output.resolve()), args.engine]
    if not os.environ.get("DISPLAY"):
        command = ["xvfb-run", "-a", "-s", f"-screen 0 {args.size}x24 +extension GLX", *command]
    with (args.output / log_name).open("w") as log:
        child = subprocess.Popen(
            command, stdout=log, stderr=subprocess.STDOUT, env={**os.environ, "PYTHONUNBUFFERED": "1"}, start_new_session=True
        )
        deadline = time.monotonic() + args.timeout
        while child.poll() is None and not end.exists() and time.monotonic() < deadline:
            time.sleep(0.5)
        try:
            child.wait(timeout=20.0)  # the story ends by quitting Blender
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, 9)
            child.wait()


if __name__ == "__main__":
    sys.exit(main())
