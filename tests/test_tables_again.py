"""Tables and reports of a run, of which figures were edited and all hashes made anew: they are worked out again."""

from __future__ import annotations

import shutil

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import write_stl
from parts import box
from slicers_here import slicers_here

from benchmarks.faults.judging import reseal
from benchmarks.faults.subjects import CONTROLS, SUBJECTS
from ebamcheck.checks import subject
from ebamcheck.pipeline import check_job, run_job
from ebamcheck.verification.verify import verify_run
from ebamcheck.version import __version__

PLAIN = CONTROLS[-1]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables")
    part = write_stl(box((0, 0, 0), (24, 24, 5)), folder / "cube.stl")
    with slicers_here():
        run_job(part, folder / "run", SUBJECTS["cube"].config(PLAIN))
        check_job(part, folder / "check", SUBJECTS["cube"].config(PLAIN))
    return folder


def failed(run, made):
    return {check.name: check for check in verify_run(run, made / "cube.stl") if not check.passed}


def test_of_a_sound_run_they_are_those_that_follow_and_the_others_are_named(made, monkeypatch):
    def again(*_, **__):
        raise AssertionError("the metal is laid a second time")

    monkeypatch.setattr(subject, "deposit", again)
    checks = {check.name: check for check in verify_run(made / "run", made / "cube.stl")}
    assert all(check.passed for check in checks.values())
    said, _, by_hash = checks["tables"].text.partition("; only the hashes were looked at of ")
    for name in (
        "compare.csv", "curves.parquet", "deposit.csv", "deposit_worst.parquet", "events.parquet", "fit.csv", "junit.xml",
        "kinematics.csv", "layers.csv", "process.csv", "program.csv", "summary.csv",
    ):  # fmt: skip
        assert name in said
    assert by_hash == "report.html"


def other_figure(path, column):
    """Change the last figure of a column; of no column, what the table says of itself."""
    if path.suffix == ".csv":
        table = pd.read_csv(path)
        table[column] = table[column].astype(float)
        table.loc[table.index[-1], column] = 1.01 * table[column].iloc[-1] + 1e-3
        table.to_csv(path, index=False)
        return
    table = pq.read_table(path)
    if column is None:
        table = table.replace_schema_metadata({**table.schema.metadata, b"ebamcheck.curves.labels": b"{}"})
    else:
        values = table.column(column).combine_chunks()
        is_list = pa.types.is_large_list(values.type)
        numbers = (values.flatten() if is_list else values).to_numpy(zero_copy_only=False).copy()
        numbers[-1] = 1.01 * numbers[-1] + 1e-3
        other = pa.LargeListArray.from_arrays(values.offsets, pa.array(numbers)) if is_list else pa.array(numbers)
        table = table.set_column(table.column_names.index(column), column, other)
    pq.write_table(table, path)


@pytest.mark.in_turn(3)
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
        ("kinematics.csv", "excess_mm3"),
        ("curves.parquet", "x"),
        ("curves.parquet", None),
        ("deposit_worst.parquet", "laid_mm"),
    ],
)
def test_an_edited_figure_is_found_though_all_hashes_are_made_anew(made, tmp_path, name, column):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    other_figure(copy / name, column)
    reseal(copy, "MAIN.gcode")
    found = failed(copy, made)
    assert set(found) == {"tables"}
    assert found["tables"].text.startswith(f"{name}: ")
    assert (column or "what it says of itself") in found["tables"].text


def put(path, old, new):
    """Replace the first place of some text in a file."""
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


@pytest.mark.in_turn(2)
@pytest.mark.parametrize(
    ("name", "old", "new", "told"),
    [
        ("junit.xml", "the part is a closed solid", "the part is a solid", "a solid;"),
        ("junit.xml", '<testcase name="input"', '<testcase name="inputs"', "inputs"),
        ("junit.xml", 'failures="0"', 'failures="1"', 'failures="1"'),
        ("summary.csv", ",gate,input,,,True,", ",gate,input,,,False,", "False"),
        ("summary.csv", "closed, consistently oriented", "whatever it is", "whatever it is"),
    ],
)
def test_an_edited_report_is_found_though_all_hashes_are_made_anew(made, tmp_path, name, old, new, told):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    put(copy / name, old, new)
    reseal(copy, "MAIN.gcode")
    found = failed(copy, made)
    assert set(found) == {"tables"}
    assert found["tables"].text.startswith(f"{name}: line ")
    assert told in found["tables"].text.partition(", found ")[0]


def test_rows_and_lines_that_were_taken_out_are_found_and_a_file_that_is_none(made, tmp_path):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    text = (copy / "summary.csv").read_text(encoding="utf-8")
    (copy / "summary.csv").write_text("".join(text.splitlines(True)[:-1]), encoding="utf-8")
    (copy / "junit.xml").write_bytes(b"<testsuites>")
    pd.read_csv(copy / "deposit.csv")[:-1].to_csv(copy / "deposit.csv", index=False)
    reseal(copy, "MAIN.gcode")
    said = failed(copy, made)["tables"]
    assert said.value == 3.0
    assert "junit.xml: cannot be read: " in said.text
    assert f"summary.csv: line {text.count(chr(10))}: recorded ''" in said.text
    assert "deposit.csv: 2 rows" in said.text


def test_the_layout_of_xml_does_not_count_and_reports_of_another_version_are_not_compared(made, tmp_path):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    put(copy / "junit.xml", "<testsuite ", "\n\n   <testsuite ")
    reseal(copy, "MAIN.gcode")
    assert failed(copy, made) == {}
    put(copy / "run.json", f'"ebamcheck": "{__version__}"', '"ebamcheck": "0.0.1"')
    reseal(copy, "MAIN.gcode")
    said = {check.name: check for check in verify_run(copy, made / "cube.stl")}["tables"]
    assert said.passed
    assert f"junit.xml was not compared: the run is of version 0.0.1, this is {__version__}" in said.text


def test_a_cross_check_has_tables_too(made):
    checks = {check.name: check for check in verify_run(made / "check", made / "cube.stl")}
    assert checks["tables"].passed
    said = "compare.csv, compare.parquet, junit.xml, layers.csv, summary.csv are those that follow"
    assert checks["tables"].text.startswith(said)
