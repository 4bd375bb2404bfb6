"""What the templates of a profile may hold: that each does what its name says, and nothing else.

A template runs like any other text of the program, so that a word in it changes the machine's state as it would on the
control. Each code in it is therefore one that the profile declares (:mod:`ebamcheck.nc.codes`), and these rules hold:
a template switches what its name says, once, and no other; a value is filled with what its code means, without arithmetic;
the beam does not stand waiting.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ebamcheck.errors import SettingsError
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
)
from ebamcheck.nc.profile import templates_of
from ebamcheck.settings.machine import MachineSettings

FREE = ("layer", "height_mm", "feed_mm_min")
"""Placeholders that an auxiliary code may carry."""

NEEDED: Mapping[str, tuple[str, ...]] = {
    "set_power": ("current_ma", "power_w"),
    "set_wire": ("wire_mm_s",),
    "wire_start": ("wire_mm_s",),
    "wire_retract": ("wire_retract_mm",),
    "set_focus": (FOCUS,),
}
"""Values of which a template sets one, if it is not empty."""

UNDER_BEAM = ("set_power", "set_wire", "wire_start", "wire_stop", "wire_retract")
"""Templates that run while the beam is on."""

Programmed = Mapping[str, tuple[tuple[str, tuple[Action, ...]], ...]]
"""Blocks of each template as text, and what the codes of each do."""


def checked_templates(machine: MachineSettings, dialect: str) -> Programmed:
    """Take the templates of a profile apart and hold each to its name.

    Raises
    ------
    SettingsError
        That names the template, its block and the word that is wrong.
    """
    templates = {name: blocks_of(lines) for name, lines in templates_of(machine, dialect).items()}
    _tell_switches_apart(templates)
    codes = Codes(machine, dialect)
    result = {}
    for name, blocks in templates.items():
        where = f"machine.{name}"
        found = tuple((block, tuple(codes.actions(where, block))) for block in blocks)
        _check_values_come_first(name, [actions for _, actions in found])
        _check_switches(name, [action for _, actions in found for action in actions])
        for block, actions in found:
            for action in actions:
                _check_value(name, block, action)
        result[name] = found
    _check_values(result)
    return result


def _tell_switches_apart(templates: Mapping[str, Sequence[str]]) -> None:
    ends: dict[str, str] = {}
    for name in SWITCHES:
        blocks = templates[name]
        if not blocks:
            raise SettingsError(f"machine.{name} has no block: its state could not be told from the text")
        if blocks[-1] in ends:
            raise SettingsError(
                f"machine.{name} and machine.{ends[blocks[-1]]} end with the same block {blocks[-1]!r}"
            )
        ends[blocks[-1]] = name


def _check_switches(name: str, actions: Sequence[Action]) -> None:
    """A template switches what its name says, once, and nothing else; and waits only with the beam off."""
    switched = [action for action in actions if action.meaning in SWITCHES]
    wrong = next((action for action in switched if action.meaning != name), None)
    if wrong is not None:
        raise SettingsError(
            f"machine.{name}: {wrong.word!r} is declared as {wrong.meaning}: {name} must not hold it"
        )
    if name in SWITCHES and len(switched) != 1:
        count = f"{len(switched)} times" if switched else "nowhere"
        raise SettingsError(
            f"machine.{name} switches {count}: it must hold the code declared as {name} once "
            f"(machine.{name.split('_')[0]}_codes)"
        )
    beam_on = name in UNDER_BEAM or name == "beam_off"
    for action in actions:
        if action.meaning == DWELL and beam_on:
            raise SettingsError(
                f"machine.{name}: {action.word!r} lets the beam stand: wait with the beam off"
            )
        beam_on = action.meaning == "beam_on" or (beam_on and action.meaning != "beam_off")


def _check_values_come_first(name: str, blocks: Sequence[Sequence[Action]]) -> None:
    """What is switched on has its value by then, at the latest in the same block."""
    switched = False
    for actions in blocks:
        late = next((action for action in actions if action.meaning in VALUES), None)
        if switched and late is not None:
            raise SettingsError(f"machine.{name}: {late.word!r} comes after the switch: set values before it")
        switched = switched or (name in ("beam_on", "wire_start") and any(a.meaning == name for a in actions))


def _check_value(name: str, block: str, action: Action) -> None:
    """A value is its own placeholder, or 0; the values of the beam stand in templates of the beam, those of the wire too."""
    where = f"machine.{name}: {block!r}"
    filled = action.placeholder
    if action.meaning in VALUES:
        other = (name in BEAM_TEMPLATES and action.meaning in WIRE_VALUES) or (
            name in WIRE_TEMPLATES and action.meaning in BEAM_VALUES
        )
        other = other or (name in FOCUS_TEMPLATES) != (action.meaning == FOCUS)
        if other:
            raise SettingsError(f"{where}: {action.word!r} sets {action.meaning}, which {name} must not")
        if filled and filled != action.meaning:
            raise SettingsError(
                f"{where}: {action.word!r} is declared as {action.meaning} and filled with {filled}"
            )
        if not filled and action.number != 0.0:
            raise SettingsError(
                f"{where}: {action.word!r} is declared as {action.meaning}: give {{{action.meaning}}} or 0 in place "
                f"of {action.number:g}"
            )
    elif action.meaning == AUXILIARY and filled and filled not in FREE:
        raise SettingsError(
            f"{where}: {action.word!r} is auxiliary: of the placeholders it may carry {', '.join(FREE)}"
        )


def _check_values(templates: Programmed) -> None:
    for name, wanted in NEEDED.items():
        filled = [action.placeholder for _, actions in templates[name] for action in actions]
        if templates[name] and not any(value in filled for value in wanted):
            raise SettingsError(f"machine.{name} sets none of {', '.join(wanted)}, which is what it is for")
    filled = [
        a.placeholder for name in ("set_beam", "beam_on") for _, actions in templates[name] for a in actions
    ]
    if "power_w" not in filled and not {"voltage_kv", "current_ma"} <= set(filled):
        raise SettingsError(
            "machine.set_beam and beam_on set no power: give {voltage_kv} and {current_ma}, or {power_w}"
        )
