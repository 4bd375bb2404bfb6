"""What a run may say of itself: what its gates proved, and what is left to a person. Every rendering says it in these words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ebamcheck.findings import SEVERITIES

PROVED: Mapping[str, str] = {
    "input": "the part is a closed solid",
    "agreement": "independent slicers find the same contours on every layer",
    "fit": "the curves stay near the contours",
    "coverage": "the beads leave nothing of the sections bare",
    "deposit": "the metal laid is that of the sections within its tolerances, by a model of the melt pool",
    "heat": "no bead is entered above the limit, by the heat model",
    "program": "the program's path, read back from its text, is that of the part, within the limits of machine and process",
    "entry": "the program that begins at a layer is the end of the whole one, and starts safely by itself",
}
"""What each gate proves where it has passed, and what is not proved where it is shut; of another one its own text says it."""

DRY_RUN = "a dry run on the control, with beam and wire off"
CODES_OF_THE_MAKER = "the machine maker's codes in place of the default ones for beam and wire"
APPROVAL = "approval: name, date and signature on the certificate"


@dataclass(frozen=True)
class Statement:
    """What shut gates leave unproved, what is proved, and what is left to a person, in short clauses."""

    unproved: tuple[str, ...]
    proved: tuple[str, ...]
    left: tuple[str, ...]

    def lines(self) -> list[str]:
        """All in words, a line each."""
        return [f"{head}: {'; '.join(said)}" for head, said in self.parts() if said]

    def parts(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """All with their heads, what matters most first."""
        return ("Not proved", self.unproved), ("Proved", self.proved), ("Left to you", self.left)


def statement(manifest: Mapping[str, Any]) -> Statement:
    """Statement of a run from its record; one of an earlier version has no findings.

    What comes after a validated program (codes, dry run, approval) is said of no other one.
    """
    gates, found = manifest["gates"], manifest.get("findings", [])
    unproved, proved = (
        tuple(PROVED.get(gate["name"], gate["text"]) for gate in gates if gate["passed"] is passed)
        for passed in (False, True)
    )
    shut = [str(gate["name"]) for gate in gates if not gate["passed"]]
    left = [f"to open the gate{'s' if len(shut) > 1 else ''} {', '.join(shut)}"] if shut else []
    left += [_looked_at(found)] if found else []
    if manifest.get("program") and manifest["exit_code"] == 0:
        codes = any(finding["code"] == "placeholder-codes" for finding in found)
        left += [*([CODES_OF_THE_MAKER] if codes else []), _consumables(manifest), DRY_RUN, APPROVAL]
    return Statement(unproved, proved, tuple(text for text in left if text))


def _consumables(manifest: Mapping[str, Any]) -> str:
    """What the build uses up, of which the profile does not say how much there is: no check knows whether it lasts."""
    machine, totals = manifest["settings"]["machine"], manifest["program"]["totals"]
    said = {
        "spool_kg": f"{totals['wire_kg']:.3g} kg of wire on the spool",
        "cathode_h": f"a cathode for {totals['deposit_s'] / 3600.0:.3g} h of beam",
    }
    return " and ".join(text for name, text in said.items() if machine.get(name) is None)


def counted(findings: list[Mapping[str, Any]]) -> str:
    """Count findings by severity, the gravest first.

    Examples
    --------
    >>> counted([{"severity": "note"}, {"severity": "warning"}, {"severity": "note"}])
    '1 warning, 2 notes'
    """
    counts = {s: sum(finding["severity"] == s for finding in findings) for s in SEVERITIES}
    return ", ".join(f"{n} {name}{'' if n == 1 else 's'}" for name, n in counts.items() if n)


def _looked_at(findings: list[Mapping[str, Any]]) -> str:
    grave = [finding for finding in findings if finding["severity"] != "note"]
    return f"a look at {counted(grave)}" if grave else ""
