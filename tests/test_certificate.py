"""Verification from text and part alone: the certificate, and faults that are found without the plan."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from command_line import write_stl
from finished_runs import FOUR_MM, certified_plate
from parts import box
from slicers_here import slicers_here

from ebamcheck.errors import InputError
from ebamcheck.json_values import sha256_of_file, write_json
from ebamcheck.pipeline import run_job
from ebamcheck.pipeline.cross_check import witness_backend
from ebamcheck.plugins import registry
from ebamcheck.record.certificate import CERTIFICATE, RELEASE, read_certificate
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.verification.verify import settings_beside, verify, verify_against_part
from ebamcheck_reports import html

MAIN, SECOND = "MAIN.MPF", "MAIN_L0002.SPF"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A finished run of a plate with a hole, with its certificate, and the part's file."""
    return certified_plate(tmp_path_factory)


@pytest.fixture
def copy(made, tmp_path):
    """A copy of the run and the part, to spoil."""
    shutil.copytree(made[0], tmp_path / "copy.run")
    shutil.copy(made[1], tmp_path / "frame.stl")
    return RunFolder(tmp_path / "copy.run"), tmp_path / "frame.stl"


def failures(run, part, settings=FOUR_MM):
    checks = verify_against_part(run.path / "program" / MAIN, part, settings)
    return {c.name: c for c in checks if not c.passed}


def test_an_untouched_program_passes_every_check(copy):
    run, part = copy
    checks = verify_against_part(run.path / "program" / MAIN, part, FOUR_MM)
    assert [c for c in checks if not c.passed] == []
    assert {"certificate seal", "section", "smooth section", "coverage", "hatch spacing"} <= {
        c.name for c in checks
    }


def test_the_certificate_says_what_was_made_from_what(copy):
    run, part = copy
    found = read_certificate(run.path / CERTIFICATE)
    assert found["part"]["sha256"] == sha256_of_file(part)
    assert found["part"]["units"] == "mm"
    for file in found["programs"]:
        assert sha256_of_file(run.path / "program" / file["name"]) == file["sha256"]
    assert found["validated"] is True
    assert [gate["name"] for gate in found["gates"]] == [
        "input", "agreement", "fit", "coverage", "deposit", "heat", "program",
    ]  # fmt: skip
    for check in found["checks"]:
        assert {
            "name",
            "passed",
            "value",
            "limit",
            "unit",
            "where",
            "text",
            "layer",
            "x_mm",
            "y_mm",
            "place",
            "remedy",
        } == set(check)
    assert {"path", "metal", "interpass temperature"} & {c["name"] for c in found["checks"]}
    assert found["release"] == RELEASE
    assert found["smoothing"]["tolerance_mm"] == FOUR_MM.machine.smoothing_tolerance_mm
    assert found["not_proved"]


def test_it_tells_the_whole_toolchain(copy):
    made_by = read_certificate(copy[0].path / CERTIFICATE)["software"]
    # What is required by what is required counts, too: llvmlite comes with numba.
    assert {"numpy", "numba", "llvmlite", "shapely", "manifold3d"} <= set(made_by["dependencies"])
    assert made_by["dependencies"]["numpy"] == np.__version__
    assert re.fullmatch(r"([0-9a-f]{40})?", made_by["source"]["commit"])
    assert made_by["source"]["dirty"] in ("yes", "no", "unknown")
    assert re.fullmatch(r"[0-9a-f]{64}", made_by["source"]["sha256"])
    assert set(made_by["backends"]) == {"planecut", "manifold"}
    assert "Linux" in made_by["system"]


def test_it_lists_every_file_of_the_run(copy):
    run, _ = copy
    listed = read_certificate(run.path / CERTIFICATE)["files"]
    there = {p.relative_to(run.path).as_posix() for p in run.path.rglob("*") if p.is_file()}
    assert set(listed) == there - {CERTIFICATE}
    assert {"run.json", "report.html", "junit.xml"} <= set(listed)


def test_an_earlier_format_is_refused_with_its_number(copy):
    run, part = copy
    (run.path / CERTIFICATE).write_text('{"format": 1}')
    with pytest.raises(InputError, match="is not a certificate of format 2"):
        failures(run, part)


def test_a_run_of_a_version_without_some_settings_is_shown(copy):
    run, _ = copy
    manifest = run.manifest()
    del manifest["settings"]["process"]["layer_pause_s"]
    del manifest["settings"]["machine"]["layer_pause"]
    del manifest["program"]["totals"]["pause_s"]
    write_json(manifest, run.path / "run.json")
    (run.path / CERTIFICATE).unlink()
    html.write(run)
    page = (run.path / "report.html").read_text()
    assert "cannot be shown" not in page
    assert "time at constant feed" in page


