"""The beam and wire templates of a machine profile: what they may hold, and how they are filled.

A word in a template changes the machine's state as it would on the control. So each code in it is one that the profile declares
(:mod:`ebamcheck.nc.codes`); a template switches what its name says, once, and no other; a value is filled with what its code means,
without arithmetic; and the beam does not stand waiting."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import product

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.kernels import Floats
from ebamcheck.nc.codes import (
    AUXILIARY,
    BEAM_TEMPLATES,
    BEAM_VALUES,
    DWELL,
    FOCUS,
    FOCUS_TEMPLATES,
    SWITCHES,
    VALUES,
    WIRE_TEMPLATES,
    WIRE_VALUES,
    Action,
    Codes,
    blocks_of,
    templates_of,
)
from ebamcheck.nc.control import control
from ebamcheck.nc.conventions import increments_of, plain, to_increment
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings
from ebamcheck.settings.process import KeepOut
from ebamcheck.settings.process_window import wire_speed_mm_s

LONGEST_BLOCK = 200  # Characters of a block that every software version of the control takes


class _Value(float):
    """A number that a bare placeholder prints without exponent and trailing zeros."""

    def __format__(self, spec: str) -> str:
        return float(self).__format__(spec) if spec else plain(self)


@dataclass(frozen=True)
class ProcessValues:
    """What the placeholders of the templates stand for in one layer; its wire speed is that of a bead by itself."""

    power_w: float
    voltage_kv: float
    current_ma: float
    wire_mm_s: float
    wire_retract_mm: float
    feed_mm_min: float
    layer_pause_s: float
    layer: int
    height_mm: float
    defocus: float = 0.0
    # Least step of each value that has one: it is printed as a multiple of it.
    increments: Mapping[str, float] = field(default_factory=dict)

    def printed(self, name: str) -> float:
        """One of the values as it is printed."""
        return to_increment(getattr(self, name), self.increments.get(name, 0.0))

    @cached_property
    def _placeholders(self) -> _Placeholders:
        return _Placeholders(self)

    def at(self, power: float, wire: float) -> ProcessValues:
        """The same values at a share of the beam's power, by its current, and a share of the wire speed."""
        power_w, current_ma = power * self.power_w, power * self.current_ma
        return replace(self, power_w=power_w, current_ma=current_ma, wire_mm_s=wire * self.wire_mm_s)

    def fill(self, name: str, template: Iterable[str]) -> list[str]:
        """Fill the lines of the template `name`; raises :class:`SettingsError` for what makes no block."""
        return [_filled(f"machine.{name}", line, self._placeholders) for line in template]


class _Placeholders(dict[str, object]):
    """Values by the names of placeholders, each printed when a template first asks for it."""

    def __init__(self, values: ProcessValues) -> None:
        super().__init__()
        self._values = values

    def __missing__(self, name: str) -> object:
        if name not in PLACEHOLDERS:
            raise KeyError(name)
        value = self._values.printed(name)
        self[name] = value if isinstance(value, int) else _Value(value)
        return self[name]


PLACEHOLDERS = tuple(one.name for one in fields(ProcessValues) if one.name != "increments")


def _filled(where: str, line: str, values: Mapping[str, object]) -> str:
    known = f"known are {', '.join(PLACEHOLDERS)}"
    try:
        text = line.format_map(values)
    except KeyError as error:
        raise SettingsError(f"{where}: {line!r}: unknown placeholder {error}; {known}") from None
    except (ValueError, IndexError, AttributeError) as error:
        raise SettingsError(f"{where}: {line!r} is not a template: {error}") from None
    if not text.isascii() or not text.isprintable() or len(text) >= LONGEST_BLOCK - 10:
        what = f"is not one line of under {LONGEST_BLOCK - 10} ASCII characters"
        raise SettingsError(f"{where}: {line!r} {what}")
    return text


def usable_templates(config: Config, control: str) -> dict[str, tuple[str, ...]]:
    """Templates of a control as they are written, each held to its name; refused where one makes no block or holds what it must
    not."""
    checked_preheating(config, control)
    checked_tilt(config, control)
    templates = templates_of(config.machine, control)
    sample = process_values(config, 1, config.layer_height_mm, config.layer_height_mm)
    for name, lines in templates.items():
        sample.fill(name, lines)
    checked_templates(config.machine, control)
    if config.machine.trailing_comments:
        return templates
    bare = {name: [line.split(";", 1)[0].rstrip() for line in lines] for name, lines in templates.items()}
    return {name: tuple(line for line in lines if line) for name, lines in bare.items()}


