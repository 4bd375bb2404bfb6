"""Tables and reports of a finished run, worked out again: a hash shows that a file was changed, and nothing where hashes are made anew."""

from __future__ import annotations

import io
import re
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from importlib import import_module
from itertools import zip_longest
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ebamcheck.checks.matching import matched
from ebamcheck.checks.metal import FIELD_FILE, Deposit, field_table
from ebamcheck.comparison import Comparison
from ebamcheck.errors import EbamcheckError, InputError
from ebamcheck.kinematics import side_by_side
from ebamcheck.layer_numbers import numbered
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.rings import Floats
from ebamcheck.pipeline.cross_check import layer_table
from ebamcheck.plugins import registry
from ebamcheck.plugins.points import is_house
from ebamcheck.program import Check, NCProgram, program_summary
from ebamcheck.record.run_folder import MANIFEST, TIMINGS, RunFolder
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config
from ebamcheck.version import __version__
from ebamcheck.writing.events import event_totals, process_events
from ebamcheck.writing.tracks import Toolpath

NAME = "tables"

SAME_FIGURE = 1e-6
"""Figures that differ by less, relative to the greater, are the same: sums in another order."""

NOTHING = 1e-9
"""Figures that differ by less are the same, whatever they are."""


SAME_LENGTH_MM = 1e-6
"""Heights of metal and points of curves that differ by less are the same."""

SHOWN = 40
"""Characters that are told of two lines that differ, from a little before the place on."""


def tables_check(
    run: RunFolder,
    manifest: Mapping[str, Any],
    tables: Mapping[str, pd.DataFrame | pa.Table],
    why_not: Mapping[str, str],
) -> Check:
    """Compare tables and reports of a run with those that follow, and name the files of which only hashes are known.

    Parameters
    ----------
    tables
        Tables that were worked out, by name of the file. Reports that follow from the record alone are made here.
    why_not
        Files that could be worked out, and were not, each with the reason.
    """
    named = {
        name: numbered(table) if isinstance(table, pd.DataFrame) and name not in INDEXED else table
        for name, table in tables.items()
    }
    found: dict[str, pd.DataFrame | pa.Table | bytes] = {**named, **reports_again(run)}
    why_not = dict(why_not)
    if manifest["ebamcheck"] != __version__:
        other = f"the run is of version {manifest['ebamcheck']}, this is {__version__}"
        why_not |= {name: other for name, made in found.items() if isinstance(made, bytes)}
    told = sorted(name for name in found if name not in why_not and (run.path / name).is_file())
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

INDEXED = ("events.parquet",)
"""Tables for programs, which count layers from 0; those that people open count them from 1."""

CHECKED = ("scan.parquet", "beads.parquet")
"""Tables against which, as they are, the text itself is checked."""


def order_of(run: RunFolder) -> list[str]:
    """Slicers in the order in which the tables of a run have them; none where it has no such table."""
    try:
        columns = pd.read_csv(run.path / "layers.csv", nrows=0).columns
    except (OSError, ValueError):
        return []
    return [str(name).removeprefix(AREA) for name in columns if str(name).startswith(AREA)]


def tables_of_comparison(comparison: Comparison) -> dict[str, pd.DataFrame]:
    """Tables of a comparison."""
    return {
        "layers.csv": layer_table(comparison),
        "compare.csv": comparison.pairs,
        "compare.parquet": comparison.pairs,
    }


def tables_of_plan(path: Toolpath, plan: ScanPlan, config: Config) -> dict[str, pd.DataFrame]:
    """Tables of a plan, and of the tracks that were laid out of it."""
    events = process_events(path, plan, config)
    return {
        "scan.csv": plan.metrics,
        "events.parquet": events,
        "process.csv": event_totals(events, len(path.z), config),
    }


def tables_of_program(
    nc: NCProgram, path: Toolpath, contours: Layers, config: Config
) -> dict[str, pd.DataFrame]:
    """Tables of a program that was read; `contours` are those that it was made from."""
    nc, _ = matched(nc, path)
    return {
        "program.csv": program_summary(nc, config),
        "kinematics.csv": side_by_side(nc, contours, config).reset_index(),
    }


