"""Checks of the machine's state at every motion: modal groups, start and end of the program, order of events.

The events of a program are run in their order beside its motions; whatever breaks a rule is named at the block that does.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator

import numpy as np

from ebamcheck.program.checking.checks import Check, count_check, event_place
from ebamcheck.program.language.codes import BEAM_VALUES, DWELL, SWITCHES
from ebamcheck.program.language.control import Group, control
from ebamcheck.program.language.modal_groups import group_of, wanted_words
from ebamcheck.program.language.profile import templates_of
from ebamcheck.program.language.safe_end import safe_end_mm
from ebamcheck.program.language.words import SKIPPED
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config

FLOW = "program flow"
"""Group whose words have checks of their own: ends of programs, stops."""

TRANSFORMATION_OFF = "TRAFOOF"
"""Word of a SINUMERIK."""

WAITS = ("layer_pause_s", DWELL)

STOPS = ("M0", "M1")

NOT_ALONG = "not along a bead "
"""Begin of an event, behind which the block stands."""

PLACE_MM = 1e-3
"""Places nearer than this are one: three decimals are the fewest of a program."""

PRINTED_SHARE = 1e-3
"""Rounding of a tolerance to the decimals of a value. A lesser tolerance is a fault, too: the beam lingers in corners."""

Faults = list[tuple[str, str]]


def machine_state_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check modes and smoothing at every motion, start state, order of events, and safe end."""
    modes, paths = _broken_groups(nc, config)
    modes += _offset_lost(nc, config)
    modes += _uneven_entries(nc, list(wanted_words(nc.dialect, config.machine).values()))
    return [
        _modes(nc, config, modes),
        _smoothing(nc, config, paths),
        count_check(
            "start state", _start(nc, config), "modes, beam and wire off, values, before the first motion"
        ),
        count_check("order of events", list(_order(nc, config)), "values, then beam, then wire; off in turn"),
        count_check("safe end", _end(nc, config), "beam and wire off, values 0, retracted and parked"),
    ]


# -- modal groups --------------------------------------------------------------------------------------


def _broken_groups(nc: NCProgram, config: Config) -> tuple[Faults, Faults]:
    """Words that set a group to another than the one wanted, or change one that was set; those of the path apart.

    The main program sets every group itself, before its first motion or call.
    """
    wanted = wanted_words(nc.dialect, config.machine)
    faults: dict[bool, Faults] = {False: [], True: []}
    state: dict[str, str] = {}
    places: dict[str, str] = {}
    begun = False
    for i, name in enumerate([*nc.events.name, ""]):
        moved = not name or nc.events.row[i] > 0 or name.startswith("call ")
        if moved and not begun:
            begun = True
            for lacking, fault in _missing(nc, wanted, places):
                faults[lacking.path].append(fault)
        group = group_of(nc.dialect, name)
        if group is None or group.name == FLOW:
            continue
        held = wanted.get(group.name) or (state.get(group.name) if begun else None)
        if held is not None and name != held:
            what = f"{name}: {group.name} is to be {held} at every motion"
            faults[group.path].append((event_place(nc, i), what))
        state[group.name] = name
        places.setdefault(group.name, event_place(nc, i))
    return faults[False], faults[True]


def _offset_lost(nc: NCProgram, config: Config) -> Faults:
    """Motions whose work offset went with a transformation that was switched off, and was not chosen again behind it.

    Source: Siemens, Job Planning, constraints when selecting a transformation: the control deselects the frame in force.
    """
    offset, lost, faults = wanted_words(nc.dialect, config.machine).get("work offset"), -1, []
    for i, name in enumerate([*nc.events.name, ""]):
        moved = lost >= 0 and (nc.events.row[i] if name else len(nc)) > nc.events.row[lost]
        if moved:
            faults.append(
                (
                    event_place(nc, lost),
                    f"TRAFOOF takes {offset} back, which no block behind it chooses again",
                )
            )
        lost = i if name == TRANSFORMATION_OFF else -1 if moved or name == offset else lost
    return faults


