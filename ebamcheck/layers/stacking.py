"""Blocks of layers joined as they come."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ebamcheck.layers.stack import Layers


def stacked(blocks: Iterable[Layers]) -> Layers:
    """Join consecutive blocks of layers as they come; a block is released once its points are copied.

    The column of points grows in place: memory touched for the first time is what costs time here, and the points are
    never held twice. Blocks that know their cut edges are joined by :func:`~ebamcheck.layers.stack.concatenate`.
    """
    points = np.empty((0, 2))
    kept: list[Layers] = []
    for block in blocks:
        size = len(points)
        # No view of it is taken before it is whole.
        points.resize((size + len(block.points), 2), refcheck=False)
        points[size:] = block.points
        kept.append(replace(block, ring_starts=block.ring_starts + size, points=points[:0].copy()))
    ring_base = np.cumsum([0] + [block.closed.size for block in kept])
    return replace(
        kept[0],
        heights=np.concatenate([block.heights for block in kept]),
        points=points,
        ring_starts=np.concatenate([[0], *(block.ring_starts[1:] for block in kept)]).astype(np.int64),
        layer_starts=np.concatenate(
            [[0], *(block.layer_starts[1:] + r for block, r in zip(kept, ring_base[:-1], strict=True))]
        ).astype(np.int64),
        closed=np.concatenate([block.closed for block in kept]),
        dropped=np.concatenate([block.dropped for block in kept]),
    )