def process_values(config: Config, layer: int, height_mm: float, thickness_mm: float) -> ProcessValues:
    """Values of the placeholders in a layer, counted from 1."""
    return ProcessValues(
        power_w=config.process.power_w, voltage_kv=config.process.voltage_kv, current_ma=config.process.current_ma,
        wire_mm_s=wire_speed_mm_s(config, config.process.bead_metal_mm, thickness_mm),
        wire_retract_mm=config.process.wire_retract_mm, feed_mm_min=60.0 * config.process.travel_speed_mm_s,
        layer_pause_s=config.process.layer_pause_s, layer=layer, height_mm=height_mm,
        increments=increments_of(config.machine),
    )  # fmt: skip


FREE = ("layer", "height_mm", "feed_mm_min")  # Placeholders that an auxiliary code may carry
# Values of which a template sets one, if it is not empty.
NEEDED: Mapping[str, tuple[str, ...]] = {
    "set_power": ("current_ma", "power_w"),
    "set_wire": ("wire_mm_s",),
    "wire_start": ("wire_mm_s",),
    "wire_retract": ("wire_retract_mm",),
    "set_focus": (FOCUS,),
}
UNDER_BEAM = ("set_power", "set_wire", "wire_start", "wire_stop", "wire_retract")  # Run while the beam is on
# Blocks of each template as text, and what the codes of each do.
Programmed = Mapping[str, tuple[tuple[str, tuple[Action, ...]], ...]]


def checked_templates(machine: MachineSettings, dialect: str) -> Programmed:
    """Take the templates of a profile apart and hold each to its name; a refusal names template, block and word."""
    templates = {name: blocks_of(lines) for name, lines in templates_of(machine, dialect).items()}
    ends: dict[str, str] = {}
    for name in SWITCHES:
        if not (blocks := templates[name]):
            raise SettingsError(f"machine.{name} has no block: its state could not be told from the text")
        other = ends.setdefault(blocks[-1], name)
        if other != name:
            what = f"machine.{name} and machine.{other} end with the same block {blocks[-1]!r}"
            raise SettingsError(what)
    codes, result = Codes(machine, dialect), {}
    for name, blocks in templates.items():
        where = f"machine.{name}"
        result[name] = tuple((block, tuple(codes.actions(where, block))) for block in blocks)
        for what in _wrong(name, result[name]):
            raise SettingsError(f"{where}{what}")
    for name, wanted in NEEDED.items():
        filled = [action.placeholder for _, actions in result[name] for action in actions]
        if result[name] and not any(value in filled for value in wanted):
            raise SettingsError(f"machine.{name} sets none of {', '.join(wanted)}, which is what it is for")
    blocks_of_power = (*result["set_beam"], *result["beam_on"])
    filled = [action.placeholder for _, actions in blocks_of_power for action in actions]
    if "power_w" not in filled and not {"voltage_kv", "current_ma"} <= set(filled):
        what = "machine.set_beam and beam_on set no power: give {voltage_kv} and {current_ma}, or {power_w}"
        raise SettingsError(what)
    return result


NO_HEIGHT = KeepOut.model_fields["z_mm"].default  # Of a zone to stay out of, and no body


def _wrong(name: str, blocks: Sequence[tuple[str, tuple[Action, ...]]]) -> Iterator[str]:
    """What is wrong with a template, in words behind its name."""
    # What is switched on has its value by then, at the latest in the same block.
    on = False
    for _, actions in blocks:
        late = next((action for action in actions if action.meaning in VALUES), None)
        if on and late is not None:
            yield f": {late.word!r} comes after the switch: set values before it"
        on = on or (name in ("beam_on", "wire_start") and any(a.meaning == name for a in actions))
    # A template switches what its name says, once, and nothing else; and waits only with the beam off.
    every = [action for _, actions in blocks for action in actions]
    switched = [action for action in every if action.meaning in SWITCHES]
    for action in switched:
        if action.meaning != name:
            yield f": {action.word!r} is declared as {action.meaning}: {name} must not hold it"
    if name in SWITCHES and len(switched) != 1:
        count = f"{len(switched)} times" if switched else "nowhere"
        codes = f"machine.{name.split('_')[0]}_codes"
        yield f" switches {count}: it must hold the code declared as {name} once ({codes})"
    beam_on = name in UNDER_BEAM or name == "beam_off"
    for action in every:
        if action.meaning == DWELL and beam_on:
            yield f": {action.word!r} lets the beam stand: wait with the beam off"
        beam_on = action.meaning == "beam_on" or (beam_on and action.meaning != "beam_off")
    # A value is its own placeholder, or 0; the values of the beam stand in templates of the beam, those of the wire too.
    for block, action in ((block, action) for block, actions in blocks for action in actions):
        means, filled, said = action.meaning, action.placeholder, f": {block!r}: {action.word!r}"
        if means in VALUES:
            other = name in BEAM_TEMPLATES and means in WIRE_VALUES
            other = other or (name in WIRE_TEMPLATES and means in BEAM_VALUES)
            if other or (name in FOCUS_TEMPLATES) != (means == FOCUS):
                yield f"{said} sets {means}, which {name} must not"
            if filled and filled != means:
                yield f"{said} is declared as {means} and filled with {filled}"
            if not filled and action.number != 0.0:
                yield f"{said} is declared as {means}: give {{{means}}} or 0 in place of {action.number:g}"
        elif means == AUXILIARY and filled and filled not in FREE:
            yield f"{said} is auxiliary: of the placeholders it may carry {', '.join(FREE)}"


