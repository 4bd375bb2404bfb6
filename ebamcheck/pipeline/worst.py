"""The worst that a run has found, in one line: what a user is to read first."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ebamcheck.findings import at_layer, in_words


def worst_line(manifest: Mapping[str, Any]) -> str:
    """The worst finding of a run that failed, with cause, size and place; empty for one that passed.

    A part that is none goes first, then slicers that disagree, then faults, then the first gate that is shut.
    """
    if not manifest["exit_code"]:
        return ""
    shut = {gate["name"]: gate for gate in manifest["gates"] if not gate["passed"]}
    disagreements = manifest["comparison"]["findings"]
    faults = [f for f in manifest.get("findings", []) if f["severity"] == "fault"]
    if "input" in shut:
        said = shut["input"]["text"]
    elif "agreement" in shut and disagreements:
        said = _disagreement(max(disagreements, key=lambda f: (_excess(f), -f["layer"])))
    elif faults and "agreement" not in shut:
        said = in_words(faults[0])
    elif shut:
        gate = next(iter(shut.values()))
        said = f"{gate['name']}: {gate['text']}"
    else:
        return ""
    return f"WORST: {said}"


def _excess(finding: Mapping[str, Any]) -> float:
    value, limit = float(finding["value"]), float(finding["limit"])
    return value / limit if limit > 0.0 else math.inf


def _disagreement(f: Mapping[str, Any]) -> str:
    """A disagreement of ``run.json`` in words."""
    cause = f.get("cause_text") or f["cause"]
    place = at_layer(f["layer"] - 1, f["height_mm"], program_z_mm=float(f.get("program_z_mm", math.nan)))
    size = f"{float(f['value']):.4g} over {float(f['limit']):.4g}"
    where = f"({float(f['x_mm']):.3f}, {float(f['y_mm']):.3f}) of {place}"
    remedy = f"; {f['remedy']}" if f.get("remedy") else ""
    return f"{f['backend']} against {f['against']}: {cause}; {f['metric']} {size} at {where}{remedy}"
