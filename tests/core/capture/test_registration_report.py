# SPDX-License-Identifier: GPL-3.0-or-later
"""Why photographs have no pose, in words that are true of their matches."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from irgspp.core.capture.photograph import Photograph
from irgspp.core.capture.registration_report import explain_left_out

NAMES = "abcdefgh"  # a, b, c have poses; d, e, f fit together only with each other; g matches only f; h has no features


def reasons(*links: tuple[str, str, int]) -> dict[str, str]:
    """Reasons of the photographs without a pose, given the matches of pairs beside those within the two groups."""
    photographs = [Photograph(name, Path("x"), Path(f"{name}.jpg"), 64, 48, "lens") for name in NAMES]
    inliers = np.zeros((8, 8), int)
    for one, other, number in [*(pair for group in ("abc", "def") for pair in zip(group, group[1:], (100, 90), strict=False)), *links]:
        i, j = NAMES.index(one), NAMES.index(other)
        inliers[i, j] = inliers[j, i] = number
    models = [SimpleNamespace(reg_image_ids=lambda m=m: m) for m in ([1, 2, 3], [4, 5, 6])]
    return {one.name: one.reason for one in explain_left_out(photographs, models, np.array([500] * 7 + [3]), inliers)}


def test_photographs_with_poses_need_no_reason():
    assert set(reasons()) == set("defgh")


def test_groups_without_a_link_are_not_connected():
    assert reasons()["e"] == "not connected: it matches only with d, f; photographs between the groups are missing"


def test_groups_with_a_weak_link_name_its_matches():
    said = reasons(("c", "d", 17))["d"]
    assert said.startswith("weakly connected: it fits together with e, but has at most 17 matches with a photograph that has a pose")


def test_single_photographs_tell_what_they_match():
    said = reasons(("c", "g", 16), ("f", "g", 20))
    assert said["g"] == "no consistent pose: it matches 2 photographs, but too weakly"
    assert reasons(("f", "g", 20))["g"].startswith("not connected: it matches only with f;")
    assert reasons()["g"].startswith("no match") and said["h"].startswith("no texture: only 3 features")