def modes_of_scans(scans: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    """Words in preheating scans that are other than those that hold at every motion of the program, and stops.

    A scan may leave a word out, since the program around it has set it. In another work offset it would heat beside the part, and so
    would be what comes after it.
    """
    wanted, limit = wanted_words(scans.dialect, config.machine), config.machine.smoothing_tolerance_mm
    yield from _offset_lost(scans, config)
    for i, name in enumerate(scans.events.name):
        group = group_of(scans.dialect, name)
        if name in STOPS:
            yield event_place(scans, i), f"{name} stops while it preheats"
        elif name in ("CTOL", "ADIS") and not abs(scans.events.value[i] - limit) <= PRINTED_SHARE * limit:
            yield event_place(scans, i), f"{name} {scans.events.value[i]:g} mm in place of {limit:g} mm"
        elif group is not None and group.name != FLOW and wanted.get(group.name) != name:
            held = wanted.get(group.name, "as the control has it")
            yield event_place(scans, i), f"{name}: {group.name} is to be {held} at every motion"


def _missing(
    nc: NCProgram, wanted: dict[str, str], places: dict[str, str]
) -> Iterator[tuple[Group, tuple[str, str]]]:
    """Groups that are not set at the beginning, each at the place where the group before it is."""
    first = nc.where(0) if len(nc) else f"{nc.files[0].name}:1"
    where = next(iter(places.values()), first)
    for name, word in wanted.items():
        if name in places:
            where = places[name]
        else:
            what = f"{word} is not set by the program's own first blocks"
            yield group_of(nc.dialect, word) or Group(name, (word,)), (where, what)


def _modes(nc: NCProgram, config: Config, faults: Faults) -> Check:
    words = [
        word
        for word in wanted_words(nc.dialect, config.machine).values()
        if not getattr(group_of(nc.dialect, word), "path", False)
    ]
    return count_check("modes", faults, f"{' '.join(words)} at every motion")


def _smoothing(nc: NCProgram, config: Config, faults: Faults) -> Check:
    """How the control may leave the path: its words at every motion, and every tolerance within the one set."""
    limit = config.machine.smoothing_tolerance_mm
    if not control(nc.dialect).tolerance_word:
        known = set(wanted_words(nc.dialect, config.machine).values())
        return count_check(
            "smoothing", [*faults, *_own_smoothing(nc, known)], "no word for a tolerance: the control's own"
        )
    tolerances = [i for i, name in enumerate(nc.events.name) if name in ("CTOL", "ADIS")]
    value = max((float(nc.events.value[i]) for i in tolerances), default=math.inf)
    faults = [*faults, *_tolerances(nc, config, tolerances)]
    words = [w for w in wanted_words(nc.dialect, config.machine).values() if _is_path(nc, w)]
    if faults:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        return Check("smoothing", False, value, limit, "mm", faults[0][0], faults[0][1] + more)
    name = control(nc.dialect).tolerance_word
    return Check(
        "smoothing", True, value, limit, "mm", "", f"{' '.join(words)}{name}{value:g} at every motion"
    )


def _own_smoothing(nc: NCProgram, wanted: set[str]) -> Faults:
    """Words of the path in a program whose profile knows none: what tolerance they leave is not known."""
    return [
        (
            event_place(nc, i),
            f"{name}: the profile of this control sets no smoothing, and knows none of its tolerances",
        )
        for i, name in enumerate(nc.events.name)
        if name == "CTOL" or (_is_path(nc, name) and name not in wanted)
    ]


def _is_path(nc: NCProgram, word: str) -> bool:
    group = group_of(nc.dialect, word)
    return group is not None and group.path


def _tolerances(nc: NCProgram, config: Config, tolerances: list[int]) -> Iterator[tuple[str, str]]:
    limit = config.machine.smoothing_tolerance_mm
    names, values = nc.events.name, nc.events.value
    for i in tolerances:
        if not abs(values[i] - limit) <= PRINTED_SHARE * limit:
            yield event_place(nc, i), f"{names[i]} {values[i]:g} mm in place of {limit:g} mm"
        elif names[i] == "ADIS" and "G641" not in config.machine.smoothing:
            yield event_place(nc, i), "ADIS belongs to G641, which the profile does not set"
    if not tolerances or nc.events.row[tolerances[0]] > 0:
        where = nc.where(0) if len(nc) else f"{nc.files[0].name}:1"
        yield where, "no tolerance of the path is set before the first motion"
    keeps = control(nc.dialect).keeps_tolerance
    if keeps and not set(keeps) & set(config.machine.smoothing):
        where = nc.where(0) if len(nc) else f"{nc.files[0].name}:1"
        said = " ".join(config.machine.smoothing) or "nothing"
        yield (
            where,
            f"machine.smoothing is {said}, without {', '.join(keeps)}: no other word keeps the path within the tolerance",
        )
    bare = control(nc.dialect).smoothing_needs_tolerance
    for i, name in enumerate(names):
        if name == bare and not _tolerance_of(nc, i):
            word = control(nc.dialect).tolerance_word
            yield event_place(nc, i), f"{name} without {word}: the path may leave its corners by any distance"


def _tolerance_of(nc: NCProgram, i: int) -> bool:
    """Whether the G64 of an event has a P in its block."""
    block = (nc.events.file[i], nc.events.line[i])
    after = zip(nc.events.name[i + 1 :], nc.events.file[i + 1 :], nc.events.line[i + 1 :], strict=True)
    for name, file, line in after:
        if (file, line) != block:
            return False
        if name == "CTOL":
            return True
    return False


def _uneven_entries(nc: NCProgram, wanted: list[str]) -> Faults:
    """Layers that lack a mode or value with which others begin: the control could not enter the program there."""
    begins = _begun(nc, _entries(nc, set(wanted)))
    found = Counter(name for names in begins for name in names)
    usual = [name for name in (*wanted, *BEAM_VALUES) if 2 * found[name] > len(begins)]
    faults = []
    for names in begins:
        where = next(iter(names.values()))
        for name in usual:
            if name not in names:
                faults.append((where, f"{name} is not set where the layer begins, as it is in the others"))
            where = names.get(name, where)
    return faults


def _begun(nc: NCProgram, runs: list[tuple[int, int, dict[str, str]]]) -> list[dict[str, str]]:
    """The rows of modes with which layers begin, without single words that are said again later on.

    These are rows with fewer than half of the words of the fullest one of their layer: of their file, where each layer has one.
    """
    called = any(name.startswith("call ") for name in nc.events.name)
    last = len(nc) - 1
    of_layer = [
        file if called else int(nc.layer[min(row, last)]) if k and last >= 0 else -1
        for k, (file, row, _) in enumerate(runs)
    ]
    fullest: dict[int, int] = {}
    for layer, (_, _, names) in zip(of_layer, runs, strict=True):
        fullest[layer] = max(fullest.get(layer, 0), len(names))
    return [
        names for layer, (_, _, names) in zip(of_layer, runs, strict=True) if 2 * len(names) >= fullest[layer]
    ]


def _entries(nc: NCProgram, wanted: set[str]) -> list[tuple[int, int, dict[str, str]]]:
    """File, row of the next motion, and names and places of the modes and values with which the program and its layers begin.

    A row of blocks that set modes ends with the next motion, and where a mode follows a switch or a value: in one file
    the first blocks of the program are followed by those of its first layer.
    """
    runs: list[tuple[int, int, dict[str, str]]] = []
    here, ended = (-1, -1), True
    for i, name in enumerate(nc.events.name):
        place = (int(nc.events.file[i]), int(nc.events.row[i]))
        mode = name in wanted
        if mode and (ended or place != here):
            runs.append((*place, {}))
        ended = (ended or name in SWITCHES or name in BEAM_VALUES) and not mode
        if (mode or name in BEAM_VALUES) and runs and (mode or place == here):
            runs[-1][2].setdefault(name, event_place(nc, i))
        here = place if mode or place == here else here
    return runs


# -- start and end -------------------------------------------------------------------------------------


def _start(nc: NCProgram, config: Config) -> Faults:
    """What the first blocks of the program lack of a start state that depends on nothing before it."""
    where = nc.where(0) if len(nc) else f"{nc.files[0].name}:1"
    before = {name for name, row in zip(nc.events.name, nc.events.row, strict=True) if row == 0}
    set_beam = " ".join(templates_of(config.machine, nc.dialect)["set_beam"])
    wanted = {"beam_off": "the beam is not switched off", "wire_stop": "the wire is not stopped"}
    wanted |= {name: f"{name} is not set" for name in BEAM_VALUES if f"{{{name}" in set_beam}
    return [(where, f"{what} before the first motion") for name, what in wanted.items() if name not in before]


def _end(nc: NCProgram, config: Config) -> Faults:
    """What the last blocks lack: beam and wire off, values 0, the tool retracted and parked."""
    last = int(np.flatnonzero(nc.deposit)[-1]) if nc.deposit.any() else -1
    if last < 0:
        return []
    main = nc.files[0]
    where = f"{main.name}:{main.end_line or main.line_count}"
    after = {name: float(v) for name, v, row in zip(nc.events.name, nc.events.value, nc.events.row, strict=True) if row > last}  # fmt: skip
    templates = templates_of(config.machine, nc.dialect)
    settable = " ".join(line for name in ("set_beam", "set_power", "set_wire") for line in templates[name])
    known = {name for name in nc.events.name if f"{{{name}" in settable}
    faults = [
        (where, f"{name} does not come after the last bead")
        for name in ("wire_stop", "beam_off")
        if name not in after
    ]
    faults += [
        (where, f"{name} is not 0 at the end")
        for name in (*BEAM_VALUES, "wire_mm_s")
        if name in known and after.get(name) != 0.0
    ]
    x, y, z = nc.end[-1]
    least = safe_end_mm(float(np.nanmax(nc.end[nc.deposit, 2])), config)
    if not z >= least - PLACE_MM:
        faults.append((nc.where(len(nc) - 1), f"ends at Z {z:g} mm, {least:g} mm is over all that stands"))
    if not math.dist((x, y), config.machine.park_position_mm) <= 2.0 * PLACE_MM:
        place = "X {:g} Y {:g}".format(*config.machine.park_position_mm)
        faults.append((nc.where(len(nc) - 1), f"ends at X {x:g} Y {y:g}, to be parked at {place}"))
    return faults


# -- order of events -----------------------------------------------------------------------------------


def _order(nc: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    """Blocks that come before what they need: values, then the beam, then the wire, and no wait under the beam."""
    values: dict[str, float] = {}
    beam = wire = False
    lit = fed = -1
    for i, name in enumerate(nc.events.name):
        value, row = float(nc.events.value[i]), int(nc.events.row[i])
        what = ""
        if name == "beam_on":
            what = "" if _has_power(values) else "the beam is switched on before its power is set"
            beam, lit = True, row
        elif name == "beam_off":
            what = "the beam is switched on and off without a motion between" if beam and row == lit else ""
            beam = False
        elif name == "wire_start":
            what = "" if beam else "the wire is started before the beam is on"
            what = what or (
                "" if values.get("wire_mm_s", 0.0) > 0.0 else "the wire is started before its speed is set"
            )
            wire, fed = True, row
        elif name == "wire_stop":
            wire = False
        elif name in WAITS:
            what = f"waits {value:g} s with the {'beam' if beam else 'wire'} on" if beam or wire else ""
        elif name == "wire_retract_mm":
            what = "the wire is drawn back while it runs" if wire else ""
        elif name == SKIPPED:
            what = "skipped or not, as the operator has chosen at the panel: the program would be two"
        elif name.startswith("lacks "):
            what = f"its template asks for {name.removeprefix('lacks ')!r} before this block"
        elif name.startswith(NOT_ALONG):
            block = name.removeprefix(NOT_ALONG)
            what = f"{block!r} sets a value at once, and the tool stands for it under the beam: along a bead the profile has another block"
        elif name == "M1":
            stop = (
                ""
                if config.machine.optional_stop
                else "stops for the operator, which the profile does not allow"
            )
            what = "stops with beam or wire on" if beam or wire else stop
        else:
            values[name] = value
            late = (beam and name in BEAM_VALUES and row == lit) or (
                wire and name == "wire_mm_s" and row == fed
            )
            what = f"{name} {value:g} is set after the switch, and before the first motion" if late else ""
        if what:
            yield event_place(nc, i), what


def _has_power(values: dict[str, float]) -> bool:
    """Whether the values set give the beam any power."""
    both = values.get("voltage_kv", 0.0) * values.get("current_ma", 0.0)
    return values.get("power_w", both) > 0.0
