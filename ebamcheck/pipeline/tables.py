"""Tables of a run folder by the name of their file, as the stages' values make them: a run writes them, a verification compares
them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import pyarrow as pa

from ebamcheck.atomic_file import COMPRESSION
from ebamcheck.checks.metal import FIELD_FILE, Deposit, field_table, write_field
from ebamcheck.comparison import Comparison
from ebamcheck.curves import Curves
from ebamcheck.kernels import Floats
from ebamcheck.kinematics import side_by_side
from ebamcheck.layers.files import write_parquet
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.motions import NCProgram
from ebamcheck.printable import numbered
from ebamcheck.program import program_summary
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config
from ebamcheck.writing.events import event_totals, process_events
from ebamcheck.writing.tracks import Toolpath

# What stands in a file of figures of a run
Table: TypeAlias = pd.DataFrame | pa.Table | Curves | ScanPlan | Layers
INDEXED = ("events.parquet",)  # tables for programs, which count layers from 0; those for people count from 1


def write_tables(folder: Path, tables: Mapping[str, Table]) -> None:
    """Write tables into a run folder, each under its name."""
    for name, table in tables.items():
        path = folder / name
        if isinstance(table, pd.DataFrame):
            rows = table if name in INDEXED else numbered(table)
            if path.suffix == ".csv":
                rows.to_csv(path, index=False)
            else:
                rows.to_parquet(path, index=False, compression=COMPRESSION)
        elif isinstance(table, pa.Table):
            write_field(table, path)
        elif isinstance(table, Layers):
            write_parquet(table, path)
        else:
            table.to_parquet(path)


def layer_table(comparison: Comparison) -> pd.DataFrame:
    """One row a layer: class, verdict, and area, rings and open paths of every backend."""
    table = comparison.layers.copy()
    for name, figures in comparison.stacks.items():
        table[f"area_mm2_{name}"] = figures["area_mm2"]
        table[f"rings_{name}"] = figures["rings"]
        table[f"open_paths_{name}"] = figures["open_paths"]
    return table


def tables_of_comparison(comparison: Comparison) -> dict[str, Table]:
    """Tables of a comparison."""
    pairs = comparison.pairs
    return {"layers.csv": layer_table(comparison), "compare.csv": pairs, "compare.parquet": pairs}


def tables_of_plan(path: Toolpath, plan: ScanPlan, config: Config) -> dict[str, Table]:
    """Tables of a plan, and of the tracks that were laid out of it."""
    events = process_events(path, plan, config)
    totals = event_totals(events, len(path.z), config)
    return {"scan.csv": plan.metrics, "events.parquet": events, "process.csv": totals}


def tables_of_program(nc: NCProgram, contours: Layers, config: Config) -> dict[str, pd.DataFrame]:
    """Tables of a program whose beads are those of its plan; `contours` are those that it was made from."""
    paths = side_by_side(nc, contours, config).reset_index()
    return {"program.csv": program_summary(nc, config), "kinematics.csv": paths}


def tables_of_metal(laid: Deposit, z_of: Floats, base_mm: float) -> dict[str, Table]:
    """Tables of the metal that a program lays; `z_of` are the tops of its layers."""
    if laid.worst < 0:
        return {"deposit.csv": laid.layers}
    thickness_mm = float(np.diff(z_of, prepend=base_mm)[laid.worst])
    field = field_table(laid.fields[laid.worst], laid.worst, thickness_mm)
    return {"deposit.csv": laid.layers, FIELD_FILE: field}


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