def test_a_changed_byte_is_named(copy):
    run, part = copy
    path = run.path / "program" / SECOND
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"; ISLAND", b"; iSLAND", 1))
    assert failures(run, part)["program unchanged"].where == f"{SECOND}:1"
    path.write_bytes(whole)
    data = bytearray(part.read_bytes())
    data[10] ^= 1
    part.write_bytes(data)
    assert set(failures(run, part)) == {"part unchanged", "header"}


def test_other_settings_are_named(copy):
    run, part = copy
    other = FOUR_MM.changed(slicing={"time_limit_s": 500.0})
    # The header states the hash of all settings; one that no line of it contradicts is told by the certificate alone.
    assert set(failures(run, part, other)) == {"settings unchanged"}
    other = FOUR_MM.changed(machine={"name": "another"})
    assert set(failures(run, part, other)) == {"settings unchanged", "profile unchanged", "header"}


def test_a_program_in_a_run_is_verified_with_the_settings_of_the_run(copy):
    run, part = copy
    assert settings_beside(run.path / "program" / MAIN) == FOUR_MM
    checks = verify(run.path / "program" / MAIN, part)
    assert [c for c in checks if not c.passed] == []


def test_another_exact_backend_than_the_maker_is_the_witness():
    assert witness_backend("planecut") != "planecut"
    assert witness_backend("manifold") != "manifold"
    assert witness_backend("") == witness_backend("planecut")


def test_no_backend_is_asked_for_a_witness_whose_answer_does_not_matter(monkeypatch):
    """A probe may set up a driver or start another program."""
    asked, probe = [], registry.probe
    monkeypatch.setattr(registry, "probe", lambda name: asked.append(name) or probe(name))
    found = witness_backend("planecut")
    exact = [n for n in registry.house_slicers() if n != "planecut" and registry.slicer(n).exact]
    available = [name for name in exact if probe(name).available]
    assert found == max(available, key=lambda name: registry.slicer(name).priority)
    assert min(registry.slicer(name).priority for name in asked) == registry.slicer(found).priority
    assert set(asked) <= set(exact)


# -- faults found without the plan -------------------------------------------------------------------


class Program:
    """Lines of the files, to plant faults in."""

    def __init__(self, folder):
        self.folder = folder

    def lines(self, name=SECOND):
        return (self.folder / name).read_text().split("\n")

    def write(self, lines, name=SECOND):
        (self.folder / name).write_text("\n".join(lines))

    def find(self, pattern, nth=0, name=SECOND):
        return [i for i, line in enumerate(self.lines(name)) if re.search(pattern, line)][nth]

    def replace(self, pattern, new, nth=0, name=SECOND):
        lines, i = self.lines(name), self.find(pattern, nth, name)
        lines[i] = re.sub(pattern, new, lines[i], count=1)
        self.write(lines, name)
        return f"{name}:{i + 1}"


def shifted_ring(p):
    """The first ring of the layer, 0.1 mm along X."""
    lines = p.lines()
    first, last = p.find("RING"), p.find("M61")
    for i in range(first, last):
        lines[i] = re.sub(r"\bX(=?)(-?\d+\.\d+)", lambda m: f"X{m[1]}{float(m[2]) + 0.1:.6f}", lines[i])
        lines[i] = re.sub(r"X\]=\((-?\d+\.\d+)", lambda m: f"X]=({float(m[1]) + 0.1:.6f}", lines[i])
    p.write(lines)
    return f"{SECOND}:"


def doubled_hatch_line(p):
    lines = p.lines()
    begin = next(n for n, line in enumerate(lines) if line.startswith("; ISLAND"))
    plain = [bool(re.search(r"G1 X.*\d$", line)) for line in lines]
    i = next(n for n in range(begin + 1, len(lines)) if plain[n - 1] and plain[n])
    back = lines[i - 1].split(" ", 1)[1].split(" ;")[0].split(" F")[0]
    lines.insert(i + 1, f"{lines[i].split()[0]}1 {back}")
    p.write(lines)
    return f"{SECOND}:{i + 2}"


def duplicated_block(p):
    lines, i = p.lines(), p.find(r"G1 X.*\d$", 12)
    lines.insert(i + 1, lines[i])
    p.write(lines)
    return f"{SECOND}:{i + 2}"


def swapped_layers(p):
    lines = p.lines(MAIN)
    i, j = p.find(" MAIN_L0001$", name=MAIN), p.find(" MAIN_L0002$", name=MAIN)
    lines[i], lines[j] = lines[i].replace("L0001", "L0002"), lines[j].replace("L0002", "L0001")
    p.write(lines, MAIN)
    return f"{MAIN}:{i + 1}"


