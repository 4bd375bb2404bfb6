"""What a check came to: figure against limit, where it is worst, how much it matters, and what to do; gates and findings are
checks, too."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self, get_args

# How much it matters: worth knowing; to be looked at before the program is used; nothing with it is validated
Severity = Literal["note", "warning", "fault"]
Level = Literal["pass", "warning", "fault"]  # what a check of the preflight comes to
SEVERITIES: tuple[Severity, ...] = get_args(Severity)[::-1]  # the gravest first, as they are listed
# Every code that a finding may have, and what it stands for: the table of findings. Codes are stable
CODES: Mapping[str, str] = {
    "backend-lost": "A slicer crashed, hung, ran out of memory or refused the part; the others went on.",
    "backend-unavailable": "A slicer or witness of this installation cannot run on this machine.",
    "bead-out-of-section": "Beads lay metal outside of the section: walls under a bead, closed holes.",
    "bodies-related": "Bodies overlap, or are cavities in others: how they lie, and what is built of them.",
    "body-doubled": "A body stands in the file twice, at the same place: it is built once.",
    "body-in-body": "A body lies in another of the same sense, so that it is solid metal and no cavity.",
    "check-failed": "A check of the program's text failed.",
    "consumable-change": "The wire of a spool or the life of a cathode does not last for the build: the operator has to put on a new one.",
    "curve-fell-back": "Rings are the polylines of their contours, because the mesh does not speak for their curves.",
    "curves-not-lifted": "The curves follow the contours: these do not lie on the edges of the part's mesh.",
    "declared-doubt": "Slicers agree on layers only because one of them declares its answer doubtful there.",
    "facets-turned-over": "Facets were turned over because the settings ask for it (part.fix_orientation).",
    "heat-above-solidus": "The heat model finds islands above the solidus when the beam enters them.",
    "height-off-part": "The layers end beside the top of the part by more of its height than the metal may be off, or are not those of the settings.",
    "hole-closed": "A hole is so narrow that beads close it.",
    "interpass-limit": "A layer is entered above the interpass limit, or its limit cannot be reached by waiting.",
    "interpass-wait": "The waits between layers, and what they do to the time of the build.",
    "layer-height-fitted": "No layer height was set, and the run took one with which level faces lie between layers.",
    "layer-over-bead": "The layer height is far from the height of the bead that wire and feed give.",
    "level-within-layer": "Layers, each of one section, add to the solid or leave out of it more than the metal may be off: level faces "
    "lie within a layer.",
    "limit-widened": "Limits of the gates are set wider than the default ones.",
    "lost-between-cuts": "An opening, or metal, of the part lies between two cuts and is in no layer.",
    "material-data": "Data beside the name of a known material are not those of that material.",
    "mesh-oddity": "The part's file is odd, its unit is unlikely, or what it holds beside the part was left out.",
    "metal-excess": "More metal lies at a place than the layer takes.",
    "metal-missing": "Less metal lies at a place than the layer takes.",
    "no-evidence": "A slicer's bound is so wide that its agreement proves nothing; the run does not rest on it.",
    "opening-under-bead": "A hole, slot, gap or notch is narrower than a bead, which bridges it, or than the least that is set.",
    "part-beyond-travel": "The part is larger than the travel of the machine's axes.",
    "part-off-file": "The part that is built has another size than in its file, or stands another way.",
    "part-round-in-inches": "The part's extents are round in inches and not in millimetres.",
    "part-under-beads": "The whole part is no larger than a few beads: its unit is unlikely.",
    "placeholder-codes": "Codes of beam and wire are those of the default profile, not the machine maker's.",
    "power-taper": "Power is lowered with height, and how far.",
    "process-limit": "A setting is outside of the process window; a job without a program goes on.",
    "seam-at-corner": "Contours start at corners, where metal heaps up.",
    "sections-off-mesh": "The sections that a program is judged by are not those of the mesh.",
    "steep-overhang": "A layer reaches out steeply over the one below, and no angle is set that the process can build.",
    "table-as-it-stands": "The machine has rotary axes that the program of a part that is not turned does not command.",
    "thin-set-aside": "Slicers agree once rings or holes thinner than their bounds and the tolerance are set aside: one has them, another not.",
    "wall-under-bead": "A wall is thinner than the least that beads can lay.",
    "wire-drawn-back": "Wire is drawn back at the end of each bead, and the program relies on the feeder to feed it forward again.",
}


@dataclass(frozen=True)
class Place:
    """Where something is, as far as it is known: a line of a file, a layer with its heights, a point in it.

    Layers count from 0 here; whoever reads a place counts them from 1, as the program's files do.

    >>> str(Place(layer=12, cut_mm=20.1, x_mm=3, y_mm=4.25))
    'layer 13, z = 20.100 mm, (3.000, 4.250)'
    >>> str(Place(layer=12, cut_mm=20.1, z_mm=21.0))
    'layer 13, cut at z = 20.100 mm, Z 21.000 mm'
    >>> str(Place("MAIN.MPF", 7))
    'MAIN.MPF:7'
    """

    file: str = ""
    line: int = 0  # from 1; 0 where the whole file is meant
    layer: int | None = None
    x_mm: float = math.nan
    y_mm: float = math.nan
    cut_mm: float = math.nan  # height of the layer's cut in the part
    z_mm: float = math.nan  # Z of the layer's top in the program

    @classmethod
    def of_line(cls, where: str, layer: int | None = None, x_mm: float = math.nan, y_mm: float = math.nan) -> Self:
        """Place whose line is given as ``FILE:line``."""
        file, _, line = where.rpartition(":")
        file, number = (file, int(line)) if line.isdecimal() else (where, 0)
        return cls(file, number, layer, x_mm, y_mm)

    @property
    def is_point(self) -> bool:
        """Whether X and Y are known."""
        return math.isfinite(self.x_mm) and math.isfinite(self.y_mm)

    def __str__(self) -> str:
        said = [f"{self.file}:{self.line}" if self.line else self.file] if self.file else []
        if self.layer is not None:
            said.append(f"layer {self.layer + 1}")
        if math.isfinite(self.cut_mm):
            cut = f"z = {self.cut_mm:.3f} mm"
            said.append(f"cut at {cut}, Z {self.z_mm:.3f} mm" if math.isfinite(self.z_mm) else cut)
        if self.is_point:
            said.append(f"({self.x_mm:.3f}, {self.y_mm:.3f})")
        return ", ".join(said)


@dataclass(frozen=True)
class Check:
    """One check: what was measured, against which limit, and where it is worst.

    >>> slow = Check("rapids", False, 3.0, 0.0, "moves", "MAIN.MPF:12", "3 rapids are slow", remedy="write G0")
    >>> slow.in_words()
    'rapids at MAIN.MPF:12: 3 rapids are slow; write G0'
    """

    name: str  # stable: of a finding its code, one of `CODES`
    passed: bool
    value: float  # in `unit`; NaN where nothing was measured
    limit: float  # what the value is held against; NaN where there is none
    unit: str
    where: str  # `FILE:line` of the worst or first place; empty where the whole program is meant
    text: str  # what is the case, in one sentence with its figure, without a full stop
    layer: int | None = None  # layer of the worst place, from 0, where there is one
    x_mm: float | None = None  # where the worst place is, to draw it
    y_mm: float | None = None
    # Of a check that fails: its layer as the program names it; of a finding its place, or the setting or slicer that it is about
    place: str = ""
    remedy: str = ""  # of a check that fails: what to do, without a full stop
    severity: Severity = "fault"  # how much it matters that the check fails
    stops: tuple[str, ...] = ()  # of a check of the preflight that is a fault: jobs that it ends before they begin

    def __post_init__(self) -> None:
        if self.severity not in SEVERITIES:
            raise ValueError(f"severity {self.severity!r}: known are {', '.join(SEVERITIES)}")

    @classmethod
    def finding(
        cls,
        severity: Severity,
        code: str,
        text: str,
        place: str | Place = "",
        figure: float | None = None,
        limit: float | None = None,
        unit: str = "",
        remedy: str = "",
    ) -> Self:
        """What a person has to know of a run beside its gates; raises ValueError for a code that stands in no table."""
        if code not in CODES:
            raise ValueError(f"code {code!r} stands in no table: add it to ebamcheck.result.CODES")
        numbers, passed = (_number(figure), _number(limit)), severity == "note"
        return cls(code, passed, *numbers, unit, "", text, place=str(place), remedy=remedy, severity=severity)

    @classmethod
    def fault(cls, name: str, where: str, text: str) -> Self:
        """One fault, or a check that could not be made."""
        return cls(name, False, 1.0, 0.0, "faults", where, text)

    @classmethod
    def gate(cls, name: str, passed: bool, figure: float, limit: float, unit: str, text: str) -> Self:
        """Verdict over a group of checks."""
        return cls(name, passed, figure, limit, unit, "", text)

    @classmethod
    def preflight(
        cls,
        name: str,
        level: Level,
        text: str,
        figure: float | None = None,
        limit: float | None = None,
        unit: str = "",
        remedy: str = "",
        stops: tuple[str, ...] = (),
    ) -> Self:
        """What is known of a job before anything is sliced."""
        numbers = _number(figure), _number(limit)
        severity: Severity = "note" if level == "pass" else level
        more: dict[str, Any] = {"remedy": remedy, "severity": severity, "stops": stops}
        return cls(name, level == "pass", *numbers, unit, "", text, **more)

    @property
    def level(self) -> Level:
        """``pass``, ``warning`` (to be looked at) or ``fault`` (this cannot come to a good end)."""
        return "pass" if self.passed or self.severity == "note" else self.severity

    @property
    def code(self) -> str:
        """Name of a finding."""
        return self.name

    @property
    def figure(self) -> float | None:
        """The value; None where nothing was measured."""
        return known(self.value)

    @property
    def at(self) -> Place:
        """The worst place."""
        return Place.of_line(self.where, self.layer, _number(self.x_mm), _number(self.y_mm))

    def in_words(self) -> str:
        """Name, place, what was found and what to do, as a failed check is told."""
        where = ", ".join(filter(None, (self.where, self.place)))
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"{self.name}{f' at {where}' if where else ''}: {self.text}{remedy}"


def _number(known: float | None) -> float:
    return math.nan if known is None else known


def known(number: float) -> float | None:
    """The number; None where it is NaN, which stands for one that nobody has."""
    return None if math.isnan(number) else number


def has_fault(findings: Iterable[Check]) -> bool:
    """Whether one of them keeps a program from being validated."""
    return any(finding.severity == "fault" for finding in findings)


def ordered(findings: Iterable[Check]) -> list[Check]:
    """Findings by severity, the gravest first, then by code, then by place as they came; repeats go."""
    # By what they say: NaN is not equal to itself.
    each = {repr(finding): finding for finding in findings}.values()
    return sorted(each, key=lambda f: (SEVERITIES.index(f.severity), f.code))


CHECK_KEYS = (
    "name",
    "passed",
    "value",
    "limit",
    "unit",
    "where",
    "text",
    "layer",
    "x_mm",
    "y_mm",
    "place",
    "remedy",
)


def _named(check: Check, *names: str, **other: Any) -> dict[str, Any]:
    """Values of a check by their names, in this order; some of them in another form."""
    return {name: other.get(name, getattr(check, name)) for name in names}


def check_record(check: Check) -> dict[str, Any]:
    """Check of a program; its layer is a number from 1.

    >>> steep = Check("overhang", False, 80.0, 74.0, "deg", "MAIN_L0003.SPF:9", "too far", layer=2)
    >>> check_record(steep)["layer"], check_of_record(check_record(steep)) == steep
    (3, True)
    """
    return _named(check, *CHECK_KEYS, layer=None if check.layer is None else check.layer + 1)


def check_of_record(record: Mapping[str, Any]) -> Check:
    """Take back :func:`check_record`."""
    layer = record.get("layer")
    return Check(**{**_numbers(record), "layer": None if layer is None else layer - 1})


def gate_record(gate: Check) -> dict[str, Any]:
    """Gate."""
    return _named(gate, "name", "passed", "figure", "limit", "unit", "text", figure=gate.value)


def finding_records(findings: Iterable[Check]) -> list[dict[str, Any]]:
    """Findings in order."""
    names = ("severity", "code", "text", "place", "figure", "limit", "unit", "remedy")
    return [_named(finding, *names, limit=known(finding.limit)) for finding in ordered(findings)]


def preflight_record(check: Check) -> dict[str, Any]:
    """Check of the preflight, as ``ebamcheck preflight --json`` tells it."""
    names = ("name", "level", "text", "figure", "limit", "unit", "remedy", "stops")
    return _named(check, *names, limit=known(check.limit))


def finding_of_record(record: Mapping[str, Any]) -> Check:
    """Take a finding back.

    >>> told = Check.finding("warning", "metal-excess", "too much", figure=float("inf"), unit="mm")
    >>> finding_of_record({**finding_records([told])[0], "figure": "Infinity"}) == told
    True
    """
    return Check.finding(**_numbers(record))


def gate_of_record(record: Mapping[str, Any]) -> Check:
    """Take back :func:`gate_record`."""
    return Check.gate(**_numbers(record))


def _numbers(record: Mapping[str, Any]) -> dict[str, Any]:
    """The record with its figures; those that are no finite number are text in JSON."""
    names = ("value", "figure", "limit", "x_mm", "y_mm")
    return {name: float(value) if name in names and isinstance(value, str) else value for name, value in record.items()}


def in_words(record: Mapping[str, Any]) -> str:
    """Say a finding of ``run.json`` in one line: what, where, and what to do.

    >>> in_words(finding_records([Check.finding("note", "metal-excess", "too much", "layer 1", remedy="mill it")])[0])
    'too much (layer 1): mill it'
    """
    place = f" ({record['place']})" if record["place"] else ""
    return f"{record['text']}{place}" + (f": {record['remedy']}" if record["remedy"] else "")
