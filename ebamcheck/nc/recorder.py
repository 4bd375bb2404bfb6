"""What a reader notes down while it runs a program: motions, events and block numbers, and what the templates of the profile do."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from string import Formatter

import numpy as np

from ebamcheck.atomic_file import regular_file
from ebamcheck.errors import InputError
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.codes import AUXILIARY, BEAM_VALUES, DWELL, SWITCHES, Action
from ebamcheck.nc.motions import ARC, RAPID, NCProgram, SourceFile
from ebamcheck.nc.roles import by_shape, with_travel, without_preheating
from ebamcheck.nc.table import TableState, starts_in_frames
from ebamcheck.nc.templates import Programmed
from ebamcheck.nc.timeline import Events
from ebamcheck.nc.words import NUMBER

NAN = float("nan")
LINE_OF_T = (0.0, 0.0, 0.0, 0.0, 1.0)  # Coefficients of t^2 and t^3 in X, then Y; length of t
NO_CENTRE = (NAN, NAN, NAN)
MOST_DIGITS = 8  # Digits of a block number: a SINUMERIK takes eight, and no control here takes more
LARGEST = 1e8  # No control takes more: a Fanuc eight digits in all, a SINUMERIK five of an axis
LEAST_FEED = 1e-6  # Lesser ones but 0 are under the steps of any control, and have no end
_KEY = re.compile(r"\s*([^:]+):\s*(.*?)\s*")


class Recorder:
    """State of the control, and the motions (rows) that it made so far."""

    def __init__(self, folder: Path, dialect: str, axes: tuple[str, ...] = (), scans_in_layers: bool = False) -> None:
        self._scans_in_layers = scans_in_layers
        self.folder = folder
        self.dialect = dialect
        self.files: list[SourceFile] = []
        self.header: dict[str, str] = {}
        self.layer_files: list[str] = []
        self.file = self.line = 0
        self.x = self.y = self.z = NAN
        self._rows: list[tuple[float, ...]] = []
        self._states: list[tuple[float, ...]] = []
        self._state = -1
        self._events: list[tuple[int, int, int, str, float]] = []
        self._numbers: list[tuple[int, int, int]] = []
        self._file_index: dict[str, int] = {}
        self._feed = NAN
        self._beam = self._wire = False
        self._set: dict[str, float] = {}
        self._layer = -1
        self._templates: list[str] = []
        self._templates_at = (-1, -1)
        self.table = TableState(axes)

    def open(self, path: Path) -> list[str]:
        """Read a file, and return its lines; a carriage return stays at the end of its line."""
        try:
            data = regular_file(path).read_bytes()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        lines = data.decode("latin-1").split("\n")
        index = self._file_index.setdefault(path.name, len(self.files))
        if index == len(self.files):
            self.files.append(SourceFile(path.name, data, len(lines) - (not lines[-1]), 0, ""))
        self.enter(index, 0)
        return lines

    def enter(self, file: int, line: int) -> None:
        """Go on in a file."""
        self.file, self.line = file, line
        self._state = -1

    def read_header(self, comment: str) -> None:
        """Read ``KEY: VALUE`` of a comment; the first value of a key counts. Comments say nothing of motions."""
        if key := _KEY.fullmatch(comment):
            self.header.setdefault(key[1], key[2])

    def close(self, end_line: int, end_code: str) -> None:
        """Note where the file ended."""
        known = self.files[self.file]
        self.files[self.file] = SourceFile(known.name, known.data, known.line_count, end_line, end_code)

    @property
    def main_stem(self) -> str:
        """Name of the main program without its ending."""
        return self.files[0].name.rpartition(".")[0] if self.files else ""

    def error(self, what: str, column: int) -> InputError:
        """Return a refusal with its place; `column` counts from 0."""
        return InputError(f"{self.files[self.file].name}:{self.line}:{column + 1}: {what}")

    @property
    def motions(self) -> int:
        """Number of motions so far."""
        return len(self._rows)

    @property
    def started(self) -> bool:
        """Whether there was a motion."""
        return bool(self._rows)

    def feed(self, mm_min: float) -> None:
        """Set the feed."""
        self._feed, self._state = mm_min, -1

    def layer(self, index: int) -> None:
        """Say which layer the motions are of that follow; -1 for none."""
        self._layer, self._state = index, -1

    def change(self, change: StateChange) -> None:
        """Do what a block of a template does."""
        self._state = -1
        self._follow(change)
        # The control takes the values of a block before it switches.
        for name, value in sorted(change.actions, key=lambda action: action[0] in SWITCHES):
            if name in SWITCHES:
                if name.startswith("beam"):
                    self._beam = name == "beam_on"
                else:
                    self._wire = name == "wire_start"
            elif name != DWELL:
                runs = (name in BEAM_VALUES and self._beam) or (name == "wire_mm_s" and self._wire)
                if runs and not change.running:
                    self.event(f"not along a bead {change.block}")
                self._set[name] = value
            self.event(name, value)

    def _follow(self, change: StateChange) -> None:
        """Note where a block that switches does not follow the blocks before it in its template."""
        here = (self.file, len(self._rows))
        if self._templates_at != here:
            self._templates, self._templates_at = [], here
        count = len(change.before)
        if count and tuple(self._templates[-count:]) != change.before:
            self.event(f"lacks {change.before[-1]}")
        self._templates.append(change.block)

    def event(self, name: str, value: float = NAN) -> None:
        """Note a change of the state."""
        self._events.append((self.file, self.line, len(self._rows), name, value))

    def number(self, digits: str) -> None:
        """Note the number of a block."""
        if len(digits.lstrip("0")) > MOST_DIGITS:
            raise self.error(f"block number of {len(digits)} digits: {MOST_DIGITS} at most", 0)
        self._numbers.append((self.file, self.line, int(digits)))

    def move(
        self, kind: int, x: float, y: float, z: float, curve: tuple[float, ...] = LINE_OF_T,
        centre: tuple[float, ...] = NO_CENTRE, line: int = 0,
    ) -> None:  # fmt: skip
        """Note a motion to x, y, z; `line` where it is not the present one."""
        # Here and not behind all motions: an arc from such a place would be refused in the place of it.
        if x > LARGEST or y > LARGEST or z > LARGEST or x < -LARGEST or y < -LARGEST or z < -LARGEST:
            raise self.error(f"a place over {LARGEST:g}, which no control takes", 0)
        if self._state < 0 or self.table.changed:
            self._keep_state()
        self._rows.append((line or self.line, self._state, kind, x, y, z, *curve, *centre))
        self.x, self.y, self.z = x, y, z

    def _keep_state(self) -> None:
        values = self._set
        self._state = len(self._states)
        self._states.append(
            (
                self.file, self._layer, self._feed, self._beam, self._wire,
                values.get("voltage_kv", NAN) * values.get("current_ma", NAN),
                values.get("power_w", NAN), values.get("wire_mm_s", NAN), *self.table.kept(),
            )
        )  # fmt: skip

    def set_frame(self, frame: Floats) -> None:
        """Put another frame in force: the tool stays where it is, which is another place in the new frame."""
        here = np.array([self.x, self.y, self.z])
        if np.isnan(here).all():
            self.table.set_frame(frame)
        else:
            self.x, self.y, self.z = self.table.seen_from(frame, here).tolist()

    def program(self) -> NCProgram:
        """Gather all that was read into columns; a number that no control takes is refused."""
        rows = np.array(self._rows, dtype=np.float64).reshape(len(self._rows), 14).T
        kept = np.array(self._states, dtype=np.float64).reshape(len(self._states), 10).T
        self._refuse_numbers(rows, kept)
        line, state, kind = rows[:3].astype(np.int64)
        states = kept[:, state]
        file, layer = states[:2].astype(np.int64)
        beam = states[3] > 0
        end = np.ascontiguousarray(rows[3:6].T)
        start = np.vstack([np.full((1, 3), np.nan), end[:-1]])[: len(end)]
        table = self.table.columns(states[8:].astype(np.int64))
        if table is not None:
            start = starts_in_frames(start, table)
        nothing = np.full(len(end), -1, np.int64)
        layer, layer_files = self._layers(layer, end[:, 2], beam & (kind != RAPID))
        # Powers of t in X and Y over 0 <= t <= 1, of the coefficients as LINE_OF_T has them.
        length = rows[10]
        second, third = (rows[[6, 8]] * length**2).T, (rows[[7, 9]] * length**3).T
        first = end[:, :2] - start[:, :2] - second - third
        coefficients = np.stack([start[:, :2], first, second, third], axis=2)
        coefficients[kind == ARC] = np.nan
        at = np.array([event[:3] for event in self._events], np.int64).reshape(-1, 3)
        files, lines, before = np.ascontiguousarray(at.T)
        names, values = tuple(event[3] for event in self._events), [event[4] for event in self._events]
        made = NCProgram(
            files=tuple(self.files), header=self.header, folder=self.folder, file=file, line=line, layer=layer, kind=kind,
            start=start, end=end, coefficients=coefficients, arc=np.ascontiguousarray(rows[11:14].T),
            feed_mm_min=states[2], beam=beam, wire=states[4] > 0, wire_mm_s=states[7],
            power_w=np.where(np.isnan(states[6]), states[5], states[6]),
            ring=nothing, island=nothing, turn=nothing > 0, goes_on=nothing > 0,
            events=Events(files, lines, before, names, np.array(values, np.float64)),
            numbers=np.array(self._numbers, dtype=np.int64).reshape(-1, 3),
            layer_files=layer_files, dialect=self.dialect, table=table,
        )  # fmt: skip
        return by_shape(without_preheating(made, self._scans_in_layers))

    def _refuse_numbers(self, rows: Floats, states: Floats) -> None:
        """Refuse a motion (14, B) or state (10, S) with a number that no control takes: what follows its path would not end."""
        feeds = states[2]
        bad_feed = (feeds > LARGEST) | ((feeds > 0.0) & (feeds < LEAST_FEED))
        # The centre of an arc that is nearly straight may lie farther away.
        of_motion = np.asarray((np.abs(rows[3:11]) > LARGEST).any(axis=0), np.bool_)
        wrong = np.flatnonzero(of_motion | bad_feed[rows[1].astype(np.int64)])
        if wrong.size:
            row = rows[:, wrong[0]]
            state = states[:, int(row[1])]
            self.file, self.line = int(state[0]), int(row[0])
            what = f"a number over {LARGEST:g}" if of_motion[wrong[0]] else f"a feed of {state[2]:g} mm/min"
            raise self.error(f"{what}, which no control takes", 0)
        for file, line, _, name, value in self._events:
            if abs(value) > LARGEST:
                self.file, self.line = file, line
                raise self.error(f"{name} is over {LARGEST:g}, which no control takes", 0)

    def _layers(self, layer: Ints, z: Floats, deposit: Bools) -> tuple[Ints, tuple[str, ...]]:
        """Layers as subprograms are called for them; in a program without calls, by the levels of Z of its deposits."""
        if self.layer_files:
            return layer, tuple(self.layer_files)
        rows = np.flatnonzero(deposit)
        layer = np.full(layer.size, -1, dtype=np.int64)
        layer[rows] = np.cumsum(np.diff(z[rows], prepend=z[rows[:1]]) != 0.0)
        count = int(layer.max(initial=-1)) + 1
        return with_travel(layer), (self.files[0].name,) * count


RUNNING = ("set_power", "set_wire")  # Templates that set values along a bead
ENDING = ("beam_off", "wire_stop")  # Templates that may set a value to 0 at the end of a bead
_ZEROS = re.compile(r"\b([A-Z])0+(?=\d)")


@dataclass(frozen=True)
class StateChange:
    """What a block of a template does."""

    block: str  # The block as it stands in the profile
    # Switches (NaN) and values that it sets, in the order of its codes.
    actions: tuple[tuple[str, float], ...]
    before: tuple[str, ...] = ()  # Blocks of the same template that come before one that switches
    # Whether the profile has the block in a template for values that change while beam and wire run, or as they end.
    running: bool = True


class Templates:
    """All template blocks of a profile, as patterns of text."""

    def __init__(self, templates: Programmed) -> None:
        self._literal: dict[str, StateChange] = {}
        self._patterns: list[tuple[re.Pattern[str], StateChange]] = []
        self._memory: dict[str, StateChange | None] = {}
        running = {block for name in (*RUNNING, *ENDING) for block, _ in templates[name]}
        for name, blocks in templates.items():
            for i, (block, actions) in enumerate(blocks):
                switches = any(action.meaning in SWITCHES for action in actions)
                before = tuple(text for text, _ in blocks[:i]) if name in SWITCHES and switches else ()
                self._add(block, actions, before, block in running or not any(map(templates.get, RUNNING)))
        # A block that switches is looked for before one that fits the same text and does not.
        self._patterns.sort(key=lambda entry: not any(name in SWITCHES for name, _ in entry[1].actions))

    def _add(self, block: str, actions: tuple[Action, ...], before: tuple[str, ...], running: bool) -> None:
        # What is filled in, else what the code means.
        names = (a.placeholder if a.meaning == DWELL and a.placeholder else a.meaning for a in actions)
        numbers = (NAN if a.number is None else a.number for a in actions)
        each = zip(names, numbers, actions, strict=True)
        known = tuple((name, number) for name, number, a in each if a.meaning != AUXILIARY)
        change = StateChange(block, known, before, running)
        plain = _without_zeros(block)
        if "{" not in plain:
            self._literal.setdefault(plain, change)
            return
        parts = [
            re.escape(literal) + ("" if name is None else f"(?P<{name}__{count}>{NUMBER})")
            for count, (literal, name, _spec, _conversion) in enumerate(Formatter().parse(plain))
        ]
        self._patterns.append((re.compile("".join(parts), re.IGNORECASE), change))

    def find(self, code: str) -> StateChange | None:
        """Return what the block does, if it is of a template; words set apart by any number of blanks, M60 written M060."""
        if code not in self._memory:
            self._memory[code] = self._search(_without_zeros(" ".join(code.split())))
        return self._memory[code]

    def _search(self, code: str) -> StateChange | None:
        if code in self._literal:
            return self._literal[code]
        for pattern, change in self._patterns:
            found = pattern.fullmatch(code)
            if found:
                filled = {group.rsplit("__", 1)[0]: float(text) for group, text in found.groupdict().items()}
                actions = [(name, filled.pop(name, value)) for name, value in change.actions]
                return StateChange(change.block, (*actions, *filled.items()), change.before, change.running)
        return None


def _without_zeros(block: str) -> str:
    return _ZEROS.sub(r"\1", block)
