# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks of the object that the photographs show, found without learned weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..datasets.bound import bound_of_cameras, bound_of_masks
from ..machine.thread_pool import run_jobs
from ..progress.protocol import Progress
from ..scene.dataset import Bound, PointCloud, View
from ..settings.schema import CaptureSettings
from ..stereo.fusion import OrientedPoints
from .chosen_sphere import check_points
from .dense_points import DensePoints, find_dense_points
from .ground import Ground, find_ground, with_base
from .hidden_views import hidden_views
from .mask_consistency import MaskedView, consistent_masks
from .object_region import ObjectRegion, find_object_region
from .segmentation import prepare_cutout
from .soft_edges import soft_edges
from .support_plane import SupportPlane, find_support_plane

HIDDEN = "other things hide the object"
# Fraction of the views in which other things may hide the object. In more of them, these things are rather parts of it, or beside it.
MAX_HIDDEN_VIEWS = 0.25
MIN_MASKS = 3  # masks that must be found, and given masks that can stand for a support plane


@dataclass(frozen=True, eq=False)
class ObjectMasks:
    """Masks of the object and what is known of its place.

    Attributes:
        masks: (H, W) float32 in 0..1 of each view, None where the object could not be found.
        plane: plane on which the object stands; None where it hangs or where given masks tell the object.
        bound: sphere about the object.
        doubtful: names of views whose masks should be looked at, with the reason.
        points: dense points of the whole scene.
        on_object: (N,) bool, points that belong to the object.
        messages: lines for the user, such as what was taken for a part of the object.
        others: bounding spheres of other things near the object that the masks leave out, the largest first.
    """

    masks: list[np.ndarray | None]
    plane: SupportPlane | None
    bound: Bound
    doubtful: list[tuple[str, str]]
    points: OrientedPoints
    on_object: np.ndarray
    messages: list[str] = field(default_factory=list)
    others: list[Bound] = field(default_factory=list)


def cut_out(
    views: Sequence[View],
    points: PointCloud | None,
    settings: CaptureSettings,
    seed: int,
    progress: Progress,
    sphere: Bound | None = None,
    given: dict[str, np.ndarray] | None = None,
    background: dict[str, np.ndarray] | None = None,
    widening: float = 0.0,
    dense: DensePoints | None = None,
) -> ObjectMasks | None:
    """Cut the object that the cameras look at out of all views.

    Args:
        views: undistorted photographs of about 640 pixels a side; their alpha is not used.
        points: sparse points, or None.
        settings: without `masks`, nothing is cut out.
        seed: seed of the random numbers.
        progress: receives the phases "dense points" and "cut out the object" and messages, and may cancel.
        sphere: bounding sphere of the object in the views' frame, if the user gave it; it is then the bound of the result.
        given: masks (H, W) 0..1 that the user gave, by the view's name, for some or all views; followed but for a band at their edge.
        background: (H, W) bool by the view's name, True where the static background of a turntable is seen.
        widening: pixels at 640 a side by which masks may be wrong, where the surroundings have little texture.
        dense: dense points of the views, if they were found before, without a sphere.

    Returns:
        The masks, None in views in which other things hide the object; None, with a message that says why, where there is no object to cut
        out.

    Raises:
        InputError: the user's sphere holds no point of the scene.
        Cancelled: the user stopped the work.
    """
    given, background = _not_empty(given or {}, progress), background or {}
    if not settings.masks or len(views) < MIN_MASKS:
        return None
    if widening:
        progress.message(
            f"masks: the surroundings have few features, so masks may be wrong by {widening:g} pixels; a patterned table helps"
        )
    cameras = [view.camera for view in views]
    if dense is None:
        dense = find_dense_points(views, points, sphere, seed, progress)
    if sphere is not None:
        check_points(sphere, [dense.points.position, *([] if points is None else [points.position])])
    plane = find_support_plane(dense, cameras, seed)
    region = _region(views, dense, plane, sphere, given, progress)
    if isinstance(region, str):
        progress.message(f"masks: {region}; the photographs are used whole")
        return None
    ground = None if plane is None else find_ground(dense, plane, region)
    region = region if ground is None else with_base(region, dense, ground, sphere)
    maps = dict(zip(dense.chosen, dense.maps, strict=True))
    of_view = [(given.get(view.name), background.get(view.name)) for view in views]
    jobs = [(view, maps.get(i), region, ground, *of_view[i]) for i, view in enumerate(views)]
    cutouts = list(run_jobs(prepare_cutout, jobs))
    hidden = _hidden(views, dense, region, sphere, given, progress)
    cutouts = [None if behind else one for one, behind in zip(cutouts, hidden, strict=True)]
    parts = enumerate(zip(views, cutouts, strict=True))
    masked = [MaskedView(view.name, view.camera, view.colour, cutout, i in maps) for i, (view, cutout) in parts]
    masks, doubtful = consistent_masks(masked, region, ground, progress, widening)
    masks = [None if one is None or one.max() < 0.5 else soft_edges(view.colour, one) for view, one in zip(views, masks, strict=True)]
    if sum(mask is not None for mask in masks) < MIN_MASKS:
        progress.message("masks: the object could not be told from its surroundings; the photographs are used whole")
        return None
    behind = {view.name for view, one in zip(views, hidden, strict=True) if one}
    doubtful = [(name, HIDDEN if name in behind else reason) for name, reason in doubtful]
    bound, on_object = sphere or _bound(views, masks, region), region.labels(dense.points.position) == 1
    found = ObjectMasks(masks, plane, bound, doubtful, dense.points, on_object, _base_taken(ground, region), region.clutter)
    for line in found.messages:
        progress.message(line)
    return found


