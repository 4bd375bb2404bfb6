"""Every gate of a finished run, worked out again from part, settings and the program's text.

Nothing that the run recorded is believed: the part is inspected and sliced anew, by another exact slicer than the one
whose contours became the program; curves are fitted anew; and the text is laid, heated and measured against these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ebamcheck.checks.interpass_checks import AGAIN, COLD
from ebamcheck.checks.matching import matched
from ebamcheck.checks.metal import FIELD_FILE, deposit
from ebamcheck.checks.narrow_features import NarrowFeature
from ebamcheck.checks.rules import RULES, of_gate
from ebamcheck.checks.text_checks import Truth
from ebamcheck.comparison import Comparison
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.curves import Curves
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.json_values import plain, sha256_of_json
from ebamcheck.layers.files import LayerFile
from ebamcheck.layers.heights import cut_heights
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.inspection import inspect
from ebamcheck.mesh.part import Part
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.pipeline import gates
from ebamcheck.pipeline.cross_check import compared_layers, witness_backend
from ebamcheck.pipeline.entry_program import NAME as HANDSHAKE
from ebamcheck.pipeline.entry_program import checked_again, live_checked_again
from ebamcheck.pipeline.findings import metal_findings, narrow_findings, part_findings, profile_findings
from ebamcheck.pipeline.fit import FitVerdict, fitted
from ebamcheck.pipeline.stages import judged_program, smooth_sections
from ebamcheck.pipeline.tables import (
    Table,
    sums_of,
    tables_of_comparison,
    tables_of_metal,
    tables_of_plan,
    tables_of_program,
)
from ebamcheck.plugins import registry
from ebamcheck.program import verify_program
from ebamcheck.program.verification import read_checked
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.result import Check, finding_of_record, has_fault
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Outcome, declared_bounds
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.verification.tables_again import order_of, tables_check
from ebamcheck.version import __version__
from ebamcheck.writing.bead_ends import planned_path

# Figures that differ by less, relative to the greater or to 1, are the same: sums in another order.
SAME_FIGURE = 1e-6
# Points cut by one slicer twice, on another processor: far under what two slicers may differ by.
SAME_POINT_MM = 1e-6
COVERAGE = "coverage"  # The gate that the text can shut where the plan alone leaves it open
PROGRAM = "program"  # The gate whose figure counts checks, of which more are made here than in a run
# Checks that are made here and not by a run, which has its plan to compare with, or not by a run of an earlier version.
OF_TEXT_ALONE = {
    *("readable", "entry", HANDSHAKE),
    *(name for rule in RULES if {"beads", "part"} & {*rule.needs} for name in rule.checks),
    # Not by runs of an earlier version.
    *(AGAIN, COLD),
}


@dataclass(frozen=True)
class Again:
    """What a run came to when it was worked out again."""

    witness: str  # Slicer that cut the part anew
    gates: tuple[Check, ...]
    agrees: bool  # The slicers agree, the one that cut anew among them
    findings: tuple[Check, ...]  # Findings of part and settings, which follow from these alone
    checks: tuple[Check, ...] = ()  # Checks of the program; none for a run without one
    # Recorded layers that are not those of the slicer whose name their file has.
    exchanged: tuple[str, ...] = ()
    tables: Check | None = None  # Whether the tables of the run are those that follow; None where no run says
    # What the record says beside gates and checks in figures, by the place where it says so.
    figures: Mapping[str, Any] = field(default_factory=dict)


def work_again(run: RunFolder, manifest: Mapping[str, Any], config: Config, part: Part) -> Again:
    """Work every gate of a run out again; of its record only names of files and backends are used."""
    heights = cut_heights(part, config)
    witness = witness_backend(str(manifest["primary"]))
    fresh = slice_part(part, heights, witness)
    sound = inspect(part)
    agreement, comparison = _agreement(run, manifest, config, part, fresh, witness)
    agrees = comparison.passed
    tables, why_not = _tables(manifest, comparison)
    exchanged = exchanged_layers(run, manifest, fresh, witness)
    off = gates.volume_off(part, np.asarray(heights), fresh.areas(), config) if sound.passed else ""
    made = [gates.input_gate(sound, off), agreement]
    told = [*part_findings(sound, config)]
    record = manifest.get("program")
    if record is None:
        of_run = tables_check(run, manifest, tables, why_not)
        return Again(witness, tuple(made), agrees, tuple(told), exchanged=exchanged, tables=of_run)
    verdict, tables["fit.csv"] = _fitted(run, manifest, config, part)
    tables["curves.parquet"] = verdict.curves
    smooth = smooth_sections(verdict.curves, config)
    checks, plan, of_text, narrow = text_again(run, manifest, config, part, fresh, smooth)
    z_of = deposition_heights(np.asarray(heights), config.layer_height_mm, config.base_mm)
    main = run.program_folder / record["files"][0]["name"]
    judging = judged_program(verdict, checks, plan.metrics, config)
    made += [_coverage(checks, gate) if gate.name == COVERAGE else gate for gate in judging]
    entry = checked_again(run.path, record, main, z_of, config)
    made += [gates.entry_gate(check) for check in entry]
    checks += entry
    checks += live_checked_again(run.path, record, config, float(part.size[2]))
    told += [*profile_findings(config), *metal_findings(of_gate(checks, "deposit"))]
    told += narrow_findings(narrow, fresh.heights, config)
    tables |= of_text
    if record["witness"] != witness:
        other = f"the run used sections by {record['witness']}, these are by {witness}"
        why_not |= {"deposit.csv": other, FIELD_FILE: other}
    of_run = tables_check(run, manifest, tables, why_not)
    figures = {
        "part.inspection": sound.as_dict(),
        "heat": {"limit_k": entry_limit_k(config)},
        **sums_of(tables),
    }
    return Again(witness, tuple(made), agrees, tuple(told), tuple(checks), exchanged, of_run, figures)


def _tables(manifest: Mapping[str, Any], comparison: Comparison) -> tuple[dict[str, Table], dict[str, str]]:
    """Tables of the comparison, if the slicers are those of the run; else why not, by file."""
    done = {name for name, found in manifest["backends"].items() if found["status"] == "done"}
    found: dict[str, Table] = {**tables_of_comparison(comparison)}
    if done == set(comparison.stacks):
        return found, {}
    return {}, dict.fromkeys(found, "not all slicers of the run are the ones that are here")


def exchanged_layers(
    run: RunFolder, manifest: Mapping[str, Any], fresh: Layers, witness: str
) -> tuple[str, ...]:
    """Slicers whose recorded layers name another, and the witness where its layers are not those that it cuts now.

    On plane parts exact slicers agree to the last digits, so that distances show no exchange: what the file says of itself, and
    every coordinate, do.
    """
    found = []
    for name, outcome in manifest["backends"].items():
        if outcome["status"] != "done":
            continue
        recorded = run.read_layers(name)
        same = recorded.backend == name
        if same and name == witness:
            same = recorded.points.shape == fresh.points.shape and np.array_equal(
                recorded.ring_starts, fresh.ring_starts
            )
            same = same and bool((np.abs(recorded.points - fresh.points) <= SAME_POINT_MM).all())
        if not same:
            found.append(name)
    return tuple(found)


def _agreement(
    run: RunFolder, manifest: Mapping[str, Any], config: Config, part: Part, fresh: Layers, witness: str
) -> tuple[Check, Comparison]:
    """Compare the recorded layers of every slicer with layers cut anew; bounds are what the slicers declare now."""
    outcomes: dict[str, Outcome] = {}
    with ExitStack() as opened:
        stacks: dict[str, LayerSource] = {}
        order = order_of(run)
        backends, place = manifest["backends"], {name: k for k, name in enumerate(order)}
        for name in sorted(backends, key=lambda name: place.get(name, -1)):
            found = backends[name]
            if found["status"] != "done":
                outcomes[name] = Outcome(name, found["status"], found["why"])
            elif name == witness or name in registry.slicers():
                file = run.layers_file(name)
                outcomes[name] = Outcome(name, file=file)
                recorded = None if name == witness else LayerFile(file, edges=False)
                stacks[name] = fresh if recorded is None else opened.enter_context(recorded)
        outcomes.setdefault(witness, Outcome(witness, file=run.layers_file(witness)))
        stacks.setdefault(witness, fresh)
        settings = {n: registry.slicer_settings(n, config.slicing.settings.get(n, {})) for n in stacks}
        comparison = compared_layers(stacks, part, declared_bounds(part, settings), config)
    gate = gates.agreement_gate(comparison, outcomes, len(fresh), config.layer_height_mm, config.base_mm)
    return gate, comparison


def _fitted(
    run: RunFolder, manifest: Mapping[str, Any], config: Config, part: Part
) -> tuple[FitVerdict, pd.DataFrame]:
    """Fit the contours of the primary slicer anew, as the run did, and judge the fit."""
    primary = str(manifest["primary"])
    settings = registry.slicer_settings(primary, config.slicing.settings.get(primary, {}))
    bound_mm, _ = declared_bounds(part, {primary: settings})[primary]
    layers = run.read_layers(primary)
    return fitted(layers, part, config, bound_mm)


def _coverage(checks: Sequence[Check], planned: Check) -> Check:
    """Coverage by the plan, and shut, too, where the text leaves something bare or cannot be read."""
    found = next((check for check in checks if check.name == "coverage"), None)
    if found is None:
        return replace(planned, passed=False, text="the program cannot be read")
    return planned if found.passed else replace(planned, passed=False, text=f"by the text: {found.text}")


# -- against the record ------------------------------------------------------------------------------


def compared(again: Again, manifest: Mapping[str, Any]) -> list[Check]:
    """Checks of the gates as they were found again, and of what the record says of them."""
    recorded = {g["name"]: g for g in manifest["gates"]}
    checks = [_gate_check(gate, recorded.get(gate.name)) for gate in again.gates]
    unknown = sorted(set(recorded) - {gate.name for gate in again.gates})
    why = "the record has a gate that this version does not know"
    checks += [Check.fault(f"gate {name}", "run.json", why) for name in unknown]
    record = manifest.get("program")
    if record is not None:
        checks += [_figures(again, record), _verdict(again, manifest)]
    return [*checks, _record(again, manifest)]


def _record(again: Again, manifest: Mapping[str, Any]) -> Check:
    """What else the record says that follows from part, settings and text."""
    part, faults = manifest["part"], []
    if part["name"] != Path(part["source"]).stem:
        faults.append(f"the part is called {part['name']!r}, its file {part['source']!r}")
    if bool(manifest["comparison"]["passed"]) != again.agrees:
        faults.append("comparison.passed of the record differs from what was found")
    record = manifest.get("program")
    if record is not None and record["witness"] == manifest["primary"] != again.witness:
        faults.append(f"{record['witness']} is named as its own witness")
    faults += [f"layers/{name}.parquet does not hold the layers of {name}" for name in again.exchanged]
    faults += _other_figures(again.figures, manifest)
    codes = {finding["code"] for finding in manifest["findings"]}
    lacking = sorted({finding.code for finding in again.findings} - codes)
    faults += [f"the finding {code} is left out" for code in lacking]
    text = "; ".join(faults[:3]) or "name, comparison, witness, figures and findings are those that follow"
    return Check("record", not faults, float(len(faults)), 0.0, "faults", "run.json", text)


def _other_figures(found: Mapping[str, Any], manifest: Mapping[str, Any]) -> list[str]:
    """Figures of the record that are not those which were found; a run of an earlier version may have counted in another way."""
    if manifest["ebamcheck"] != __version__:
        return []
    faults = []
    for place, figures in found.items():
        recorded: Any = manifest
        for step in place.split("."):
            recorded = (recorded or {}).get(step)
        faults += [f"{place}.{at} is not what was found" for at in _differing(recorded, plain(figures))]
    return faults


def _differing(recorded: Any, found: Any, at: str = "") -> list[str]:
    """Where a record says another figure than the one found, of the keys that it has."""
    if isinstance(recorded, Mapping) and isinstance(found, Mapping):
        both = [key for key in recorded if key in found]
        pairs = [(recorded[key], found[key], f"{at}.{key}".strip(".")) for key in both]
        return [one for pair in pairs for one in _differing(*pair)]
    if isinstance(recorded, list) and isinstance(found, list) and len(recorded) == len(found):
        return [one for a, b in zip(recorded, found, strict=True) for one in _differing(a, b, at)][:1]
    numbers = isinstance(recorded, int | float) and isinstance(found, int | float)
    return [] if (_same(recorded, found) if numbers else recorded == found) else [at]


def _gate_check(gate: Check, recorded: Mapping[str, Any] | None) -> Check:
    """A gate as it was found again; shut, too, where the record tells another verdict."""
    told = ""
    if recorded is None:
        told = f"the record lacks this gate; found: {gate.text}"
    elif bool(recorded["passed"]) != gate.passed:
        said = "passed" if recorded["passed"] else "shut"
        told = f"recorded as {said}, found {'open' if gate.passed else 'shut'}: {gate.text}"
    elif gate.name != PROGRAM and not _same_figures(recorded, "figure", gate):
        said = f"{recorded['figure']} of {recorded['limit']}"
        told = f"recorded as {said}, found {gate.value:g} of {gate.limit:g}: {gate.text}"
    gate = replace(gate, name=f"gate {gate.name}")
    return replace(gate, passed=False, where="run.json", text=told) if told else gate


def _figures(again: Again, record: Mapping[str, Any]) -> Check:
    """Figures of the program's checks against those of the record, where both had the same sections."""
    found = {check.name: check for check in again.checks}
    if record["witness"] != again.witness:
        text = f"the run used sections by {record['witness']}, these are by {again.witness}: not compared"
        return Check("recorded figures", True, 0.0, 0.0, "faults", "", text)
    differ = []
    for c in record["checks"]:
        check, value = found.get(c["name"]), c["value"]
        if check is None or bool(c["passed"]) != check.passed or not _same_figures(c, "value", check):
            known = check is not None and isinstance(value, float)
            said = (
                f"recorded {value:g}, found {check.value:g}"
                if known and check
                else f"recorded as {value}, not found"
            )
            differ.append(f"{c['name']}: {said}")
    recorded = {c["name"] for c in record["checks"]}
    differ += [f"{name}: not in the record" for name in found if name not in recorded | OF_TEXT_ALONE]
    text = "; ".join(differ[:3]) or f"{len(record['checks'])} figures of checks are those of the record"
    return Check("recorded figures", not differ, float(len(differ)), 0.0, "faults", "run.json", text)


