"""Beads that are laid slower than their plan knows, since the feed follows along the path: the plan aims lower for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from ebamcheck.heat.melting import entry_limit_k
from ebamcheck.pipeline.gates import Gate
from ebamcheck.settings.config import Config

ROOM_K = 10.0
"""Room under the limit beside what was found over it: with other waits and power beads are entered at other moments."""

MOST_K = 150.0
"""More than this no plan is to aim lower."""


class Judged(Protocol):
    """A layer that was made and judged."""

    @property
    def passed(self) -> bool:
        """Whether every gate is open."""

    @property
    def gates(self) -> tuple[Gate, ...]:
        """What was judged."""


_Made = TypeVar("_Made", bound=Judged)


def with_feed_along(
    make: Callable[[Config, float], _Made], config: Config, alone: Callable[[], Config]
) -> _Made:
    """Make a layer by its settings; where the feed follows along the path and a gate shuts, cooler, and then by the wire alone.

    Parameters
    ----------
    make
        Makes it by settings and by how far its plan aims under the limit of the heat, K.
    alone
        Settings by which the wire follows alone, as far as it goes.
    """
    made = make(config, 0.0)
    if made.passed or not config.process.feed_along_path:
        return made
    over_k = too_warm_k(made.gates)
    if over_k > 0.0:
        made = make(config, over_k)
    return made if made.passed else make(alone(), 0.0)


def too_warm_k(gates: Sequence[Gate]) -> float:
    """How far a layer is over the limit of the heat, of which that is all that is wrong; else 0."""
    shut = [gate for gate in gates if not gate.passed]
    if len(shut) != 1 or shut[0].name != "heat":
        return 0.0
    over_k = shut[0].figure - shut[0].limit
    return over_k if 0.0 < over_k <= MOST_K else 0.0


def aimed_lower(config: Config, by_k: float) -> Config:
    """Settings of a plan that aims under the limit of the heat; the layer itself is judged by the limit."""
    if by_k <= 0.0:
        return config
    limit_k = entry_limit_k(config) - by_k - ROOM_K
    return config.model_copy(
        update={"process": config.process.model_copy(update={"interpass_limit_k": limit_k})}
    )
