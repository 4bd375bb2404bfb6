"""A machine to try a build on: beads that grow higher or lower than planned, by a stated law."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ebamcheck.errors import SettingsError


@dataclass(frozen=True)
class Growth:
    """How high a layer comes out: its planned height times ``1 + drift + noise n``, with n of the normal distribution.

    Parameters
    ----------
    drift
        Share by which every layer comes out higher.
    noise
        Standard deviation of that share.
    seed
        Of the noise; layer by layer, so that the same build on the same seed is the same.
    """

    drift: float = 0.0
    noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what no bead does."""
        if not (math.isfinite(self.drift) and -0.9 < self.drift < 2.0):
            raise SettingsError(f"drift {self.drift}: give a share of a layer between -0.9 and 2")
        if not (math.isfinite(self.noise) and 0.0 <= self.noise < 1.0):
            raise SettingsError(f"noise {self.noise}: give a share of a layer from 0 to under 1")

    def grown_mm(self, layer: int, thickness_mm: float) -> float:
        """Return the height that a layer really gets; never nothing.

        Examples
        --------
        >>> Growth(drift=0.1).grown_mm(3, 2.0)
        2.2
        """
        noise = float(np.random.default_rng((self.seed, layer)).standard_normal()) if self.noise else 0.0
        return max(thickness_mm * (1.0 + self.drift + self.noise * noise), 0.05 * thickness_mm)


def bad_lines(done: int, base_mm: float, top_mm: float) -> list[tuple[str, bytes]]:
    """Bad input on the way to the reading of a layer: what each is to be refused as, and the line."""
    middle = 0.5 * (base_mm + top_mm)

    def line(**values: object) -> bytes:
        fields = {"event": "height", "done": done, "height_mm": middle, **values}
        return (
            "{"
            + ", ".join(f'"{k}": {v}' for k, v in fields.items() if v is not None).replace(
                "height,", '"height",'
            )
            + "}"
        ).encode()

    return [
        ("unreadable", b"\xff\xfe height"),
        ("unreadable", b'{"event": "height", "done"'),
        ("event", b'{"event": "launch"}'),
        ("missing", line(height_mm=None)),
        ("missing", line(done=None)),
        ("not-a-number", line(height_mm="NaN")),
        ("not-a-number", line(height_mm="Infinity")),
        ("not-a-number", line(height_mm='"12"')),
        ("not-a-number", line(height_mm="true")),
        ("unit", line(unit='"in"')),
        ("unit", line(height_mm=top_mm / 25.4)),
        ("absurd", line(height_mm=1e300)),
        ("decreasing", line(height_mm=-3.0)),
        ("counter", line(done=-1)),
        ("counter", line(done=1.5)),
        ("counter-jump", line(done=done + 5)),
    ]  # fmt: skip