def dropped(pattern, name, named=None):
    def plant(p):
        lines, i = p.lines(name), p.find(pattern, name=name)
        del lines[i]
        p.write(lines, name)
        return f"{name}:"

    return plant


def wire_left_on(p):
    dropped("M63", SECOND)(p)
    return f"{SECOND}:"


def wrong_encoding(p):
    path = p.folder / SECOND
    path.write_bytes(path.read_text().encode("utf-16"))
    return f"{SECOND}:1"


def carriage_returns(p):
    path = p.folder / SECOND
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    return f"{SECOND}:1"


def truncated(p):
    path = p.folder / SECOND
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b"\n", len(data) // 2) + 1])
    return f"{SECOND}:"


def truncated_within_a_block(p):
    path = p.folder / SECOND
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b" Y", len(data) // 2) + 2])
    return f"{SECOND}:{len(p.lines())}:"


FAULTS = {
    "ring 0.1 mm off": (shifted_ring, "smooth section"),
    "sign flipped": (lambda p: p.replace(r"G1 X(\d)", r"G1 X-\1", 2), "smooth section"),
    "hatch line doubled": (doubled_hatch_line, "lines laid once"),
    "block duplicated": (duplicated_block, "repeated blocks"),
    "layers swapped": (swapped_layers, "layer heights"),
    "layer dropped": (dropped(" MAIN_L0002$", MAIN), "layer count"),
    "beam left on": (dropped("M61", SECOND), "beam"),
    "wire left on": (wire_left_on, "wire"),
    "feed of 0": (lambda p: p.replace("F600", "F0"), "feed"),
    "no M30": (dropped("M30", MAIN), "end of program"),
    "cut off": (truncated, "end of program"),
    "cut off within a block": (truncated_within_a_block, "readable"),
    "unknown word": (lambda p: p.replace("G1 X", "G1 Q5 X", 3), "readable"),
    "comma for a point": (lambda p: p.replace(r"(G1 X-?\d+)\.", r"\1,", 3), "readable"),
    "number repeated": (lambda p: p.replace(r"^N200 ", "N190 "), "block numbers"),
    "carriage returns": (carriage_returns, "line ends"),
    "wrong encoding": (wrong_encoding, "readable"),
    "wrong power": (
        lambda p: (p.replace(r"H2=\S+", "H2=20", 1, "MAIN_L0001.SPF"), "MAIN_L0001.SPF:")[1],
        "power",
    ),
}


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found_from_text_and_part_alone(copy, name):
    run, part = copy
    (run.path / CERTIFICATE).unlink()
    plant, check = FAULTS[name]
    where = plant(Program(run.path / "program"))
    found = failures(run, part)
    assert check in found, {c.name: (c.where, c.text) for c in found.values()}
    assert found[check].where.startswith(where), found[check]


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    """A run of a solid block, which has long hatch lines, without a certificate."""
    folder = tmp_path_factory.mktemp("block")
    path = write_stl(box((0, 0, 0), (90, 70, 8)), folder / "block.stl")
    with slicers_here():
        return run_job(path, folder / "block.run", FOUR_MM).folder.path, path


@pytest.mark.parametrize("nth", [0, 2, 6])
def test_a_missing_hatch_line_is_found_from_text_and_part_alone(block, tmp_path, nth):
    shutil.copytree(block[0], tmp_path / "block.run")
    run = RunFolder(tmp_path / "block.run")
    assert failures(run, block[1]) == {}
    p = Program(run.path / "program")
    lines = p.lines()
    turns = [i for i, line in enumerate(lines) if "; TURN" in line]

    # The turn to a line that another turn follows, and the line: the tool goes straight on to the next. Where a line is
    # under two and a half spacings long, that way covers most of its place, and what stays bare is under the limit of a gap.
    def length(i):
        ends = [re.search(r"X(\S+) Y(\S+)", lines[k]).groups() for k in (i, i + 1)]
        return np.linalg.norm(np.subtract(*np.array(ends, dtype=float)))

    least_mm = 2.5 * FOUR_MM.process.hatch_spacing_mm
    i = [i for i in turns if i + 2 in turns and length(i) > least_mm][nth]
    del lines[i : i + 2]
    p.write(lines)
    found = failures(run, block[1])
    # By the turn that has become too long, or by what it leaves bare, not by its hash alone.
    told = [found[name] for name in ("gaps", "turns", "hatch spacing", "hatch lines") if name in found]
    assert told, {c.name: (c.where, c.text) for c in found.values()}
    assert told[0].where.startswith(f"{SECOND}:")
