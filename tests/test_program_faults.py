"""Planted faults: each is found by the check that is meant for it, at the line where it was planted."""

from __future__ import annotations

import re

import pytest
from nc_stack import REACHES_OUT, stack
from planted_faults import FAULTS, FIRST, MAIN, SECOND, planted, swapped_intervals

from ebamcheck.program import verify_file, write_program
from ebamcheck.settings.config import Config


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found_where_it_was_planted(name, tmp_path):
    plant, check = FAULTS[name]
    found, where = planted(tmp_path, plant)
    assert check in found, f"only {sorted(found)} failed"
    assert found[check].where.startswith(where)
    assert found[check].text


def test_flipped_sign_of_any_coordinate_is_found(tmp_path):
    config = Config()
    curves, plan = stack(count=1)
    files = write_program(curves, plan, config, tmp_path / "program")
    path = files.folder / FIRST
    whole = path.read_text()
    numbers = [m for m in re.finditer(r"-?\d+\.\d{6}", whole) if float(m[0])]
    for match in numbers[3::5]:
        flipped = match[0][1:] if match[0].startswith("-") else f"-{match[0]}"
        path.write_text(whole[: match.start()] + flipped + whole[match.end() :])
        line = whole.count("\n", 0, match.start()) + 1
        failed = [c for c in verify_file(files.main, config=config, curves=curves, plan=plan) if not c.passed]
        block = whole.split("\n")[line - 1]
        if block.startswith(";") or (abs(2 * float(match[0])) < 1e-3):
            continue
        assert failed, block
        places = [int(c.where.rsplit(":")[1]) for c in failed if c.where.startswith(FIRST)]
        # The end of one block is the start of the next: a travel is named at the deposit that it leads to.
        assert any(line <= place <= line + 5 for place in places), (block, failed)


@pytest.mark.parametrize("shift", [2, 3])
def test_swapped_intervals_of_a_spline_are_found(shift, tmp_path):
    machine = {"curve_form": "bspline", "bspline_shift": shift}
    found, (i, j) = planted(tmp_path, swapped_intervals, machine)
    line = int(found["contour path"].where.removeprefix(f"{FIRST}:"))
    # An interval shapes the spans of the control points around it.
    assert i + 1 - 3 <= line <= j + 1 + 3


def test_an_end_interval_moved_inwards_is_refused_with_its_line(tmp_path):
    def plant(text):
        i = text.find(FIRST, "BSPLINE") + 1
        lines = text.lines[FIRST]
        a, b = (lines[k].rsplit("PL=", 1) for k in (i, i + 1))
        lines[i], lines[i + 1] = f"{a[0]}PL={b[1]}", f"{b[0]}PL={a[1]}"
        return f"{FIRST}:{i + 1}"

    found, where = planted(tmp_path, plant, {"curve_form": "bspline"})
    assert found["readable"].where.startswith(where)
    assert "convention s=2" in found["readable"].text


def test_a_spline_of_too_few_blocks_is_found(tmp_path):
    def plant(text):
        lines = text.lines[FIRST]
        i = text.find(FIRST, "BSPLINE", nth=1) + 1
        assert "PL" in lines[i + 5]
        del lines[i + 2 : i + 4]
        return f"{FIRST}:{i + 1}"

    found, where = planted(tmp_path, plant, {"curve_form": "bspline"})
    assert found["spline blocks"].where == where


@pytest.fixture
def program(tmp_path):
    config = Config()
    curves, plan = stack()
    files = write_program(curves, plan, config, tmp_path / "program")

    def failures():
        checks = verify_file(files.main, config=config, curves=curves, plan=plan, sha256=files.sha256)
        return {c.name: c for c in checks if not c.passed and c.name != REACHES_OUT}

    assert failures() == {}
    return files, failures


def test_carriage_returns_are_found(program):
    files, failures = program
    path = files.folder / SECOND
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert failures()["line ends"].where == f"{SECOND}:1"
    path.write_bytes(path.read_bytes().replace(b"\r\n", b"\n").replace(b"N50 ", b"N50\r ", 1))
    assert "line ends" in failures() or "readable" in failures()


def test_a_letter_that_is_not_ascii_is_found(program):
    files, failures = program
    path = files.folder / SECOND
    lines = path.read_bytes().split(b"\n")
    lines[3] += " für".encode()
    path.write_bytes(b"\n".join(lines))
    assert failures()["encoding"].where == f"{SECOND}:4"


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "utf-16-le"])
def test_a_wrong_encoding_is_found(program, encoding):
    files, failures = program
    path = files.folder / SECOND
    path.write_bytes(path.read_text().encode(encoding))
    found = failures()
    assert found["readable"].where.startswith(f"{SECOND}:1")


@pytest.mark.in_turn(2, first=1)
@pytest.mark.parametrize("name", [MAIN, SECOND])
def test_any_changed_byte_is_found(program, name):
    files, failures = program
    path = files.folder / name
    whole = path.read_bytes()
    for place in range(40, len(whole), max(1, len(whole) // 12)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        found = failures()
        assert "readable" in found or found["unchanged"].where == f"{name}:1"
    path.write_bytes(whole)
    assert failures() == {}


def test_a_byte_that_moves_the_path_is_named_by_its_line(program):
    files, failures = program
    path = files.folder / SECOND
    lines = path.read_text().split("\n")
    i = next(n for n, line in enumerate(lines) if "PO[Y]" in line)
    lines[i] = re.sub(r"(PO\[Y\]=\(-?\d+\.\d)(\d)", lambda m: f"{m[1]}{(int(m[2]) + 1) % 10}", lines[i])
    path.write_text("\n".join(lines))
    assert failures()["contour path"].where == f"{SECOND}:{i + 1}"


def test_a_missing_status_or_extra_file_does_not_pass(program):
    files, failures = program
    (files.folder / "MAIN_L0099.SPF").write_text("M17\n")
    found = failures()["subprograms"]
    assert "MAIN_L0099.SPF is never called" in found.text
    assert found.where.startswith(f"{MAIN}:")
