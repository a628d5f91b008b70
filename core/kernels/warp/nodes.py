# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes of Warp's bounding volume hierarchy, laid out for rays that visit the nearer child first; Warp's own queries visit in any order.

A node holds the boxes of both children, as in Aila and Laine 2009, "Understanding the efficiency of ray traversal on GPUs". The layout of
Warp's nodes is read by native code (warp/native/bvh.h of the pinned version), as Warp has no public access to it.
"""

from __future__ import annotations

import torch
import warp as wp

from .runtime import launch

DEPTH = 32  # levels of Warp's trees at most (BVH_QUERY_STACK_SIZE)
MISS = wp.constant(3.0e38)  # distance of a box that is not hit
Stack = wp.types.vector(length=DEPTH, dtype=wp.int32)
Distances = wp.types.vector(length=DEPTH, dtype=wp.float32)


@wp.func_native("""
    wp::BVHPackedNodeHalf half = wp::bvh_load_node(upper ? wp::bvh_get(tree).node_uppers : wp::bvh_get(tree).node_lowers, node);
    return wp::vec3(half.x, half.y, half.z);
""")
def corner(tree: wp.uint64, node: int, upper: int) -> wp.vec3:
    """Return the lower or the upper corner of a node's box."""
    ...


@wp.func_native("""
    return static_cast<int>(wp::bvh_load_node(upper ? wp::bvh_get(tree).node_uppers : wp::bvh_get(tree).node_lowers, node).i);
""")
def content(tree: wp.uint64, node: int, upper: int) -> int:
    """Return the left and the right child of an inner node, or the begin and the end of a leaf's items."""
    ...


@wp.func_native("""
    return static_cast<int>(wp::bvh_load_node(wp::bvh_get(tree).node_lowers, node).b);
""")
def is_leaf(tree: wp.uint64, node: int) -> int:
    """Return 1 for a leaf, else 0."""
    ...


@wp.func_native("""
    return *wp::bvh_get(tree).root;
""")
def root(tree: wp.uint64) -> int:
    """Return the root's number."""
    ...


@wp.func_native("""
    return wp::bvh_get(tree).primitive_indices[place];
""")
def item(tree: wp.uint64, place: int) -> int:
    """Return the item at a place of the leaves' order."""
    ...


@wp.func
def reference(tree: wp.uint64, node: int) -> float:
    """Return how a parent refers to a node, as the bits of a float: an inner one by its number, a leaf by ~ the place of its first item."""
    if is_leaf(tree, node) == 1:
        return wp.cast(~content(tree, node, 0), wp.float32)
    return wp.cast(node, wp.float32)


@wp.func
def joined(v: wp.vec3, w: float) -> wp.vec4:
    """Append a component."""
    return wp.vec4(v[0], v[1], v[2], w)


@wp.kernel
def lay_out(tree: wp.uint64, count: int, nodes: wp.array(dtype=wp.vec4), items: wp.array(dtype=int)):
    """Write both children's boxes and references of each node, 4 vectors each, then the root's reference; and the leaves' items."""
    node = wp.tid()
    if node == count:
        nodes[4 * count] = joined(wp.vec3(0.0, 0.0, 0.0), reference(tree, root(tree)))
        return
    a, b = content(tree, node, 0), content(tree, node, 1)
    if is_leaf(tree, node) == 1:
        for place in range(a, wp.min(b, items.shape[0])):  # ~ item: others of the same leaf follow
            items[place] = wp.where(place + 1 < b, ~item(tree, place), item(tree, place))
    elif a < count and b < count:  # else the node is not in use
        nodes[4 * node] = joined(corner(tree, a, 0), reference(tree, a))
        nodes[4 * node + 1] = joined(corner(tree, a, 1), 0.0)
        nodes[4 * node + 2] = joined(corner(tree, b, 0), reference(tree, b))
        nodes[4 * node + 3] = joined(corner(tree, b, 1), 0.0)


@wp.func
def entered(lower: wp.vec4, upper: wp.vec4, o: wp.vec3, inverse: wp.vec3, t_min: float, t_max: float) -> float:
    """Return where a ray enters a box, MISS where it does not between t_min and t_max; inverse: reciprocals of the direction."""
    near, far = float(t_min), float(t_max)
    for axis in range(3):
        a, b = (lower[axis] - o[axis]) * inverse[axis], (upper[axis] - o[axis]) * inverse[axis]
        near = wp.max(near, wp.min(a, b))
        far = wp.min(far, wp.max(a, b))
    return wp.where(near <= far, near, MISS)


class Nodes:
    """Nodes of a tree over N items.

    Attributes:
        nodes: (4 (2 N - 1) + 1, 4) boxes and references, see `lay_out`.
        items: (N,) int32 items in the order of the leaves.
    """

    def __init__(self, tree: wp.Bvh, count: int, device: torch.device) -> None:
        """Lay out the nodes.

        Args:
            tree: Warp's tree, of one item per leaf where its depth allows.
            count: number of its items, N >= 1.
            device: device of the tree.
        """
        self._inner = 2 * count - 1
        self.nodes = torch.zeros(4 * self._inner + 1, 4, device=device)
        self.items = torch.zeros(count, dtype=torch.int32, device=device)
        self.update(tree)

    def update(self, tree: wp.Bvh) -> None:
        """Lay the nodes out again, after the tree was refitted."""
        launch(lay_out, self._inner + 1, wp.uint64(tree.id), self._inner, self.nodes, self.items)
