"""The gates that a program must pass to be called validated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from ebamcheck.checks.heat_again import highest_entry_k
from ebamcheck.checks.interpass_checks import AGAIN, COLD, INTERPASS, within_range
from ebamcheck.checks.mesh_checks import layer_borders
from ebamcheck.checks.rules import of_gate
from ebamcheck.checks.value_checks import MELTING
from ebamcheck.comparison import Comparison, Disagreement
from ebamcheck.comparison.doubt import doubted_layers
from ebamcheck.comparison.naming import worst_of
from ebamcheck.errors import ExitCode
from ebamcheck.kernels import Floats
from ebamcheck.layers.heights import section_areas
from ebamcheck.mesh.bodies import MOST_LISTED, bodies_of
from ebamcheck.mesh.inspection import Inspection
from ebamcheck.mesh.part import Part
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.pipeline.cross_check import not_counted, resting
from ebamcheck.pipeline.fit import FitVerdict, gate_text
from ebamcheck.result import Check, Place
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Outcome

NO_AGREEMENT = "layers without agreement"  # unit of the gate `agreement`


def input_gate(inspection: Inspection, volume_off: str = "") -> Check:
    """The part is closed, consistently oriented and the right way out, and its volume is that of its sections."""
    told = [f"{inspection.verdict}: {inspection.why}", *([volume_off] if volume_off else [])]
    faults = (not inspection.passed) + bool(volume_off)
    return Check.gate("input", not faults, float(faults), 0.0, "faults", "; ".join(told))


def volume_off(part: Part, cuts: Floats, areas: Floats, config: Config) -> str:
    """Say how far the volume of the part is off that of its sections; empty where they agree, or the layers are not all of it.

    `cuts` (L,), mm, are the heights of the layers from below, `areas` (L,), mm2, those of their sections by one slicer, which
    unites bodies layer by layer; the volume is of the union of bodies by manifold3d. Sections of the mesh itself are known in
    closed form, with every body counted; what the slicers' lack of them would count twice, and is summed over layers. A section of
    it changes by no more than its surface seen from above, P, so that, cut at the middles of layers of height h, it is summed to
    within h P / 2."""
    if len(cuts) < 2 or config.layers.heights_mm or config.base_mm > 0.0:
        return ""
    found = bodies_of(part)
    heights = np.diff(layer_borders(part, cuts, config))
    twice = section_areas(part, cuts) - areas
    of_sections = found.signed_mm3 - float((heights * twice).sum())
    bound = 0.5 * float(heights.max()) * _seen_from_above(part)
    allowed = bound + config.process.mass_tolerance * found.volume_mm3
    off = abs(of_sections - found.volume_mm3)
    if off <= allowed:
        return ""
    return (
        f"its sections times heights of layers are {of_sections:.6g} mm3, its volume is {found.volume_mm3:.6g} mm3: {off:.4g} mm3 apart, "
        f"over {allowed:.4g} mm3; facets of one body cut each other, or bodies do in a way that was not found: unite them in the model"
    )


def _seen_from_above(part: Part) -> float:
    """Area seen from above, up and down, of the facets where bodies lie in each other or overlap, mm2."""
    relations = bodies_of(part).relations
    if not relations:
        return 0.0
    corners: Floats = part.triangles
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = np.full(len(corners), len(relations) > MOST_LISTED)
    for relation in relations[:MOST_LISTED]:
        near |= ((low <= relation.upper_mm) & (high >= relation.lower_mm)).all(axis=1)
    a, b, c = np.moveaxis(corners[near, :, :2], 1, 0)
    u, v = b - a, c - a
    return 0.5 * float(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum())


def agreement_gate(
    comparison: Comparison,
    outcomes: Mapping[str, Outcome],
    layers: int,
    first_layer_mm: float = 1.0,
    base_mm: float = 0.0,
) -> Check:
    """At least two methods agree on every layer, and no method that was asked for failed.

    Heights of the program are told by `first_layer_mm`, the height of an only layer, and `base_mm`, Z of what it lies on.
    """
    failed = [f"{o.name} {o.failure} ({o.why})" for o in outcomes.values() if o.file is None]
    lost = [o for o in outcomes.values() if o.file is None and o.failure != "unavailable"]
    idle = not_counted(comparison)
    methods = len(outcomes) - len(failed)
    verdicts = comparison.layers["verdict"]
    bad = int(verdicts.isin(["outlier", "undecided", "empty"]).sum())
    good = int((verdicts == "agree").sum())
    independent = methods > 1 and bool(comparison.pairs["evidence"].any())
    if not independent:
        text = f"{methods} method left, two are needed"
        if methods > 1:
            text = f"{methods} methods left, no two of which are independent evidence"
        text += f": {'; '.join([*failed, *idle])}" if failed or idle else ""
        return Check.gate("agreement", False, float(layers), 0.0, NO_AGREEMENT, text)
    skipped = layers - good - bad
    text = f"{methods} methods agree on {good} of {layers} layers"
    if bad:
        worst = worst_of(comparison.findings)
        found = worst and f"worst {disagreement_in_words(worst, comparison, first_layer_mm, base_mm)}"
        text += f"; they disagree on {bad}: {found or 'no cause was found'}"
    for a, b, doubted, depth, added in doubted_layers(comparison.pairs):
        text += (
            f"; {a} and {b} agree on {len(doubted)} of them by declared doubt alone, {depth:.2g} mm apart with {added:.2g} mm "
            "declared (comparison.doubt_mm)"
        )
    if skipped:
        text += (
            f"; {skipped} pass through a vertex or face and no two methods with one rule for that are left: "
            "shift the layers a little, or add such a method"
        )
    if lost:
        text += f"; lost: {'; '.join(failed)}"
    text += "".join(f"; {part}" for part in [*idle, resting(comparison)] if part)
    passed = comparison.passed and good == layers
    return Check.gate("agreement", passed, float(bad + skipped), 0.0, NO_AGREEMENT, text)


def disagreement_in_words(f: Disagreement, comparison: Comparison, first_layer_mm: float, base_mm: float = 0.0) -> str:
    """A disagreement: who, where in part and program, by how much, why, and what to do."""
    heights = comparison.layers["height_mm"].to_numpy(np.float64)
    z_mm = float(deposition_heights(heights, first_layer_mm, base_mm)[f.layer])
    place = Place(layer=f.layer, cut_mm=f.height_mm, z_mm=z_mm)
    cause = f.cause_text or f.cause
    if f.metric == "empty":
        return f"{place}, is empty for every slicer although facets cross it: {cause}; {f.remedy}"
    unit = " mm" if f.metric == "depth" else " rings"
    return (
        f"{f.backend} against {f.against}: {cause}; {f.metric} {f.value:.4g} over {f.limit:.4g}{unit} at "
        f"({f.x_mm:.3f}, {f.y_mm:.3f}) of {place}; {f.remedy}"
    )


def fit_gate(verdict: FitVerdict) -> Check:
    """The mesh, the other layers and the reference speak for every ring of the fitted curves."""
    if not verdict.evidence.cause.size:
        return Check.gate("fit", False, float("nan"), 0.0, "faults", "there is no contour to fit")
    return Check.gate("fit", verdict.faults == 0, float(verdict.faults), 0.0, "faults", gate_text(verdict))


def coverage_gate(metrics: pd.DataFrame, config: Config) -> Check:
    """The beads cover the section."""
    limit = config.scan.least_coverage
    solid = metrics[metrics["area_mm2"] > 0]
    if not len(solid):
        return Check.gate("coverage", False, 0.0, limit, "of the area", "there is no area to cover")
    covered = solid["covered_fraction"].to_numpy()
    k = int(np.argmin(covered))
    mean = float(np.average(covered, weights=solid["area_mm2"]))
    text = f"beads cover {100 * mean:.2f} % of the part's area, least {100 * covered[k]:.2f} % at layer {solid.index[k] + 1}"
    return Check.gate("coverage", bool(covered[k] >= limit), float(covered[k]), limit, "of the area", text)


def deposit_gate(checks: Iterable[Check], config: Config) -> Check:
    """The metal of the program is that of the part, lies where the part is, and is flat; the first check that fails speaks."""
    limit = config.process.mass_tolerance
    made = of_gate(checks, "deposit")
    if not made:
        text = "no program was written: there is no contour"
        return Check.gate("deposit", False, float("nan"), limit, "of the part", text)
    failed = [check for check in made if not check.passed]
    said, others = failed[0] if failed else made[0], [check.name for check in failed[1:]]
    more = f" (and {len(others)} more: {', '.join(others)})" if others else ""
    text = said.text if failed else "; ".join(check.text for check in made[:3])
    return Check.gate("deposit", not failed, said.value, said.limit, said.unit, text + more)


def heat_gate(checks: Iterable[Check], metrics: pd.DataFrame, config: Config) -> Check:
    """No bead is entered above the limit, by the plan and by the balance of the text, or too cold after a wait; and its wire
    melts."""
    limit_k, ambient_k = highest_entry_k(config), config.process.ambient_temperature_k
    by_name = {check.name: check for check in of_gate(checks, "heat")}
    again, cold = by_name.pop(AGAIN, None), by_name.pop(COLD, None)
    if len(by_name) < 2:
        why = "no program was written: there is no contour"
        if config.base_mm > 0.0:
            why = "the temperature of what stands under the program (layers.base_mm) is not known: its heat cannot be judged"
        return Check.gate("heat", False, float("nan"), limit_k, "K", why)
    text, melting = by_name[INTERPASS], by_name[MELTING]
    at_bead = config.process.interpass_at == "bead"
    planned = metrics["entry_max_k"] + ambient_k if at_bead else metrics["enter_k"]
    planned_k = float(planned.max()) if planned.notna().any() else -math.inf
    figure_k, mark = within_range(max(text.value, planned_k), config)
    said = text.text
    if planned_k > text.value:
        over = f", over {limit_k:.0f} K" if planned_k > limit_k else ""
        layer = int(planned.argmax()) + 1
        said = f"a bead of layer {layer} is planned to be entered at {figure_k:.0f} K{mark}{over}"
    # A plan without a heat model has no figure at all; one with a model has one for every layer that is laid.
    laid = metrics[["contour_length_mm", "hatch_length_mm"]].sum(axis=1) > 0.0
    unknown = np.flatnonzero(laid & planned.isna()) if planned.notna().any() else np.zeros(0, np.int64)
    passed = text.passed and planned_k <= limit_k and melting.passed and not unknown.size
    for check in (again, cold):
        if check is not None and not check.passed:
            passed, said = False, f"{check.text}; {said}"
    if unknown.size:
        said = f"the plan has no temperature for layer {int(unknown[0]) + 1}, which has beads; {said}"
    if not melting.passed:
        said = f"{melting.text}; {said}"
    return Check.gate("heat", passed, figure_k, limit_k, "K", said)


def program_gate(checks: Iterable[Check]) -> Check:
    """Every check of the program that was read back passed; what other gates are about is theirs."""
    made = of_gate(checks, "program")
    failed = [c for c in made if not c.passed]
    if not made:
        return Check.gate("program", False, 0.0, 0.0, "faults", "no program was written: there is no contour")
    text = f"{len(made)} checks passed"
    if failed:
        told = [check.in_words() for check in failed[:2]]  # of more the names
        told += [f"and {', '.join(check.name for check in failed[2:])}"] if failed[2:] else []
        text = f"{len(failed)} of {len(made)} checks failed: {' | '.join(told)}"
    return Check.gate("program", not failed, float(len(failed)), 0.0, "faults", text)


def entry_gate(check: Check) -> Check:
    """The program that begins at a layer commands what the whole one does from there on, from a state of its own."""
    text = check.text if check.passed else check.in_words()
    return Check.gate("entry", check.passed, check.value, check.limit, check.unit, text)


def exit_code(gates: Iterable[Check], compared_layers: int, outcomes: Mapping[str, Outcome]) -> ExitCode:
    """Exit code of a run: 5 where nothing could be compared, 1 where a gate is shut, else 0.

    A method that was lost, and a part that did not pass the input gate, are 1, not 5: something was found.
    """
    shut = {gate.name for gate in gates if not gate.passed}
    lost = any(o.file is None and o.failure != "unavailable" for o in outcomes.values())
    if compared_layers == 0 and not lost and "input" not in shut:
        return ExitCode.NOTHING_COMPARED
    return ExitCode.OUT_OF_TOLERANCE if shut else ExitCode.PASS
