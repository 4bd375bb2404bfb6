"""Every gate of a finished run, worked out again from part, settings and the program's text; nothing that the run recorded is
believed.

The part is sliced anew, by another exact slicer than the one whose contours became the program, and the text is laid over these
sections."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

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
from ebamcheck.pipeline import tables as follow
from ebamcheck.pipeline.cross_check import compared_layers, witness_backend
from ebamcheck.pipeline.entry_program import NAME as HANDSHAKE
from ebamcheck.pipeline.entry_program import checked_again, live_checked_again
from ebamcheck.pipeline.findings import metal_findings, narrow_findings, part_findings, profile_findings
from ebamcheck.pipeline.fit import fitted
from ebamcheck.pipeline.stages import judged_program, smooth_sections
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
# Checks that are made here and not by a run, which has its plan to compare with, or not by a run of an earlier version.
OF_TEXT_ALONE = {"readable", "entry", HANDSHAKE, AGAIN, COLD}
OF_TEXT_ALONE |= {name for rule in RULES if {"beads", "part"} & {*rule.needs} for name in rule.checks}


@dataclass(frozen=True)
class Again:
    """Gates, checks and findings of a run that was worked out again."""

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
    tables: dict[str, follow.Table] = {**follow.tables_of_comparison(comparison)}
    why_not: dict[str, str] = {}
    if {name for name, found in manifest["backends"].items() if found["status"] == "done"} != set(comparison.stacks):
        why_not = dict.fromkeys(tables, "not all slicers of the run are the ones that are here")
        tables = {}
    exchanged = exchanged_layers(run, manifest, fresh, witness)
    off = gates.volume_off(part, np.asarray(heights), fresh.areas(), config) if sound.passed else ""
    made = [gates.input_gate(sound, off), agreement]
    told = [*part_findings(sound, config)]
    record = manifest.get("program")
    if record is None:
        of_run = tables_check(run, manifest, tables, why_not)
        return Again(witness, tuple(made), agrees, tuple(told), exchanged=exchanged, tables=of_run)
    primary = str(manifest["primary"])
    settings = {primary: registry.slicer_settings(primary, config.slicing.settings.get(primary, {}))}
    bound_mm, _ = declared_bounds(part, settings)[primary]
    verdict, tables["fit.csv"] = fitted(run.read_layers(primary), part, config, bound_mm)
    tables["curves.parquet"] = verdict.curves
    smooth = smooth_sections(verdict.curves, config)
    checks, plan, of_text, narrow = text_again(run, manifest, config, part, fresh, smooth)
    z_of = deposition_heights(np.asarray(heights), config.layer_height_mm, config.base_mm)
    main = run.program_folder / record["files"][0]["name"]
    judging = judged_program(verdict, checks, plan.metrics, config)
    # The text can shut the gate of coverage where the plan alone leaves it open.
    bare = next((check for check in checks if check.name == "coverage"), None)
    for gate in judging:
        if gate.name == "coverage" and (bare is None or not bare.passed):
            said = f"by the text: {bare.text}" if bare else "the program cannot be read"
            gate = replace(gate, passed=False, text=said)
        made.append(gate)
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
        **follow.sums_of(tables),
    }
    return Again(witness, tuple(made), agrees, tuple(told), tuple(checks), exchanged, of_run, figures)


def exchanged_layers(run: RunFolder, manifest: Mapping[str, Any], fresh: Layers, witness: str) -> tuple[str, ...]:
    """Slicers whose recorded layers name another, and the witness where its layers are not those that it cuts now.

    On plane parts exact slicers agree to the last digits, so that distances show no exchange.
    """
    found = []
    for name, outcome in manifest["backends"].items():
        if outcome["status"] == "done":
            recorded = run.read_layers(name)  # one slicer's at a time: those of a large part fill the memory
            if recorded.backend != name or (name == witness and not _same_layers(recorded, fresh)):
                found.append(name)
    return tuple(found)


def _same_layers(recorded: Layers, fresh: Layers) -> bool:
    """Whether two stacks have the same rings, to what another processor may round by: far under what slicers may differ by."""
    if recorded.points.shape != fresh.points.shape:
        return False
    same = np.array_equal(recorded.ring_starts, fresh.ring_starts)
    return bool(same and (np.abs(recorded.points - fresh.points) <= 1e-6).all())


def _agreement(
    run: RunFolder, manifest: Mapping[str, Any], config: Config, part: Part, fresh: Layers, witness: str
) -> tuple[Check, Comparison]:
    """Compare the recorded layers of every slicer with layers cut anew; bounds are what the slicers declare now."""
    outcomes: dict[str, Outcome] = {}
    with ExitStack() as opened:
        stacks: dict[str, LayerSource] = {}
        backends, place = manifest["backends"], {name: k for k, name in enumerate(order_of(run))}
        for name in sorted(backends, key=lambda name: place.get(name, -1)):
            found = backends[name]
            if found["status"] != "done":
                outcomes[name] = Outcome(name, found["status"], found["why"])
            elif name == witness or name in registry.slicers():
                outcomes[name] = Outcome(name, file=(file := run.layers_file(name)))
                recorded = LayerFile(file, edges=False) if name != witness else None
                stacks[name] = opened.enter_context(recorded) if recorded else fresh
        outcomes.setdefault(witness, Outcome(witness, file=run.layers_file(witness)))
        stacks.setdefault(witness, fresh)
        settings = {n: registry.slicer_settings(n, config.slicing.settings.get(n, {})) for n in stacks}
        comparison = compared_layers(stacks, part, declared_bounds(part, settings), config)
    gate = gates.agreement_gate(comparison, outcomes, len(fresh), config.layer_height_mm, config.base_mm)
    return gate, comparison


def compared(again: Again, manifest: Mapping[str, Any]) -> list[Check]:
    """Checks of the gates as they were found again, and of what the record says of them."""
    recorded = {g["name"]: g for g in manifest["gates"]}
    checks = [_gate_check(gate, recorded.get(gate.name)) for gate in again.gates]
    unknown = sorted(set(recorded) - {gate.name for gate in again.gates})
    why = "the record has a gate that this version does not know"
    checks += [Check.fault(f"gate {name}", "run.json", why) for name in unknown]
    if (record := manifest.get("program")) is not None:
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
    """Keys of a record whose figure differs from the one found."""
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
    elif gate.name != "program" and not _same_figures(recorded, "figure", gate):
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
            said = f"recorded as {value}, not found"
            if check is not None and isinstance(value, float):
                said = f"recorded {value:g}, found {check.value:g}"
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


def text_again(
    run: RunFolder, manifest: Mapping[str, Any], config: Config, part: Part, fresh: Layers, smooth: Layers | None,
) -> tuple[list[Check], ScanPlan, dict[str, follow.Table], tuple[NarrowFeature, ...]]:  # fmt: skip
    """Read, lay and check the text of a run's program over sections, and `smooth` contours, of the part that were made anew.

    Returns checks, plan, tables of plan and text as far as it can be read, and features that are narrower than beads can build.
    """
    record = manifest["program"]
    plan = ScanPlan.from_parquet(run.path / "scan.parquet")
    beads = Curves.from_parquet(run.path / "beads.parquet")
    path = planned_path(beads, plan, config)
    tables: dict[str, follow.Table] = {**follow.tables_of_plan(path, plan, config)}
    nc, readable = read_checked(run.program_folder / record["files"][0]["name"], config)
    if nc is None:
        return [readable], plan, tables, ()
    nc, match = matched(nc, path)
    z_of = deposition_heights(fresh.heights, config.layer_height_mm, config.base_mm)
    laid = deposit(nc, fresh, z_of, config, asked=True)
    hashes = {file["name"]: file["sha256"] for file in record["files"]}
    checks = verify_program(
        nc, config=config, curves=beads, plan=plan, match=match, part=part, layers=fresh, smooth=smooth, beads=True, metal=True,
        laid=lambda: laid, heat=True, heights=fresh.heights, sha256=hashes, truth=truth_of(manifest),
    )  # fmt: skip
    tables |= follow.tables_of_program(nc, run.read_layers(str(manifest["primary"])), config)
    tables |= follow.tables_of_metal(laid, z_of, config.base_mm)
    return [readable, *checks], plan, tables, laid.narrow


def truth_of(manifest: Mapping[str, Any]) -> Truth:
    """What a run's record says of its program, to compare with the program's header; settings are as recorded, since a later
    version may have more."""
    validated = bool(manifest["program"]["validated"])
    return Truth(validated, manifest["part"]["sha256"], sha256_of_json(manifest["settings"]))
