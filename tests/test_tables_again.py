"""Tables and reports of a run, of which figures were edited and all hashes made anew: they are worked out again."""

from __future__ import annotations

import json
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
from ebamcheck.errors import InputError
from ebamcheck.json_values import write_json
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
        "curves.parquet",
        "deposit.csv",
        "deposit_worst.parquet",
        "events.parquet",
        "fit.csv",
        "junit.xml",
        "kinematics.csv",
        "layers.csv",
        "process.csv",
        "program.csv",
        "summary.csv",
    ):
        assert name in said
    assert by_hash == "report.html"


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


@pytest.mark.parametrize(
    ("name", "column"),
    [("curves.parquet", "x"), ("deposit_worst.parquet", "laid_mm"), ("curves.parquet", None)],
)
def test_edited_curves_and_metal_are_found_though_all_hashes_are_made_anew(made, tmp_path, name, column):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    table = pq.read_table(copy / name)
    if column is None:
        table = table.replace_schema_metadata({**table.schema.metadata, b"ebamcheck.curves.labels": b"{}"})
    else:
        values = table.column(column).combine_chunks()
        flat = values.flatten() if pa.types.is_large_list(values.type) else values
        numbers = flat.to_numpy().copy()
        numbers[-1] += 1e-3
        other = pa.array(numbers)
        if flat is not values:
            other = pa.LargeListArray.from_arrays(values.offsets, other)
        table = table.set_column(table.column_names.index(column), column, other)
    pq.write_table(table, copy / name)
    reseal(copy, "MAIN.gcode")
    failed = {check.name: check for check in verify_run(copy, made / "cube.stl") if not check.passed}
    assert set(failed) == {"tables"}
    assert failed["tables"].text.startswith(f"{name}: ")
    assert (column or "what it says of itself") in failed["tables"].text


def put(path, old, new):
    """Replace the first place of some text in a file."""
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


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
    failed = {check.name: check for check in verify_run(copy, made / "cube.stl") if not check.passed}
    assert set(failed) == {"tables"}
    assert failed["tables"].text.startswith(f"{name}: line ")
    assert told in failed["tables"].text.partition(", found ")[0]


def test_a_report_of_which_lines_were_taken_out_or_that_is_none_is_found(made, tmp_path):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    text = (copy / "summary.csv").read_text(encoding="utf-8")
    (copy / "summary.csv").write_text("".join(text.splitlines(True)[:-1]), encoding="utf-8")
    (copy / "junit.xml").write_bytes(b"<testsuites>")
    reseal(copy, "MAIN.gcode")
    said = of_tables(made, copy)["tables"]
    assert said.value == 2.0
    assert "junit.xml: cannot be read: " in said.text
    assert f"summary.csv: line {text.count(chr(10))}: recorded ''" in said.text


def test_the_layout_of_xml_does_not_count(made, tmp_path):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    put(copy / "junit.xml", "<testsuite ", "\n\n   <testsuite ")
    reseal(copy, "MAIN.gcode")
    assert of_tables(made, copy)["tables"].passed


def test_reports_of_another_version_are_not_compared_and_that_is_said(made, tmp_path):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    put(copy / "run.json", f'"ebamcheck": "{__version__}"', '"ebamcheck": "0.0.1"')
    reseal(copy, "MAIN.gcode")
    said = of_tables(made, copy)["tables"]
    assert said.passed
    assert f"junit.xml was not compared: the run is of version 0.0.1, this is {__version__}" in said.text


def test_a_record_of_which_no_report_can_be_made_is_told(made, tmp_path):
    copy = shutil.copytree(made / "check", tmp_path / "check")
    record = json.loads((copy / "run.json").read_text(encoding="utf-8"))
    record["comparison"]["pairs"] = [7]
    write_json(record, copy / "run.json")
    with pytest.raises(InputError, match=r"run\.json: is not whole: comparison\.pairs\.0: "):
        of_tables(made, copy)


def test_the_metal_of_a_program_is_laid_once(made, monkeypatch):
    def again(*_, **__):
        raise AssertionError("laid a second time")

    monkeypatch.setattr(subject, "deposit", again)
    assert all(check.passed for check in verify_run(made / "run", made / "cube.stl"))


def test_a_row_that_was_taken_out_is_found(made, tmp_path):
    copy = shutil.copytree(made / "run", tmp_path / "run")
    pd.read_csv(copy / "deposit.csv")[:-1].to_csv(copy / "deposit.csv", index=False)
    reseal(copy, "MAIN.gcode")
    assert "2 rows" in of_tables(made, copy)["tables"].text


def test_a_cross_check_has_tables_too(made):
    checks = of_tables(made, made / "check")
    assert checks["tables"].passed
    said = "compare.csv, compare.parquet, junit.xml, layers.csv, summary.csv are those that follow"
    assert checks["tables"].text.startswith(said)
