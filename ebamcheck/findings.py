"""Findings: what a person has to know of a run beside its gates, as data from which every rendering is made.

A stage that notices something makes a :class:`Finding` and hands it to the job; ``run.json`` holds all of them under
`findings`, and terminal, report, JUnit and certificate show that list. What went wrong between two slicers is another
thing: :mod:`ebamcheck.comparison.findings`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

Severity = Literal["note", "warning", "fault"]
"""How much it matters: worth knowing; to be looked at before the program is used; nothing with it is validated."""

SEVERITIES: tuple[Severity, ...] = get_args(Severity)[::-1]
"""The gravest first, as they are listed."""

CODES: Mapping[str, str] = {
    "backend-lost": "A slicer crashed, hung, ran out of memory or refused the part; the others went on.",
    "backend-unavailable": "A slicer or witness of this installation cannot run on this machine.",
    "bead-out-of-section": "Beads lay metal outside of the section: walls under a bead, closed holes.",
    "bodies-related": "Bodies overlap, or are cavities in others: how they lie, and what is built of them.",
    "body-doubled": "A body stands in the file twice, at the same place: it is built once.",
    "body-in-body": "A body lies in another of the same sense, so that it is solid metal and no cavity.",
    "check-failed": "A check of the program's text failed.",
    "consumable-change": "The wire of a spool or the life of a cathode does not last for the build: the operator has to put on a new one.",
    "curve-fell-back": "Rings were fitted by a more cautious method, because the mesh does not speak for the one asked for.",
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
"""Every code that a finding may have, and what it stands for: the table of findings. Codes are stable."""


@dataclass(frozen=True)
class Finding:
    """One finding.

    Raises
    ------
    ValueError
        If the severity or the code is unknown: a code that stands in no table means nothing to its reader.
    """

    severity: Severity
    code: str
    """One of :data:`CODES`."""
    text: str
    """What is the case, in one sentence with its figure, without a full stop."""
    place: str = ""
    """Where: ``layer 12, z = 20.100 mm, (3.000, 4.000)``, a setting by its name, or ``FILE:line``; empty: all of it."""
    figure: float | None = None
    """What was measured, in `unit`; None where nothing was."""
    limit: float | None = None
    """What it is held against, in `unit`."""
    unit: str = ""
    remedy: str = ""
    """What to do about it, without a full stop."""

    def __post_init__(self) -> None:
        if self.severity not in SEVERITIES:
            raise ValueError(f"severity {self.severity!r}: known are {', '.join(SEVERITIES)}")
        if self.code not in CODES or not re.fullmatch(r"[a-z]+(-[a-z]+)+", self.code):
            raise ValueError(f"code {self.code!r} stands in no table: add it to ebamcheck.findings.CODES")


def ordered(findings: Iterable[Finding]) -> list[Finding]:
    """Findings by severity, the gravest first, then by code, then by place as they came; repeats go."""
    return sorted(dict.fromkeys(findings), key=lambda f: (SEVERITIES.index(f.severity), f.code))


def records(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """Findings in order as ``run.json`` holds them."""
    return [asdict(finding) for finding in ordered(findings)]


def from_record(record: Mapping[str, Any]) -> Finding:
    """Finding of a record of ``run.json``, where figures that are no finite number are text.

    Examples
    --------
    >>> told = Finding("warning", "metal-excess", "too much", figure=float("inf"), unit="mm")
    >>> from_record({**records([told])[0], "figure": "Infinity"}) == told
    True
    """
    numbers = {
        name: None if record[name] is None else float(record[name])
        for name in ("figure", "limit")
        if name in record
    }
    return Finding(**{**record, **numbers})


def has_fault(findings: Iterable[Finding]) -> bool:
    """Whether one of them keeps a program from being validated."""
    return any(finding.severity == "fault" for finding in findings)


def at_layer(
    layer: int,
    height_mm: float,
    x_mm: float = math.nan,
    y_mm: float = math.nan,
    program_z_mm: float = math.nan,
) -> str:
    """Name a place, or a whole layer where X and Y are not known, by the index of the layer; with its Z in the program, too.

    Layers are named by numbers from 1, as the program's files are.

    Examples
    --------
    >>> at_layer(12, 20.1, 3, 4.25)
    'layer 13, z = 20.100 mm, (3.000, 4.250)'
    >>> at_layer(12, 20.1)
    'layer 13, z = 20.100 mm'
    >>> at_layer(12, 20.1, program_z_mm=21.0)
    'layer 13, cut at z = 20.100 mm, Z 21.000 mm'
    """
    heights = f"z = {height_mm:.3f} mm"
    if math.isfinite(program_z_mm):
        heights = f"cut at {heights}, Z {program_z_mm:.3f} mm"
    where = f", ({x_mm:.3f}, {y_mm:.3f})" if math.isfinite(x_mm) and math.isfinite(y_mm) else ""
    return f"layer {layer + 1}, {heights}{where}"


def in_words(record: Mapping[str, Any]) -> str:
    """Say a finding of ``run.json`` in one line: what, where, and what to do.

    Examples
    --------
    >>> in_words(records([Finding("note", "metal-excess", "too much", "layer 1", remedy="mill it")])[0])
    'too much (layer 1): mill it'
    """
    place = f" ({record['place']})" if record["place"] else ""
    return f"{record['text']}{place}" + (f": {record['remedy']}" if record["remedy"] else "")
