# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene of a box on a table, its dense points and its masks, computed once."""

import pytest
from irgspp.core.capture.dense_points import DensePoints, find_dense_points
from irgspp.core.capture.object_masks import ObjectMasks, cut_out
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.schema import CaptureSettings
from table_scene import TableScene, photographed_table


@pytest.fixture(scope="session")
def table_scene() -> TableScene:
    return photographed_table()


@pytest.fixture(scope="session")
def dense(table_scene: TableScene) -> DensePoints:
    return find_dense_points(table_scene.views, table_scene.points, None, 0, Silent())


@pytest.fixture(scope="session")
def table_masks(table_scene: TableScene) -> ObjectMasks:
    found = cut_out(table_scene.views, table_scene.points, CaptureSettings(), 0, Silent())
    assert found is not None
    return found
