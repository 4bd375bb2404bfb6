"""What a played control holds, and its program: the text that waits is run block by block, layers grow, heights come, named faults
happen.

Layers take the time of their text over a speed; waits are shortened likewise, to no less than the time in which a server can
answer."""

from __future__ import annotations

import hashlib
import math
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ebamcheck.controls.sinumerik.waiting_run import Run, run_text
from ebamcheck.errors import BackendFailed, SettingsError
from ebamcheck.live.opcua.handshake import OFFSETS, file_path
from ebamcheck.nc.control import control
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import OpcuaSettings

# Faults of the played control by name, and what happens; each at a layer, from 1
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

LEAST_WAIT_S = 0.05  # least real time of a wait of the main program, however fast it plays
SHOWN_S = 0.6  # time for which a wrong value is shown: several times the grid
FAULT_S = 1.0  # time for which writes are refused or lost, or the server is away


# -- what it holds -----------------------------------------------------------------------------------


@dataclass
class Panel:
    """State of a played control, for the threads of its server and its program: each value is set and read in one step."""

    # R parameters by number; those that are not there are 0
    values: dict[int, float] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)  # variables of text, by what they are
    files: dict[str, bytes] = field(default_factory=dict)  # files by their place
    rights: str = "operate"  # `operate`, `refused`, or `lost`: what becomes of writes from outside
    swap_next: bool = False  # whether the next upload is kept as another file
    break_next: bool = False  # whether the server goes away in the middle of the next upload
    # R parameters that another client writes over as soon as they are written, once, and what it writes
    overwritten: dict[int, float] = field(default_factory=dict)

    def get(self, number: int) -> float:
        """Return an R parameter."""
        return self.values.get(number, 0.0)

    def set(self, number: int, value: float) -> None:
        """Set an R parameter from within the control: rights do not matter."""
        self.values[number] = value

    def write(self, number: int, value: float) -> float:
        """Set an R parameter from outside, where that is allowed; return what it is then."""
        if self.rights == "operate":
            self.values[number] = self.overwritten.pop(number, value)
        return self.get(number)

    def upload(self, place: str, content: bytes) -> bool:
        """Keep a file; return whether the server is to go away in the middle of it."""
        if self.break_next:
            self.break_next, self.files[place] = False, content[: len(content) // 2]
            return True
        if self.swap_next:
            self.swap_next, content = False, content.replace(b"X", b"Y", 1)
        if self.rights == "operate":
            self.files[place] = content
        return False


@dataclass(frozen=True)
class Growth:
    """How high a layer comes out: its planned height times ``1 + drift + noise n``, with n of the normal distribution, which seed
    and layer give."""

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

        >>> Growth(drift=0.1).grown_mm(3, 2.0)
        2.2
        """
        noise = float(np.random.default_rng((self.seed, layer)).standard_normal()) if self.noise else 0.0
        return max(thickness_mm * (1.0 + self.drift + self.noise * noise), 0.05 * thickness_mm)


# -- its program -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PlayedLayer:
    """A layer that was called and laid."""

    layer: int
    name: str
    sha256: str
    base_mm: float
    planned_mm: float
    grown_mm: float
    wait_s: float


class Reset(Exception):
    """RESET on the control: the program ends where it is."""


class PlayedProgram:
    """The main program that waits, the bed and who measures, with named faults at layers, from 1."""

    def __init__(
        self,
        config: Config,
        opcua: OpcuaSettings,
        top_mm: float,
        growth: Growth,
        speed: float,
        faults: Mapping[int, tuple[str, ...]],
        told: Callable[[PlayedLayer], None] = lambda row: None,
    ) -> None:
        own = control(config.machine.control)
        if not own.waiting:
            why = "no main program is written that waits between layers"
            raise SettingsError(f"machine.control {config.machine.control!r}: {why}")
        self._text = str(own.load("waiting")(config, top_mm, {})[1])
        self.panel, self.config, self.opcua = Panel(), config, opcua
        self._growth, self._speed, self._told = growth, speed, told
        self._faults = {layer: list(names) for layer, names in faults.items()}
        self._first = config.machine.live_r
        # Called for what the server is to do: be away for a time, and be full for another
        self.act: Callable[[float, float], object] = lambda away_s, full_s: None
        self.bed_mm, self.laid = 0.0, list[PlayedLayer]()
        self._known: dict[int, float] = {}
        self._calls, self._time_s = 0, 0.0
        self._waiting: tuple[int, float] | None = None
        self._operator: float | None = None
        self._since = time.monotonic()
        self.stopped = False
        self.ended = False  # whether the program came to its end: the part is built

    def run(self) -> None:
        """Play until the part is built, or the program stops for good."""
        self._before(1)
        while not self.stopped:
            self._calls, self._time_s, self._known = 0, 0.0, {}
            try:
                run = run_text(self._text, self._door, self.config, 10**9)
            except Reset:
                continue
            self.ended = bool(run.stops) and run.stops[-1][0] == "M30"
            return

    # -- the door of the text ----------------------------------------------------------------------

    def _r(self, role: str) -> int:
        return self._first + OFFSETS[role]

    def _door(self, run: Run) -> None:
        """Time has gone by in the text: let it go by here, lay what was called, and exchange R parameters."""
        if self.stopped:
            raise Reset
        self._exchange(run)
        if len(run.calls) > self._calls:
            self._calls = len(run.calls)
            self._lay(run.calls[-1][0])
        elif run.time_s > self._time_s:
            time.sleep(max((run.time_s - self._time_s) / self._speed, LEAST_WAIT_S))
            self._time_s = run.time_s
            self._measure()
            self._command()
        self._exchange(run)

    def _exchange(self, run: Run) -> None:
        """What the program has set goes out; all else comes in."""
        for number in range(self._first, self._first + 1 + max(OFFSETS.values())):
            name = f"R{number}"
            mine = float(run.values.get(name, self._known.get(number, self.panel.get(number))))
            if name in run.values and mine != self._known.get(number):
                self.panel.set(number, mine)
            self._known[number] = self.panel.get(number)
            if name in run.values or run.values:
                run.values[name] = self._known[number]

    def _command(self) -> None:
        """The operator, once the program waits again."""
        waited_s = self.panel.get(self._r("waited"))
        if self._operator is not None and waited_s > 2.0 * self.config.machine.live_poll_s:
            self.panel.set(self._r("begin_at"), self._operator)
            self._operator = None

    # -- layers ------------------------------------------------------------------------------------

    def _lay(self, name: str) -> None:
        content = self.panel.files.get(file_path(self.config.machine, self.opcua, f"{name}.SPF"))
        if content is None:
            raise BackendFailed(f"alarm 14011: the main program calls {name}, which is not on the control")
        text, layer = content.decode("ascii"), int(self.panel.get(self._r("done"))) + 1
        wait_s = time.monotonic() - self._since
        planned_mm = top_of(text) - self.bed_mm
        seconds = planned_s(text, self.config.machine.rapid_mm_s) / self._speed
        if self._has(layer, "reset"):
            time.sleep(0.5 * seconds)
            self._operator = float(layer)
            raise Reset
        time.sleep(seconds)
        grown_mm, sha256 = self._growth.grown_mm(layer - 1, planned_mm), hashlib.sha256(content).hexdigest()
        row = PlayedLayer(layer, name, sha256, self.bed_mm, planned_mm, grown_mm, wait_s)
        self.bed_mm += grown_mm
        self.laid.append(row)
        self._told(row)
        self._waiting, self._since = (layer, self.bed_mm), time.monotonic()

    def _has(self, layer: int, name: str) -> bool:
        found = self._faults.get(layer, [])
        if name in found:
            found.remove(name)
            return True
        return False

    def _before(self, layer: int) -> None:
        self.panel.break_next = self._has(layer, "upload")
        self.panel.swap_next = self._has(layer, "other-file")
        if self._has(layer, "other-client"):
            self.panel.overwritten[self._r("number")] = 99.0
        for name, rights in (("refuse", "refused"), ("lost-writes", "lost")):
            if self._has(layer, name):
                self.panel.rights = rights
                self._rights_until = time.monotonic() + FAULT_S

    def _measure(self) -> None:
        """The height of a layer that is done, once its count is shown; with the faults of who measures."""
        if self.panel.rights != "operate" and time.monotonic() >= self._rights_until:
            self.panel.rights = "operate"
        if self._waiting is None or self.panel.get(self._r("done")) != self._waiting[0]:
            return
        layer, height = self._waiting
        if self._has(layer, "reset-between"):
            self._operator = float(layer + 1)
            raise Reset
        self._waiting = None
        if self._has(layer, "late"):
            time.sleep(FAULT_S)
        if self._has(layer, "away"):
            self.act(FAULT_S, 0.0)
        if self._has(layer, "sessions"):
            self.act(0.5, FAULT_S)
        self._before(layer + 1)
        for shown in (layer + 7.0, float(layer)) if self._has(layer, "count") else ():
            self.panel.set(self._r("done"), shown)
            time.sleep(SHOWN_S)
        if self._has(layer, "stray"):
            self.panel.set(self._r("released"), layer + 1.0)
            time.sleep(SHOWN_S)
            self.panel.set(self._r("released"), layer + 1.0)
        for name, shown, of in (
            ("missing", math.nan, layer),
            ("absurd", height + 500.0, layer),
            ("inches", height / 25.4, layer),
            ("jump", height, layer + 3),
        ):
            if self._has(layer, name):
                self._show(shown, of)
                time.sleep(SHOWN_S)
                self.panel.set(self._r("measured"), 0.0)
        self._show(height, layer)
        if self._has(layer, "repeated"):
            time.sleep(SHOWN_S)
            self._show(height + 0.4, layer)

    def _show(self, height: float, layer: int) -> None:
        self.panel.set(self._r("height"), height)
        self.panel.set(self._r("measured"), float(layer))


_PLACE = re.compile(r"(?:PO\[([XY])\]=\(|([XY])=?)(-?\d+\.?\d*)")


def top_of(text: str) -> float:
    """Z of the top of the layer that a text lays: the lowest Z of its blocks.

    >>> top_of("%_N_A_SPF\\n; Z 1.0\\nN10 G0 Z21.5\\nN20 G0 Z1.5\\nN30 G1 X1 F600\\n")
    1.5
    """
    blocks = (line.partition(";")[0] for line in text.split("\n") if line[:1] == "N")
    return min(float(z) for block in blocks for z in re.findall(r" Z(-?\d+\.?\d*)", block))


def planned_s(text: str, rapid_mm_s: float) -> float:
    """Time of a layer by its text: chords over feed, rapid moves, and waits; near enough for a machine that plays.

    >>> planned_s("N10 G0 X0 Y0\\nN20 G1 X10 Y0 F600\\nN30 X10 Y20\\nN40 G4 F2\\n", 100.0)
    5.0
    """
    seconds, feed_mm_s, rapid, x, y = 0.0, 1.0, False, 0.0, 0.0
    for line in text.split("\n"):
        if line[:1] != "N":
            continue
        code = line.partition(";")[0]
        if pause := re.search(r" G4 F(\d+\.?\d*)", code):
            seconds += float(pause[1])
            continue
        if feed := re.search(r" F(\d+\.?\d*)", code):
            feed_mm_s = float(feed[1]) / 60.0
        if mode := re.search(r" (G0|G1|G2|G3|POLY|BSPLINE)\b", code):
            rapid = mode[1] == "G0"
        to = {(a or b): float(value) for a, b, value in _PLACE.findall(code)}
        if to:
            new = to.get("X", x), to.get("Y", y)
            seconds += math.dist((x, y), new) / (rapid_mm_s if rapid else max(feed_mm_s, 1e-3))
            x, y = new
    return seconds
