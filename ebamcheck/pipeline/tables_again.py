"""The tables of a finished run, worked out again: a hash shows that a file was changed, and nothing where hashes are made anew."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.comparison import Comparison
from ebamcheck.errors import EbamcheckError
from ebamcheck.layers.stack import Layers
from ebamcheck.pipeline.cross_check import layer_table
from ebamcheck.pipeline.run_folder import RunFolder
from ebamcheck.program import Check, program_summary, read_program
from ebamcheck.program.checking.deposit import deposit
from ebamcheck.program.checking.matching import matched
from ebamcheck.program.toolpath.bead_ends import planned_path
from ebamcheck.program.toolpath.events import event_totals, process_events
from ebamcheck.program.toolpath.inputs import CurveColumns, deposition_heights
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config

NAME = "tables"

SAME_FIGURE = 1e-6
"""Figures that differ by less, relative to the greater, are the same: sums in another order."""

NOTHING = 1e-9
"""Figures that differ by less are the same, whatever they are."""


def tables_check(
    run: RunFolder, manifest: Mapping[str, Any], found: Mapping[str, pd.DataFrame], why_not: Mapping[str, str]
) -> Check:
    """Compare the tables of a run with those that were `found`, by name of the file, and name the files of which only hashes are known.

    Parameters
    ----------
    why_not
        Files that could be worked out, and were not, each with the reason.
    """
    told = sorted(name for name in found if name in manifest["files"])
    faults = [fault for name in told for fault in _differences(run.path / name, found[name])]
    text = "; ".join(faults[:3]) or f"{', '.join(told)} are those that follow"
    text += "".join(f"; {name} was not compared: {why}" for name, why in sorted(why_not.items()))
    others = {path.name for path in run.path.iterdir() if path.suffix in RENDERED} - {
        *found,
        *why_not,
        *CHECKED,
    }
    by_hash = sorted(name for name in others if not name.startswith("."))
    if by_hash:
        text += f"; only the hashes were looked at of {', '.join(by_hash)}"
    return Check(
        NAME, not faults, float(len(faults)), 0.0, "faults", faults[0].split(":")[0] if faults else "", text
    )


PLACE = re.compile(r"(^|_)[xy]_mm$")
"""Columns of where the worst place is: of several that are alike, another processor may find another one."""

AREA = "area_mm2_"
"""Beginning of the name of a slicer's column of areas."""

RENDERED = (".csv", ".html", ".parquet", ".xml")
"""Endings of what holds figures for people and other programs."""

CHECKED = ("scan.parquet", "beads.parquet")
"""Tables against which, as they are, the text itself is checked."""


def order_of(run: RunFolder) -> list[str]:
    """Slicers in the order in which the tables of a run have them; none where it has no such table."""
    try:
        columns = pd.read_csv(run.path / "layers.csv", nrows=0).columns
    except (OSError, ValueError):
        return []
    return [str(name).removeprefix(AREA) for name in columns if str(name).startswith(AREA)]


def of_comparison(comparison: Comparison) -> dict[str, pd.DataFrame]:
    """Tables of a comparison."""
    return {
        "layers.csv": layer_table(comparison),
        "compare.csv": comparison.pairs,
        "compare.parquet": comparison.pairs,
    }


def of_program(
    main: Path, beads: CurveColumns, plan: ScanPlan, sections: Layers | None, config: Config
) -> dict[str, pd.DataFrame]:
    """Tables of plan and text; that of the metal where the `sections` are those that it was held against. None where it cannot be read."""
    path = planned_path(beads, plan, config)
    events = process_events(path, plan, config)
    found = {
        "scan.csv": plan.metrics,
        "events.parquet": events,
        "process.csv": event_totals(events, len(path.z), config),
    }
    try:
        nc, _ = matched(read_program(main, config), path)
    except EbamcheckError:  # A check of its own tells that.
        return found
    found["program.csv"] = program_summary(nc, config)
    if sections is not None:
        z_of = deposition_heights(sections.heights, config.layer_height_mm, config.base_mm)
        found["deposit.csv"] = deposit(nc, sections, z_of, config).layers
    return found


def _differences(path: Path, found: pd.DataFrame) -> Iterable[str]:
    """The first place where a recorded table is another than the one that was found, in words."""
    try:
        if path.suffix == ".parquet":
            recorded = pd.read_parquet(path)
        else:
            recorded = pd.read_csv(path)
            found = pd.read_csv(io.StringIO(found.to_csv(index=False)))
    except (OSError, ValueError) as error:
        return [f"{path.name}: cannot be read: {error}"]
    if list(recorded.columns) != list(found.columns) or len(recorded) != len(found):
        sizes = [f"{len(table)} rows of {len(table.columns)} columns" for table in (recorded, found)]
        return [f"{path.name}: {sizes[0]} are recorded, {sizes[1]} follow"]
    for name in found.columns:
        if PLACE.search(str(name)):
            continue
        other = np.flatnonzero(~_same(recorded[name], found[name]))
        if other.size:
            k = int(other[0])
            return [
                f"{path.name}: row {k + 1}, {name}: recorded {recorded[name].iloc[k]}, found {found[name].iloc[k]}"
            ]
    return []


def _same(recorded: pd.Series[Any], found: pd.Series[Any]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    numbers = pd.api.types.is_numeric_dtype
    if numbers(recorded) and numbers(found):
        a, b = recorded.to_numpy(np.float64), found.to_numpy(np.float64)
        return np.asarray(np.isclose(a, b, rtol=SAME_FIGURE, atol=NOTHING, equal_nan=True))
    return np.asarray((recorded.astype(str) == found.astype(str)).to_numpy(), np.bool_)