def _same_figures(recorded: Mapping[str, Any], figure: str, found: Check) -> bool:
    """Whether figure and limit of a record are those of a check."""
    return _same(recorded[figure], plain(found.value)) and _same(recorded["limit"], plain(found.limit))


def _same(recorded: Any, found: Any) -> bool:
    if isinstance(recorded, str) or isinstance(found, str):  # infinities and NaN
        return bool(recorded == found)
    return bool(np.isclose(recorded, found, rtol=SAME_FIGURE, atol=SAME_FIGURE))


def _verdict(again: Again, manifest: Mapping[str, Any]) -> Check:
    """Whether the program is called validated exactly where every gate is open and no finding is a fault."""
    said = bool(manifest["program"]["validated"])
    faulty = has_fault(finding_of_record(f) for f in manifest["findings"])
    found = all(gate.passed for gate in again.gates) and not faulty
    words = {True: "validated", False: "not validated"}
    text = f"recorded as {words[said]}, found {words[found]}"
    return Check("verdict", said == found, float(said != found), 0.0, "faults", "run.json", text)


class TextAgain(NamedTuple):
    """What the text of a run's program came to."""

    checks: list[Check]
    plan: ScanPlan
    tables: dict[str, Table]  # Tables of plan and text; of the plan alone where the text cannot be read
    narrow: tuple[NarrowFeature, ...] = ()  # Features of the part that are narrower than beads can build


