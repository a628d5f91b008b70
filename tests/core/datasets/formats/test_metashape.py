# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of Metashape: every type of sensor, and hostile or damaged files."""

import pytest
from irgspp.core.datasets.format_detection import parse_dataset
from irgspp.core.datasets.load import load_dataset
from irgspp.core.settings.schema import DataSettings
from refused import refused

XML = """<?xml version="1.0" encoding="UTF-8"?>{doctype}
<document version="2.0.0"><chunk label="c"><sensors><sensor id="0" label="s" type="frame"><resolution width="60" height="48"/>
<calibration type="frame" class="adjusted"><f>70</f>{extra}</calibration></sensor></sensors>
<cameras>{cameras}</cameras></chunk></document>"""
POSE = "1 0 0 {i} 0 1 0 0 0 0 1 0 0 0 0 1"


def metashape(folder, doctype="", extra="", label="{i:03d}", pose=POSE):
    cameras = "".join(
        f'<camera id="{i}" sensor_id="0" label="{label.format(i=i)}"><transform>{pose.format(i=i)}</transform></camera>' for i in range(10)
    )
    (folder / "cameras.xml").write_text(XML.format(doctype=doctype, extra=extra, cameras=cameras))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (dict(doctype='<!DOCTYPE d [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'), ["entities"]),
        (dict(doctype='<!DOCTYPE d [<!ENTITY x SYSTEM "file:///etc/passwd">]>'), ["entities"]),
        (dict(label="../secret"), ["leads out"]),
        (dict(label="{{outside}}/secret"), ["leads out"]),
        (dict(extra="<k4>0.1</k4>"), ["k4"]),
        (dict(extra="<b2>40</b2>"), ["skew"]),
        (dict(extra="<k1>nan</k1>"), ["k1", "number"]),
        (dict(pose="1 2 3"), ["3 numbers"]),
        (dict(pose="2 0 0 {i} 0 1 0 0 0 0 1 0 0 0 0 1"), ["not rigid"]),
    ],
)
def test_hostile_and_damaged_cameras_of_metashape(confined_dataset, given, words):
    confined_dataset.save_images([f"images/{i:03d}.png" for i in range(10)])
    metashape(confined_dataset.folder)
    assert parse_dataset(confined_dataset.folder, DataSettings()).format == "metashape"
    given = {k: v.replace("{{outside}}", str(confined_dataset.folder.parent)) for k, v in given.items()}
    metashape(confined_dataset.folder, **given)
    with refused(*words):
        load_dataset(confined_dataset.folder)


def test_sensors_of_metashape(confined_dataset):
    """A fisheye and a frame camera, one sensor never calibrated, one camera switched off."""
    confined_dataset.save_images([f"images/{i:03d}.png" for i in range(10)])
    metashape(confined_dataset.folder)
    file = confined_dataset.folder / "cameras.xml"
    fisheye = """<sensor id="1" label="f" type="fisheye"><resolution width="60" height="48"/><calibration type="fisheye" class="initial">
        <f>30</f></calibration><calibration type="fisheye" class="adjusted"><f>31</f><cx>0.5</cx><cy>-1</cy><k1>0.01</k1><k4>0.002</k4>
        <b1>2</b1></calibration></sensor><sensor id="2" label="n" type="frame"><resolution width="60" height="48"/></sensor></sensors>"""
    text = file.read_text().replace("</sensors>", fisheye)
    text = text.replace('id="3" sensor_id="0"', 'id="3" sensor_id="1"').replace('id="4" sensor_id="0"', 'id="4" sensor_id="2"')
    file.write_text(text.replace('id="5" sensor_id="0"', 'id="5" sensor_id="0" enabled="false"'))
    parsed = parse_dataset(confined_dataset.folder, DataSettings())
    lenses = {f.listed: f.lens for f in parsed.train}
    assert sorted(lenses) == [f"{i:03d}" for i in range(10) if i not in (4, 5)] and "2 cameras" in parsed.warnings[0]
    one = lenses["003"]
    assert one.fisheye and (one.fx, one.fy, one.cx, one.cy) == (33, 31, 30.5, 23) and one.distortion == (0.01, 0, 0, 0.002)
    assert not lenses["000"].distorted and (lenses["000"].fx, lenses["000"].cx) == (70, 30)