def checked_preheating(config: Config, name: str) -> None:
    """Refuse preheating that this machine, or the control `name`, cannot do, or that would be none, by setting and what to do."""
    settings, machine, process = config.preheat, config.machine, config.process
    if settings.when == "off":
        return
    hottest_k, entry_k = settings.target_k + settings.over_k, entry_limit_k(config)
    slow, fast = machine.feed_min_mm_s, machine.feed_max_mm_s
    for refused, why in (
        (not control(name).subprogram_suffix, f"control {name!r} has programs of one file: a scan is a subprogram of its own"),
        (not machine.set_focus, 'machine.set_focus is empty: give the block that sets the focus, such as "H5={defocus} ; focus"'),
        (
            settings.defocus == 0.0,
            "preheat.defocus is 0, the focus of the beads: give the value at which the beam is preheat.spot_mm wide",
        ),
        (
            settings.current_ma > process.current_max_ma,
            f"preheat.current_ma {settings.current_ma:g} is over process.current_max_ma {process.current_max_ma:g}",
        ),
        (
            not slow <= settings.speed_mm_s <= fast,
            f"preheat.speed_mm_s {settings.speed_mm_s:g} is not within machine.feed_min_mm_s and feed_max_mm_s, {slow:g} .. {fast:g}",
        ),
        (
            settings.when == "layers" and process.layer_pause_s > 0.0,
            "process.layer_pause_s lets layers cool that preheat.when = 'layers' heats: use one of them",
        ),
        (hottest_k > entry_k, f"preheat.target_k + over_k is {hottest_k:g} K, over {entry_k:g} K at which no bead may be entered"),
        (
            config.base_mm > 0.0 and settings.scan_in == "own",
            "the program begins on what stands (layers.base_mm), and its main program preheats nothing: set preheat.scan_in = 'layer'",
        ),
    ):  # fmt: skip
        if refused:
            raise SettingsError(f"preheat.when is {settings.when!r}: {why}")


def checked_tilt(config: Config, name: str) -> None:
    """Refuse a turned layer for a control that has no frames, or a machine without rotary axes, by setting and what to do."""
    if config.part.on_table is None:
        return
    if not config.machine.rotary:
        raise SettingsError(
            "part.on_table says that the part is turned between layers, and machine.rotary names no axis that turns it"
        )
    if not control(name).frames:
        raise SettingsError(
            f"machine.control {name!r}: no program is written for it that turns a tilt table (machine.rotary), since it has no frame for the "
            "turned layer: leave machine.rotary out, turn the part with machine.tilt_axes, and set the offset on the control"
        )
    if config.preheat.when != "off":
        raise SettingsError(
            f"preheat.when is {config.preheat.when!r}: a turned layer is not preheated; set preheat.when = 'off'"
        )


def carried_corners(config: Config) -> Floats:
    """Corners (n, 3) of all that the table carries, its axes at 0: box of the part, base plate, and clamps of known height."""
    machine, process, stands = config.machine, config.process, config.part.on_table
    assert stands is not None
    box = list(zip(stands.low_mm, stands.high_mm, strict=True))
    low = machine.base_plate_min_mm or stands.low_mm[:2]
    high = machine.base_plate_max_mm or stands.high_mm[:2]
    corners = [*product(*box), *product(*zip(low, high, strict=True), (-process.base_plate_mm, 0.0))]
    for zone in process.keep_out:
        if zone.z_mm != NO_HEIGHT:
            corners += [(x, y, z) for (x, y), z in product(zone.outline_mm, zone.z_mm)]
    return np.array(corners, np.float64)