def text_again(
    run: RunFolder, manifest: Mapping[str, Any], config: Config, part: Part, fresh: Layers, smooth: Layers | None,
) -> TextAgain:  # fmt: skip
    """Read, lay and check the text of a run's program over sections of the part that were cut anew.

    `smooth` are the fitted contours with their curves, fitted anew; None where the method of the fit makes none.
    """
    record = manifest["program"]
    plan = ScanPlan.from_parquet(run.path / "scan.parquet")
    beads = Curves.from_parquet(run.path / "beads.parquet")
    path = planned_path(beads, plan, config)
    tables: dict[str, Table] = {**tables_of_plan(path, plan, config)}
    nc, readable = read_checked(run.program_folder / record["files"][0]["name"], config)
    if nc is None:
        return TextAgain([readable], plan, tables)
    nc, match = matched(nc, path)
    z_of = deposition_heights(fresh.heights, config.layer_height_mm, config.base_mm)
    laid = deposit(nc, fresh, z_of, config, asked=True)
    hashes = {file["name"]: file["sha256"] for file in record["files"]}
    checks = verify_program(
        nc, config=config, curves=beads, plan=plan, match=match, part=part, layers=fresh, smooth=smooth, beads=True, metal=True,
        laid=lambda: laid, heat=True, heights=fresh.heights, sha256=hashes, truth=truth_of(manifest),
    )  # fmt: skip
    tables |= tables_of_program(nc, run.read_layers(str(manifest["primary"])), config)
    tables |= tables_of_metal(laid, z_of, config.base_mm)
    return TextAgain([readable, *checks], plan, tables, laid.narrow)


def truth_of(manifest: Mapping[str, Any]) -> Truth:
    """What a run's record tells of its program, against which the program's header is held.

    The settings are those that were recorded: a version that has more of them still reads the program of one that had fewer.
    """
    validated = bool(manifest["program"]["validated"])
    return Truth(validated, manifest["part"]["sha256"], sha256_of_json(manifest["settings"]))