def _not_empty(given: dict[str, np.ndarray], progress: Progress) -> dict[str, np.ndarray]:
    """Return the user's masks that show something. Empty ones would carve the object away; a line names their photographs."""
    empty = sorted(name for name, mask in given.items() if mask.max() < 0.5)
    if empty:
        names = ", ".join(empty[:5]) + (f" and {len(empty) - 5} others" if len(empty) > 5 else "")
        progress.message(f"masks: the masks of {names} are empty; these photographs are cut out like those without a mask")
    return {name: mask for name, mask in given.items() if name not in empty}


def _region(
    views: Sequence[View],
    dense: DensePoints,
    plane: SupportPlane | None,
    sphere: Bound | None,
    given: dict[str, np.ndarray],
    progress: Progress,
) -> ObjectRegion | str:
    """Return the object's region, or the reason why there is none."""
    cameras = [view.camera for view in views]
    masked = [(view.camera, given[view.name].astype(np.float32)) for view in views if view.name in given]
    if len(masked) >= MIN_MASKS and sphere is None:
        sphere = bound_of_masks([camera for camera, _ in masked], [mask for _, mask in masked], bound_of_cameras(cameras))
    if not dense.reliable and sphere is None:
        return "the cameras don't look at one point (a sphere tells where the object is: --sphere, or move it in Blender)"
    region = find_object_region(dense, plane, cameras, sphere)
    if region is not None:
        return region
    if sphere is not None:  # the person's, or that of given masks
        progress.message("masks: stereo sees nothing but the table in the object's sphere; colours and given masks alone tell the object")
        return ObjectRegion(sphere, np.asarray(sphere.centre) - sphere.radius, 2 * sphere.radius, np.zeros((1, 1, 1), np.uint8), [])
    return "nothing stands apart where the cameras look" if plane is not None else "no object stands on a plane or hangs free"


def _hidden(
    views: Sequence[View],
    dense: DensePoints,
    region: ObjectRegion,
    sphere: Bound | None,
    given: dict[str, np.ndarray],
    progress: Progress,
) -> list[bool]:
    """Return for each view whether other things hide the object, so that no mask is made of it.

    Without the person's sphere, given masks stay, and all views where the object is hidden in more than MAX_HIDDEN_VIEWS of them.
    """
    hidden = hidden_views([view.camera for view in views], dense, region)
    if sphere is not None:
        return hidden
    if sum(hidden) > MAX_HIDDEN_VIEWS * len(views):
        progress.message(f"masks: other things seem to hide the object in {sum(hidden)} of {len(views)} photographs; all are used")
        return [False] * len(views)
    return [one and view.name not in given for view, one in zip(views, hidden, strict=True)]


def _bound(views: Sequence[View], masks: Sequence[np.ndarray | None], region: ObjectRegion) -> Bound:
    """Return the sphere about the region inside the masks, or that of the points where masks contradict each other."""
    pairs = [(view.camera, mask) for view, mask in zip(views, masks, strict=True) if mask is not None]
    return bound_of_masks([camera for camera, _ in pairs], [mask for _, mask in pairs], region.bound) or region.bound


def _base_taken(ground: Ground | None, region: ObjectRegion) -> list[str]:
    """Return a line about a thin flat part under the object that the masks take in."""
    if ground is None or ground.base is None:
        return []
    share = 100 * ground.base.height / region.bound.radius
    return [f"masks: a flat part under the object is taken as its own ({share:.1f} % of its radius high); paint masks to leave it out"]
