"""What a played control holds (R parameters, files, operate rights), its faults, and the law by which its layers grow.

It knows nothing of networks: the server in front of it shows it on a grid of 100 ms, the program behind it runs on it.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field

import numpy as np

from ebamcheck.errors import SettingsError

FAULTS = {
    "away": "the server is away for a while, when the layer is done",
    "upload": "the server goes away in the middle of the upload of the layer, which leaves half a file",
    "refuse": "writes are refused for a while, before the layer is released",
    "lost-writes": "writes are lost for a while without an error, before the layer is released",
    "other-file": "the first upload of the layer reads back as another file",
    "other-client": "another client writes another number over the one that was just written, once",
    "stray": "another client writes the number of the next layer before the height has come",
    "late": "the height comes late",
    "missing": "the height is no number, before it comes",
    "repeated": "the height comes twice, the second time another one",
    "absurd": "an absurd height comes before the right one",
    "inches": "the height comes in inches before the right one",
    "jump": "the height is said to be of another layer, before it comes",
    "count": "the counter of layers jumps, and comes back",
    "reset": "RESET in the middle of the layer; the operator has it laid anew",
    "reset-between": "RESET after the layer; the operator says that it is whole",
    "sessions": "no session is left for a while: the server is away and comes back full",
}
"""Faults of the played control by name, and what happens; each at a layer, from 1."""


@dataclass
class Panel:
    """State of a played control, for the threads of its server and its program."""

    values: dict[int, float] = field(default_factory=dict)
    """R parameters by number; those that are not there are 0."""
    texts: dict[str, str] = field(default_factory=dict)
    """Variables of text, by what they are."""
    files: dict[str, bytes] = field(default_factory=dict)
    """Files by their place."""
    rights: str = "operate"
    """`operate`, `refused`, or `lost`: what becomes of writes from outside."""
    swap_next: bool = False
    """Whether the next upload is kept as another file."""
    break_next: bool = False
    """Whether the server goes away in the middle of the next upload."""
    overwritten: dict[int, float] = field(default_factory=dict)
    """R parameters that another client writes over as soon as they are written, once, and what it writes."""
    full: bool = False
    """Whether no session is left."""
    lock: threading.RLock = field(default_factory=threading.RLock)

    def get(self, number: int) -> float:
        """Return an R parameter."""
        with self.lock:
            return self.values.get(number, 0.0)

    def set(self, number: int, value: float) -> None:
        """Set an R parameter from within the control: rights do not matter."""
        with self.lock:
            self.values[number] = value

    def write(self, number: int, value: float) -> float:
        """Set an R parameter from outside, where that is allowed; return what it is then."""
        with self.lock:
            if self.rights == "operate":
                self.values[number] = self.overwritten.pop(number, value)
            return self.get(number)

    def upload(self, place: str, content: bytes) -> bool:
        """Keep a file; return whether the server is to go away in the middle of it."""
        with self.lock:
            if self.break_next:
                self.break_next, self.files[place] = False, content[: len(content) // 2]
                return True
            if self.swap_next:
                self.swap_next, content = False, content.replace(b"X", b"Y", 1)
            if self.rights == "operate":
                self.files[place] = content
            return False

    def snapshot(self) -> dict[int, float]:
        """Return all R parameters at once."""
        with self.lock:
            return dict(self.values)


@dataclass(frozen=True)
class Growth:
    """How high a layer comes out: its planned height times ``1 + drift + noise n``, with n of the normal distribution.

    The noise follows from seed and layer, so that a build comes out the same again.
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
