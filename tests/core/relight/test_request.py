# SPDX-License-Identifier: GPL-3.0-or-later
"""Requests of the server: lamps and ground are read and checked."""

import json
from pathlib import Path

import numpy as np
import pytest
from irgspp.core.errors import InputError
from irgspp.core.relight.server.request import read_request
from irgspp.core.scene.lamps import Lamp, lamp_records

CAMERA = {"width": 8, "height": 6, "fx": 9.0, "fy": 9.0, "cx": 4.0, "cy": 3.0, "to_world": np.eye(4).tolist()}


def read(**values):
    return read_request(json.loads(json.dumps({"camera": CAMERA, **values})), Path())


def test_lamps_and_ground_are_optional():
    request = read()
    assert request.lamps == () and request.ground is None


def test_lamps_and_ground():
    lamps = (Lamp("sun", radius=0.1), Lamp("spot", emission=(1.0, 0.5, 0.0), blend=0.5))
    request = read(lamps=lamp_records(lamps), ground=[0.6, 0.0, 0.8, -1.0])
    assert request.lamps == lamps and request.ground == (0.6, 0.0, 0.8, -1.0)


@pytest.mark.parametrize(
    "values", [{"lamps": [{"kind": "x"}]}, {"lamps": 3}, {"ground": [0, 0, 1]}, {"ground": [0, 0, 2, 0]}, {"ground": "x"}]
)
def test_what_is_wrong_with_them_is_one_line(values):
    with pytest.raises(InputError):
        read(**values)
