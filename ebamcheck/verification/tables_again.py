"""Tables and reports of a finished run, worked out again: a hash shows that a file was changed, and nothing where hashes are made
anew."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ebamcheck.curves import Curves
from ebamcheck.curves.columns import table_of
from ebamcheck.kernels import Floats
from ebamcheck.pipeline.reports import reports_again
from ebamcheck.pipeline.tables import INDEXED, Table
from ebamcheck.printable import numbered
from ebamcheck.program import Check
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.version import __version__

# Figures that differ by less, relative to the greater, are the same: sums in another order.
SAME_FIGURE = 1e-6
SHOWN = 40  # Characters that are told of two lines that differ, from a little before the place on
# Columns of where the worst place is: of several that are alike, another processor may find another one.
PLACE = re.compile(r"(^|_)[xy]_mm$")
AREA = "area_mm2_"  # Beginning of the name of a slicer's column of areas


def tables_check(
    run: RunFolder, manifest: Mapping[str, Any], tables: Mapping[str, Table], why_not: Mapping[str, str]
) -> Check:
    """Compare tables and reports of a run with those that follow, and name the files of which only hashes are known.

    Reports that follow from the record alone are made here; `why_not` says of files that could be worked out why they were not.
    """
    found: dict[str, Table | bytes] = {**tables, **reports_again(run)}
    for name, table in tables.items():
        if isinstance(table, pd.DataFrame) and name not in INDEXED:
            found[name] = numbered(table)
    why_not = dict(why_not)
    if manifest["ebamcheck"] != __version__:
        other = f"the run is of version {manifest['ebamcheck']}, this is {__version__}"
        why_not |= {name: other for name, made in found.items() if isinstance(made, bytes)}
    told = sorted(name for name in found if name not in why_not and (run.path / name).is_file())
    faults = [fault for name in told for fault in _differences(run.path / name, found[name])]
    text = "; ".join(faults[:3]) or f"{', '.join(told)} are those that follow"
    text += "".join(f"; {name} was not compared: {why}" for name, why in sorted(why_not.items()))
    # Files with figures for people and other programs, but for the tables against which, as they are, the text itself is checked.
    rendered = (".csv", ".html", ".parquet", ".xml")
    others = {path.name for path in run.path.iterdir() if path.suffix in rendered}
    others -= {*found, *why_not, "scan.parquet", "beads.parquet"}
    by_hash = sorted(name for name in others if not name.startswith("."))
    if by_hash:
        text += f"; only the hashes were looked at of {', '.join(by_hash)}"
    where = faults[0].split(":")[0] if faults else ""
    return Check("tables", not faults, float(len(faults)), 0.0, "faults", where, text)


def order_of(run: RunFolder) -> list[str]:
    """Slicers in the order in which the tables of a run have them; none where it has no such table."""
    try:
        columns = pd.read_csv(run.path / "layers.csv", nrows=0).columns
    except (OSError, ValueError):
        return []
    return [str(name).removeprefix(AREA) for name in columns if str(name).startswith(AREA)]


def _differences(path: Path, found: Table | bytes) -> Iterable[str]:
    """The first place where a recorded table or report is another than the one that was found, in words."""
    try:
        if isinstance(found, bytes):
            return _of_lines(path.name, _lines(path.read_bytes(), path.suffix), _lines(found, path.suffix))
        if isinstance(found, pa.Table | Curves):
            table = table_of(found) if isinstance(found, Curves) else found
            return _of_columns(path.name, pq.read_table(path, partitioning=None), table)
        if not isinstance(found, pd.DataFrame):
            what = "the program's text is checked against it, and it against nothing"
            raise TypeError(f"{path.name}: {type(found).__name__}: {what}")
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
    for name in (name for name in found.columns if not PLACE.search(str(name))):
        other = np.flatnonzero(~_same(recorded[name], found[name]))
        if other.size:
            k = int(other[0])
            both = f"recorded {recorded[name].iloc[k]}, found {found[name].iloc[k]}"
            return [f"{path.name}: row {k + 1}, {name}: {both}"]
    return []


def _of_columns(name: str, recorded: pa.Table, found: pa.Table) -> list[str]:
    """The first column that differs, in words; of lists the numbers one after the other."""
    if recorded.schema != found.schema or recorded.schema.metadata != found.schema.metadata:
        return [f"{name}: its columns, or what it says of itself, are not those that follow"]
    for column in found.column_names:
        a, b = (_numbers(table.column(column)) for table in (recorded, found))
        if a.shape != b.shape:
            return [f"{name}: {column}: {a.size} numbers are recorded, {b.size} follow"]
        other = np.flatnonzero(~np.isclose(a, b, rtol=SAME_FIGURE, atol=1e-6, equal_nan=True))
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
        return np.asarray(np.isclose(a, b, rtol=SAME_FIGURE, atol=1e-9, equal_nan=True))
    return np.asarray((recorded.astype(str) == found.astype(str)).to_numpy(), np.bool_)
