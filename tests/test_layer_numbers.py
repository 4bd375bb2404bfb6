"""One layer has one number, counted from 1, wherever a person reads or types it: that of its program's file."""

from __future__ import annotations

import json
import re
import shutil

import pandas as pd
import pytest
from command_line import ebamcheck
from live_boxes import maker_of, play, run_of_box

from ebamcheck.errors import InputError
from ebamcheck.json_values import write_json
from ebamcheck.live.building import Building
from ebamcheck.live.heights_table import TABLE, read_heights
from ebamcheck.live.publishing import (
    CERTIFICATE,
    JOURNAL,
    LAYERS,
    Journal,
    read_certificate,
    read_current,
    read_journal,
)
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.settings.checking import values_as_toml
from ebamcheck.settings.config import Config
from ebamcheck.testing.played_control.program import Growth
from ebamcheck.verification.verify import verify

SIZE, COUNT = (30, 24, 12), 7

TABLES = ("layers.csv", "compare.csv", "deposit.csv", "process.csv", "program.csv", "fit.csv", "scan.csv")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with a run of a box of seven layers."""
    return run_of_box(tmp_path_factory, SIZE)


@pytest.fixture(scope="module")
def maker(place):
    with maker_of(place) as made:
        yield made


# -- a run -------------------------------------------------------------------------------------------


def test_every_number_that_a_run_tells_is_that_of_one_of_its_layers(place):
    told = [
        int(number)
        for file in (place / "box.run").iterdir()
        if file.suffix in (".json", ".html", ".xml", ".csv")
        for number in re.findall(r"(?i)\blayer (\d+)\b(?!\.\d)", file.read_text(encoding="utf-8"))
    ]
    assert len(told) > 20
    assert set(told) <= set(range(1, COUNT + 1))
    record = json.loads((place / "box.run" / "run.json").read_text())
    of_checks = {check["layer"] for check in record["program"]["checks"]} - {None}
    assert of_checks
    assert of_checks <= set(range(1, COUNT + 1))


@pytest.mark.parametrize("name", TABLES)
def test_a_table_of_a_run_names_the_layers_as_the_program_does(place, name):
    table = pd.read_csv(place / "box.run" / name)
    assert sorted(set(table["layer"])) == list(range(1, COUNT + 1))
    if name == "program.csv":
        assert table["file"].tolist() == [f"MAIN_L{number:04d}.SPF" for number in table["layer"]]
    if name == "compare.csv":
        twin = pd.read_parquet(place / "box.run" / "compare.parquet")
        assert twin["layer"].tolist() == table["layer"].tolist()


def test_columns_for_programs_hold_indices(place):
    events = pd.read_parquet(place / "box.run" / "events.parquet")
    assert sorted(set(events["layer"])) == list(range(COUNT))


@pytest.mark.parametrize("number", [1, 4, COUNT])
def test_a_fault_in_a_layer_is_told_by_the_number_of_its_file(place, tmp_path, number):
    program = shutil.copytree(place / "box.run" / "program", tmp_path / "program")
    file = program / f"MAIN_L{number:04d}.SPF"
    lines = file.read_text().split("\n")
    k = [i for i, line in enumerate(lines) if re.search(r" G1 .*X", line)][3]
    lines[k] = re.sub(r"([XY])(-?[\d.]+)", lambda word: f"{word[1]}{float(word[2]) + 3.0:.6f}", lines[k])
    file.write_text("\n".join(lines))
    config = Config.model_validate(RunFolder(place / "box.run").manifest()["settings"])
    (tmp_path / "settings.toml").write_text(values_as_toml(config))
    at = f"{file.name}:{k + 1}"
    failed = {c.name: c for c in verify(program, place / "box.stl", config) if not c.passed and c.where == at}
    assert "section" in failed
    assert f", in layer {number} at (" in failed["section"].text
    assert {check.layer for check in failed.values()} <= {None, number - 1}
    settings = ("-c", tmp_path / "settings.toml")
    told = ebamcheck("verify", program, "--part", place / "box.stl", *settings, "--json", cwd=tmp_path)
    numbers = {check["name"]: check["layer"] for check in json.loads(told.stdout)}
    assert numbers["section"] == number
    assert {numbers[name] for name in failed} <= {None, number}


def test_the_report_draws_the_layer_that_a_check_names(place, tmp_path):
    program_pictures = pytest.importorskip("ebamcheck_reports.program_pictures")
    from ebamcheck_reports.run_data import RunData

    run = shutil.copytree(place / "box.run", tmp_path / "box.run")
    record = json.loads((run / "run.json").read_text())
    check = record["program"]["checks"][0]
    check |= {"passed": False, "layer": COUNT, "x_mm": 1.0, "y_mm": 2.0, "where": f"MAIN_L{COUNT:04d}.SPF:9"}
    write_json(record, run / "run.json")
    (drawn,) = program_pictures.failed_checks(RunData(RunFolder(run)))[1:]
    assert f", layer {COUNT}, MAIN_L{COUNT:04d}.SPF:9." in str(drawn)


def test_a_record_that_counts_layers_from_0_is_refused(place, tmp_path):
    run = shutil.copytree(place / "box.run", tmp_path / "box.run")
    record = json.loads((run / "run.json").read_text())
    write_json({**record, "format": 1}, run / "run.json")
    done = ebamcheck("verify", run, "--part", place / "box.stl", cwd=tmp_path)
    assert done.returncode == 2
    assert "is not a run of format 2: make it again" in done.stderr
    assert done.stderr.count("\n") == 1


# -- a build -----------------------------------------------------------------------------------------


def test_a_layer_of_a_build_has_one_number_wherever_it_is_named(place, maker, tmp_path):
    folder = tmp_path / "b"
    building = Building(maker, folder)

    def tell(event, **message):
        return building.start() if event == "start" else building.height(message)

    answers = play(tell, folder, Growth(0.05), most_layers=3)
    building.close()
    assert [answer["layer"] for answer in answers] == [1, 2, 3, 4]
    assert read_heights(folder / TABLE)["layer"].tolist() == [1, 2, 3]
    names = [entry["name"] for entry in read_journal(folder / JOURNAL) if entry["kind"] == "layer"]
    assert [re.search(r"_K(\d{4})R\d$", name)[1] for name in names] == ["0001", "0002", "0003", "0004"]
    assert [read_certificate(folder / LAYERS / name)["layer"] for name in names] == [1, 2, 3, 4]
    assert (read_current(folder)["layer"], read_current(folder)["name"]) == (4, names[-1])
    # One that is made by itself: the option is the number, too.
    base_mm = answers[2]["base_mm"]
    done = ebamcheck(
        "relayer",
        place / "box.run",
        "--layer",
        3,
        "--measured-z",
        base_mm,
        "-o",
        tmp_path / "o",
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith(f"layer 3: Z {base_mm:.3f}")
    (made,) = (tmp_path / "o" / LAYERS).iterdir()
    assert made.name == "MAIN_K0003R1"
    assert read_certificate(made)["layer"] == 3


def test_a_certificate_and_a_journal_that_count_from_0_are_refused(place, maker, tmp_path):
    folder = tmp_path / "b"
    building = Building(maker, folder)
    name = building.start()["name"]
    building.close()
    paper = folder / LAYERS / name / CERTIFICATE
    found = json.loads(paper.read_text())
    write_json({**found, "format": "ebamcheck layer 1", "layer": 0}, paper)
    done = ebamcheck("verify", folder, "--part", place / "box.stl", cwd=tmp_path)
    assert done.returncode == 1
    assert "layer.json: is of the format 'ebamcheck layer 1', not 'ebamcheck layer 2'" in done.stdout
    entries = list(read_journal(folder / JOURNAL))
    with Journal(tmp_path / "old" / JOURNAL) as journal:
        for entry in entries:
            journal.append({key: value for key, value in entry.items() if key not in ("after", "format")})
    with pytest.raises(InputError, match="earlier version of ebamcheck, which counted layers from 0"):
        Building(maker, tmp_path / "old")
