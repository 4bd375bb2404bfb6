"""The text of a finished run's program, read, laid and checked again; once, for checks and tables alike."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa

from ebamcheck.curves import Curves
from ebamcheck.json_values import sha256_of_json
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline.run_folder import RunFolder
from ebamcheck.pipeline.solid_metal import with_solid
from ebamcheck.pipeline.tables_again import of_metal, of_plan, of_program
from ebamcheck.program import Check, verify_program
from ebamcheck.program.checking.deposit import deposit
from ebamcheck.program.checking.header_checks import Truth
from ebamcheck.program.checking.narrow_features import NarrowFeature
from ebamcheck.program.checking.verification import read_checked
from ebamcheck.program.toolpath.bead_ends import planned_path
from ebamcheck.program.toolpath.inputs import deposition_heights
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config


class TextAgain(NamedTuple):
    """What the text of a run's program came to."""

    checks: list[Check]
    plan: ScanPlan
    tables: dict[str, pd.DataFrame | pa.Table]
    """Tables of plan and text; of the plan alone where the text cannot be read."""
    narrow: tuple[NarrowFeature, ...] = ()
    """Features of the part that are narrower than beads can build."""


def text_again(
    run: RunFolder,
    manifest: Mapping[str, Any],
    config: Config,
    part: Part,
    fresh: Layers,
    smooth: Layers | None,
) -> TextAgain:
    """Read, lay and check the text of a run's program.

    Parameters
    ----------
    fresh
        Sections of the part, cut anew.
    smooth
        The contours that the run fitted, with their curves, fitted anew; None where the method of the fit makes none.
    """
    record = manifest["program"]
    plan = ScanPlan.from_parquet(run.path / "scan.parquet")
    beads = Curves.from_parquet(run.path / "beads.parquet")
    path = planned_path(beads, plan, config)
    tables: dict[str, pd.DataFrame | pa.Table] = {**of_plan(path, plan, config)}
    nc, readable = read_checked(run.program_folder / record["files"][0]["name"], config)
    if nc is None:
        return TextAgain([readable], plan, tables)
    z_of = deposition_heights(fresh.heights, config.layer_height_mm, config.base_mm)
    laid = deposit(nc, fresh, z_of, config)
    checks = verify_program(
        nc,
        config=config,
        curves=beads,
        plan=plan,
        path=path,
        layers=fresh,
        smooth=smooth,
        beads=True,
        laid=laid,
        heat=True,
        heights=fresh.heights,
        sha256={file["name"]: file["sha256"] for file in record["files"]},
        truth=truth_of(manifest),
    )
    tables |= of_program(nc, path, run.read_layers(str(manifest["primary"])), config)
    tables |= of_metal(laid, z_of, config.base_mm)
    return TextAgain([readable, *with_solid(checks, part, fresh, config)], plan, tables, laid.narrow)


def truth_of(manifest: Mapping[str, Any]) -> Truth:
    """What a run's record tells of its program, against which the program's header is held.

    The settings are those that were recorded: a version that has more of them still reads the program of one that had fewer.
    """
    validated = bool(manifest["program"]["validated"])
    return Truth(validated, manifest["part"]["sha256"], sha256_of_json(manifest["settings"]))
