# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the jobs at the head of the sidebar and in the status bar, where closed panels hide everything else."""

import time
from types import SimpleNamespace

import bpy
import irgspp
import pytest
from irgspp.irgspp_addon.jobs import queue as jobs
from irgspp.irgspp_addon.jobs.job import Job
from irgspp.panels import headline, job_card
from irgspp.panels.phases import total_fraction
from recording_layout import RecordingLayout, draw


@pytest.fixture(autouse=True)
def extension():
    bpy.ops.wm.read_homefile(use_empty=True)
    irgspp.register()
    jobs.clear()
    yield
    jobs.clear()
    irgspp.unregister()


def add(tmp_path, **values) -> Job:
    job = Job(**{"id": "j1", "kind": "reconstruct", "title": "Reconstruct spot", "folder": tmp_path, "notes": tmp_path} | values)
    jobs._jobs[job.id] = job
    return job


def status_bar() -> str:
    layout = RecordingLayout()
    headline.draw_status(SimpleNamespace(layout=layout), bpy.context)
    return layout.words


def header() -> str:
    layout = RecordingLayout()
    headline.IRGSPP_PT_headline.draw_header(SimpleNamespace(layout=layout), bpy.context)
    return layout.words


def test_nothing_without_jobs(tmp_path):
    assert not headline.IRGSPP_PT_headline.poll(bpy.context) and status_bar() == ""
    add(tmp_path, state="done", ended=time.time())
    add(tmp_path, id="j2", state="failed", error="disk full", ended=job_card.BEGAN - 10)  # of an earlier session
    assert not headline.IRGSPP_PT_headline.poll(bpy.context) and status_bar() == ""


def test_a_running_job(tmp_path):
    add(tmp_path, id="j0", title="Bake spot", kind="bake", state="queued", made=1.0)
    assert status_bar() == "IRGS++: Bake spot waits"
    add(tmp_path, state="running", step=46, of=100, made=2.0)
    assert status_bar() == "IRGS++: Reconstruct spot, 46 %"
    assert header() == "Reconstruct spot, 46 %" and draw(headline.IRGSPP_PT_headline).drawn == []
    jobs.find("j1").phase = "second stage"  # the whole counts, where it is known
    assert status_bar() == f"IRGS++: Reconstruct spot, {100 * total_fraction('reconstruct', 'second stage', 0.46):.0f} %"


@pytest.mark.parametrize(
    ("values", "line", "text"),
    [
        ({"state": "failed", "error": "disk full"}, "Reconstruct spot failed", "disk full"),
        ({"state": "lost", "error": "no status"}, "Reconstruct spot failed", "no status"),
        ({"state": "done", "error": "done, but: another file is open now"}, "Reconstruct spot: result not used", "done, but: another file"),
    ],
)
def test_a_job_that_failed_until_another_ends_well(tmp_path, values, line, text):
    add(tmp_path, ended=time.time(), **values)
    drawn = draw(headline.IRGSPP_PT_headline)
    assert header() == line and text in drawn.words and drawn.buttons("irgspp.job_log")[0].values == {"job": "j1"}
    assert "spot" in status_bar()
    add(tmp_path, id="j2", state="cancelled", ended=time.time() + 1)
    assert not headline.IRGSPP_PT_headline.poll(bpy.context) and status_bar() == ""


def test_it_is_in_blenders_status_bar_while_registered():
    drawn = bpy.types.STATUSBAR_HT_header.draw._draw_funcs
    assert headline.draw_status in drawn
    irgspp.unregister()
    assert headline.draw_status not in bpy.types.STATUSBAR_HT_header.draw._draw_funcs
    irgspp.register()


def test_it_is_the_first_panel_and_leaves_the_tab_at_its_place():
    package = headline.__name__.rpartition(".")[0]  # a test that installs the extension leaves the panels of another one
    panels = [cls for cls in bpy.types.Panel.__subclasses__() if cls.__module__.startswith(f"{package}.")]
    tops = [cls for cls in panels if not hasattr(cls, "bl_parent_id") and cls.bl_space_type == "VIEW_3D"]
    first, second = sorted(tops, key=lambda cls: cls.bl_order)[:2]
    assert first is headline.IRGSPP_PT_headline and first.bl_order < second.bl_order
    # Blender orders tabs by their first panel: its own have order 0 and a header, and a panel without one comes before them
    assert first.bl_order >= 0 and "HIDE_HEADER" not in getattr(first, "bl_options", ())
