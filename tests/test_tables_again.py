"""Tables of a run, of which figures were edited and all hashes made anew: they are worked out again."""

from __future__ import annotations

import shutil

import pandas as pd
import pytest
from command_line import write_stl
from parts import box
from slicers_here import slicers_here

from benchmarks.faults.judging import reseal
from benchmarks.faults.subjects import CONTROLS, SUBJECTS
from ebamcheck.pipeline import check_job, run_job
from ebamcheck.pipeline.verify import verify_run

PLAIN = CONTROLS[-1]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables")
    part = write_stl(box((0, 0, 0), (24, 24, 5)), folder / "cube.stl")
    with slicers_here():
        run_job(part, folder / "run", SUBJECTS["cube"].config(PLAIN))
        check_job(part, folder / "check", SUBJECTS["cube"].config(PLAIN))
    return folder


def edited(path, column):
    """Change the last figure of a column."""
    read, write = (pd.read_parquet, "to_parquet") if path.suffix == ".parquet" else (pd.read_csv, "to_csv")
    table = read(path)
    table[column] = table[column].astype(float)
    table.loc[table.index[-1], column] = 1.01 * table[column].iloc[-1] + 1e-3
    getattr(table, write)(path, index=False)


def of_tables(made, run, part="cube.stl"):
    return {check.name: check for check in verify_run(run, made / part)}


def test_of_a_sound_run_they_are_those_that_follow_and_the_others_are_named(made):
    checks = of_tables(made, made / "run")
    assert all(check.passed for check in checks.values())
    said, _, by_hash = checks["tables"].text.partition("; only the hashes were looked at of ")
    for name in (
        "compare.csv",
        "deposit.csv",
        "events.parquet",
        "fit.csv",
        "layers.csv",
        "process.csv",
        "program.csv",
    ):
        assert name in said
    assert {"report.html", "junit.xml", "kinematics.csv"} <= set(by_hash.split(", "))


@pytest.mark.parametrize(
    ("name", "column"),
    [
        ("deposit.csv", "laid_mm3"),
        ("program.csv", "wire_kg"),
        ("process.csv", "wire_mm"),
        ("events.parquet", "power_w"),
        ("scan.csv", "covered_fraction"),
        ("fit.csv", "lift_mm"),
        ("layers.csv", "area_mm2_planecut"),
        ("compare.csv", "area_a_mm2"),
    ],
)
def test_an_edited_figure_is_found_though_all_hashes_are_made_anew(made, tmp_path, name, column):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    columns = (
        pd.read_parquet(copy / name).columns if name.endswith("parquet") else pd.read_csv(copy / name).columns
    )
    assert column in columns, list(columns)
    edited(copy / name, column)
    reseal(copy, "MAIN.gcode")
    failed = {check.name: check for check in verify_run(copy, made / "cube.stl") if not check.passed}
    assert set(failed) == {"tables"}
    assert failed["tables"].text.startswith(f"{name}: row ")
    assert column in failed["tables"].text


def test_a_row_that_was_taken_out_is_found(made, tmp_path):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    pd.read_csv(copy / "deposit.csv")[:-1].to_csv(copy / "deposit.csv", index=False)
    reseal(copy, "MAIN.gcode")
    assert "2 rows" in of_tables(made, copy)["tables"].text


def test_a_cross_check_has_tables_too(made):
    checks = of_tables(made, made / "check")
    assert checks["tables"].passed
    assert checks["tables"].text.startswith("compare.csv, compare.parquet, layers.csv are those that follow")