def sums_of(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Sums over the tables of plan and program, by the place where a record has them; of a table that is missing, nothing."""
    found: dict[str, Any] = {
        place: {name: float(tables[file][name].sum()) for name in tables[file].select_dtypes("number")}
        for place, file in (("scan", "process.csv"), ("program.totals", "program.csv"))
        if file in tables
    }
    if "kinematics.csv" in tables:
        paths = tables["kinematics.csv"]
        found["kinematics"] = paths.set_index(paths.columns[0]).to_dict(orient="index")
    return found


def tables_of_metal(laid: Deposit, z_of: Floats, base_mm: float) -> dict[str, pd.DataFrame | pa.Table]:
    """Tables of the metal that a program lays; `z_of` are the tops of its layers."""
    if laid.worst < 0:
        return {"deposit.csv": laid.layers}
    thickness_mm = float(np.diff(z_of, prepend=base_mm)[laid.worst])
    return {
        "deposit.csv": laid.layers,
        FIELD_FILE: field_table(laid.fields[laid.worst], laid.worst, thickness_mm),
    }


def _differences(path: Path, found: pd.DataFrame | pa.Table | bytes) -> Iterable[str]:
    """The first place where a recorded table or report is another than the one that was found, in words."""
    try:
        if isinstance(found, bytes):
            return _of_lines(path.name, _lines(path.read_bytes(), path.suffix), _lines(found, path.suffix))
        if isinstance(found, pa.Table):
            return _of_columns(path.name, pq.read_table(path, partitioning=None), found)
        if path.suffix == ".parquet":
            recorded = pd.read_parquet(path)
        else:
            recorded = pd.read_csv(path)
            found = pd.read_csv(io.StringIO(found.to_csv(index=False)))
    except (OSError, ValueError, pa.ArrowException, ElementTree.ParseError) as error:
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


def _of_columns(name: str, recorded: pa.Table, found: pa.Table) -> list[str]:
    """The first column that differs, in words; of lists the numbers one after the other."""
    if recorded.schema != found.schema or recorded.schema.metadata != found.schema.metadata:
        return [f"{name}: its columns, or what it says of itself, are not those that follow"]
    for column in found.column_names:
        a, b = (_numbers(table.column(column)) for table in (recorded, found))
        if a.shape != b.shape:
            return [f"{name}: {column}: {a.size} numbers are recorded, {b.size} follow"]
        other = np.flatnonzero(~np.isclose(a, b, rtol=SAME_FIGURE, atol=SAME_LENGTH_MM, equal_nan=True))
        if other.size:
            k = int(other[0])
            return [f"{name}: {column}, number {k + 1}: recorded {a[k]:.9g}, found {b[k]:.9g}"]
    return []


def _numbers(column: pa.ChunkedArray) -> Floats:
    """Numbers of a column; of one of lists, how long each is and then all of their items."""
    whole = column.combine_chunks()
    if not pa.types.is_large_list(whole.type):
        return np.asarray(whole.to_numpy(zero_copy_only=False), np.float64)
    parts = (whole.value_lengths(), whole.flatten())
    return np.concatenate([np.asarray(part.to_numpy(zero_copy_only=False), np.float64) for part in parts])


def _lines(data: bytes, suffix: str) -> list[str]:
    """Lines of a report; of XML, which each version of a library indents in its own way, one a tag."""
    text = data.decode("utf-8")
    if suffix == ".xml":
        return ElementTree.canonicalize(text, strip_text=True).replace("><", ">\n<").split("\n")
    return text.split("\n")


def _of_lines(name: str, recorded: list[str], found: list[str]) -> list[str]:
    """The first line that differs, in words."""
    if recorded == found:
        return []
    pairs = enumerate(zip_longest(recorded, found, fillvalue="nothing"), 1)
    k, (a, b) = next((k, pair) for k, pair in pairs if pair[0] != pair[1])
    same = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
    at = max(same - SHOWN // 2, 0)
    return [f"{name}: line {k}: recorded {a[at : at + SHOWN]!r}, found {b[at : at + SHOWN]!r}"]


def _same(recorded: pd.Series[Any], found: pd.Series[Any]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    numbers = pd.api.types.is_numeric_dtype
    if numbers(recorded) and numbers(found):
        a, b = recorded.to_numpy(np.float64), found.to_numpy(np.float64)
        return np.asarray(np.isclose(a, b, rtol=SAME_FIGURE, atol=NOTHING, equal_nan=True))
    return np.asarray((recorded.astype(str) == found.astype(str)).to_numpy(), np.bool_)


OF_RECORD = "OF_RECORD"
"""Name of the tuple in which a package of ours tells which of its report writers read the record of a run alone."""


def reports_again(run: RunFolder) -> dict[str, bytes]:
    """Files that the house's writers of such reports make of the record of a run, by name.

    They are given a folder with the record and no other file of the run: what they write depends on nothing else.

    Raises
    ------
    InputError
        If one of them cannot be made from this record.
    """
    found: dict[str, bytes] = {}
    for name, point in registry.points(registry.REPORTS).items():
        if not is_house(point) or name not in _of_record(point.module.partition(".")[0]):
            continue
        with tempfile.TemporaryDirectory(prefix="ebamcheck-", ignore_cleanup_errors=True) as temporary:
            bare = RunFolder(Path(temporary))
            for file in (MANIFEST, TIMINGS):
                if (run.path / file).is_file():
                    shutil.copyfile(run.path / file, bare.path / file)
            try:
                written = registry.load(point)(bare)
            except EbamcheckError:
                raise
            except Exception as error:  # A record that was tampered with may hold anything.
                why = f"{type(error).__name__}: {error}"
                raise InputError(
                    f"{run.path / MANIFEST}: report {name!r} cannot be made from it: {why}"
                ) from None
            found |= {file: (bare.path / file).read_bytes() for file in written}
    return found


def _of_record(package: str) -> tuple[str, ...]:
    """Names of such writers of a package."""
    return tuple(getattr(import_module(package), OF_RECORD, ()))
