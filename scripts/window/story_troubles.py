# SPDX-License-Identifier: GPL-3.0-or-later
"""Story of missing and wrong input: preferences, folders that are not datasets, a bad setting, a run that would be replaced."""

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import bpy
import browsing
import driver


def story() -> Iterator[float]:
    """Run the story."""
    work = Path(tempfile.mkdtemp(prefix="irgspp-story-"))
    bpy.ops.wm.save_as_mainfile(filepath=str(work / "troubles.blend"))
    settings, jobs = bpy.context.scene.irgspp, driver.extension_module("irgspp_addon.jobs.queue")
    yield from driver.open_sidebar("IRGS++")
    yield from open_preferences()
    yield from driver.open_sidebar("IRGS++")
    yield from driver.wait(lambda: driver.extension_module("irgspp_addon.engine.process").status().state == "ok", 120)

    (work / "empty").mkdir()
    settings.dataset = "//empty"
    yield 1.5
    driver.sidebar_shot("22_no_dataset")
    assert not jobs.unfinished()  # the panel sees by itself that there is nothing

    demo = Path(str(sys.modules[driver.MODULE].__file__)).parent / "core" / "demo_data"
    yield from find_text_file(Path(shutil.copytree(demo, work / "spoilt")))
    shutil.copytree(demo, work / "monkey")
    settings.dataset = "//monkey"
    yield from driver.wait(lambda: settings.inspected, 60)
    settings.overrides = "first.iterations=many"
    yield 1.0
    yield from browsing.press_button("irgspp.reconstruct")
    yield from driver.wait(lambda: not jobs.unfinished(), 60)
    yield 1.5
    driver.shot("23_bad_setting")

    settings.overrides, settings.preset = "first.iterations=3000", "draft"
    yield 1.0
    yield from browsing.press_button("irgspp.reconstruct")
    job = yield from browsing.started_job()
    yield from driver.wait(lambda: job.phase == "first stage" and job.step > 20, 300)
    yield from browsing.press_button("irgspp.job_cancel", across=0.7)
    yield from driver.wait(lambda: job.finished, 60)
    yield 1.5
    driver.sidebar_shot("24_cancelled")
    assert job.state == "cancelled", job.state

    yield from browsing.press_button("irgspp.reconstruct", part="overwrite=True")
    yield 1.0
    driver.shot("25_replace")
    driver.key("Escape")
    yield 1.0
    assert not jobs.unfinished()
    yield from browsing.press_button("irgspp.job_resume", across=0.25)
    yield from driver.wait(lambda: job.state == "running" and job.step > 20, 120)
    yield from browsing.press_button("irgspp.job_finish", across=0.25)
    yield 1.0
    driver.sidebar_shot("26_finishing_early")
    yield from driver.wait(lambda: job.finished, 600)
    assert job.state == "done" and not job.error, (job.state, job.error)
    shutil.rmtree(work, ignore_errors=True)


def find_text_file(photographs: Path) -> Iterator[float]:
    """Choose photographs of which one is a text file, which the panel has to name in one line.

    Args:
        photographs: copy of a dataset.
    """
    spoilt = sorted((photographs / "train").glob("*.png"))[2]
    spoilt.write_text("This is no photograph.")
    settings = bpy.context.scene.irgspp
    settings.dataset = f"//{photographs.name}"
    yield from driver.wait(lambda: settings.inspected, 60)
    yield 1.5
    driver.sidebar_shot("22_text_file")
    (line,) = json.loads(settings.inspected)["warnings"]
    assert line.count(spoilt.name) == 1 and "\n" not in line, line


def open_preferences() -> Iterator[float]:
    """Open the preferences by the panel's button; they open in a window of their own."""
    yield from driver.click("preferences.addon_show")
    yield from driver.wait(lambda: len(bpy.context.window_manager.windows) > 1, 10)
    yield 2.0
    driver.shot("20_preferences")
    bpy.context.preferences.addons[driver.MODULE].preferences.engine_python = driver.ENGINE
    driver.redraw()
    yield 2.0
    driver.shot("21_preferences_existing")
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
        bpy.ops.wm.window_close()
    yield 1.0


driver.run_story(story)
