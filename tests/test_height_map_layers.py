"""Layers on measured surfaces: wire that follows them, and maps that come by the command and by the server's lines."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import ebamcheck
from live_boxes import failed_checks, made_again
from measured_surfaces import SIZE as SIZE
from measured_surfaces import level_metal, map_of, surface_of, write_csv
from slicers_here import runs_cut_here as runs_cut_here

from ebamcheck.checks.metal import deposit
from ebamcheck.live.building import Building, answer_to
from ebamcheck.live.height_map import figures_of, in_cells
from ebamcheck.live.making import Wanted
from ebamcheck.live.publishing import LAYERS, read_current, read_journal
from ebamcheck.program import read_program


@pytest.fixture(scope="module")
def metal(maker):
    return level_metal(maker)


def laid_on(maker, metal, z, tmp_path, mended):
    """A layer made on a surface, as far as a maker knows it; its program, and what it comes to on the true surface."""
    cells = in_cells(map_of(z), metal.surface)
    figures = figures_of(cells, metal.surface, maker.config)
    wanted = Wanted(2, 3.4, 1.7, "MAIN_K0003R1")
    under = metal if mended is None else metal.mapped(figures, mended)
    made = maker.make(wanted, under, tmp_path / f"{mended}" / "p")
    assert made.passed, made.why
    program = read_program(made.files.main, made.config)
    sections = maker._slicings[maker.witness].at(made.cut_mm)
    truth = metal.mapped(figures, 1.0).surface
    return program, deposit(program, sections, np.array([5.1]), made.config, stands=truth), made


def test_wire_follows_the_local_thickness_along_the_beads_and_the_surface_gets_flatter(maker, metal, tmp_path):
    z = surface_of(3.4, 0.7, (14.0, 18.0), 5.0)
    known, true_known, made = laid_on(maker, metal, z, tmp_path, 1.0)
    blind, true_blind, _ = laid_on(maker, metal, z, tmp_path, None)

    def wire_at(program, x, y, radius=4.0):
        rows = np.flatnonzero(program.deposit & program.wire)
        row, places = program.samples(rows, 0.5)
        near = np.hypot(places[:, 0] - x, places[:, 1] - y) < radius
        return float(np.mean(program.wire_mm_s[row[near]] / program.feed_mm_min[row[near]]))

    # On the hump there is less room: less wire, by up to the fifth that a layer may be thinner; and more around it.
    assert 0.75 < wire_at(known, 14.0, 18.0) / wire_at(blind, 14.0, 18.0) < 0.9
    assert wire_at(known, 34.0, 28.0) > wire_at(blind, 34.0, 28.0)
    # Along one hatch line it changes, too.
    lines = np.flatnonzero(known.deposit & known.wire)
    assert len(np.unique(known.wire_mm_s[lines])) > 1.5 * len(np.unique(blind.wire_mm_s[blind.deposit & blind.wire]))
    process = maker.config.process
    assert (known.wire_mm_s[lines] <= process.wire_speed_max_mm_s + 1e-9).all()
    assert (known.wire_mm_s[lines] >= process.wire_speed_min_mm_s - 1e-9).all()
    off = [max(t.layers["high_mm"].iloc[0], t.layers["low_mm"].iloc[0]) for t in (true_known, true_blind)]
    assert off[0] < 0.8 * off[1]
    # The mass stays that of the layer: metal is moved, and none is made.
    assert true_known.layers["laid_mm3"].iloc[0] == pytest.approx(true_blind.layers["laid_mm3"].iloc[0], rel=0.04)
    assert made.after.surface is not None
    assert not made.after.surface.mapped


def test_a_level_map_changes_nothing_but_the_height(maker, metal, tmp_path):
    known, _, _ = laid_on(maker, metal, surface_of(3.4), tmp_path, 0.3)
    blind, _, _ = laid_on(maker, metal, surface_of(3.4), tmp_path, None)
    total = [float((p.wire_mm_s * p.lengths / p.feed_mm_min)[p.deposit & p.wire].sum()) for p in (known, blind)]
    assert total[0] == pytest.approx(total[1], rel=0.01)


def test_relayer_takes_a_map_for_the_height_and_the_layer_verifies_from_its_text(place, tmp_path):
    write_csv(tmp_path / "m.csv", surface_of(3.45, 0.5))
    done = ebamcheck(
        "relayer", place / "box.run", "--layer", 3, "--height-map", "m.csv", "-o", "o", "--json", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["height_map"]["mended"] in (1.0, 0.6, 0.3)
    assert told["base_mm"] == pytest.approx(told["height_map"]["mean_mm"], abs=1e-6)
    assert 3.45 < told["base_mm"] < 3.6
    folder = tmp_path / "o" / LAYERS / told["name"]
    assert failed_checks(folder, place / "box.stl") == []
    assert json.loads((folder / "layer.json").read_text())["height_map"] == told["height_map"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--layer", 3), "give --measured-z or --height-map"),
        (("--layer", 3, "--measured-z", 3.4, "--height-map", "m.csv"), "give --measured-z or --height-map"),
        (("--layer", 1, "--height-map", "m.csv"), "on the plate give --measured-z"),
        (("--layer", 3, "--height-map", "m.csv", "--direction", "0,0,1"), "does not go with --direction"),
        (("--layer", 3, "--height-map", "no.csv"), "cannot be read"),
        (("--layer", 3, "--height-map", "m.csv"), "over its mean of"),
        (("--layer", 3, "--height-map", "far.csv"), "knows 0 % of the layer"),
    ],
)
def test_relayer_says_what_is_wrong_with_a_map(arguments, said, place, tmp_path):
    write_csv(tmp_path / "m.csv", surface_of(3.4, 2.5))
    (tmp_path / "far.csv").write_text("x_mm,y_mm,height_mm\n500,500,3.4\n501,500,3.4\n500,501,3.4\n")
    done = ebamcheck("relayer", place / "box.run", *arguments, "-o", "o", cwd=tmp_path)
    assert done.returncode == 2, done.stdout
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "o" / LAYERS).exists()


# -- the door ----------------------------------------------------------------------------------------


def ask(building, **message):
    return answer_to(building, json.dumps(message).encode())


def test_maps_come_through_the_door_and_the_journal_makes_them_again(maker, tmp_path):
    building = Building(maker, tmp_path / "b")
    try:
        early = ask(building, event="height", done=1, height_map="m.csv")
        assert (early["answer"], early["code"]) == ("refused", "not-started")
        first = ask(building, event="start")
        top = first["thickness_mm"]
        path = str(write_csv(tmp_path / "m.csv", surface_of(top, 0.6)))
        before = read_current(tmp_path / "b")
        wrong = {
            "map": [{"height_map": 3}, {"height_map": "no.csv"}, {"height_map": path, "height_mm": 3.0}, {"height_map": "a\0"}],
            "missing": [{"height_map": path, "done": None}],
            "unit": [{"height_map": path, "unit": "in"}],
            "counter-jump": [{"height_map": path, "done": 4}],
            "map-uneven": [{"height_map": str(write_csv(tmp_path / "u.csv", surface_of(top, 3.0)))}],
            "map-holes": [{"height_map": str(write_csv(tmp_path / "h.csv", surface_of(top), lambda x, y: x > 12))}],
            "absurd": [{"height_map": str(write_csv(tmp_path / "a.csv", surface_of(top + 90.0)))}],
        }  # fmt: skip
        for code, messages in wrong.items():
            for message in messages:
                answer = ask(building, **{"event": "height", "done": 1, **message})
                assert (answer["answer"], answer["code"]) == ("refused", code), answer
                assert "\n" not in answer["reason"]
        assert read_current(tmp_path / "b") == before
        answer = ask(building, event="height", done=1, height_map=path)
        assert answer["answer"] == "published", answer
        assert answer["height_map"]["hump_mm"] > 0.2
        assert answer["base_mm"] == pytest.approx(answer["height_map"]["mean_mm"], abs=1e-6)
        again = ask(building, event="height", done=1, height_map=path)
        assert again["again"]
        other = ask(
            building,
            event="height",
            done=1,
            height_map=str(write_csv(tmp_path / "o.csv", surface_of(top + 0.1))),
        )
        assert other["code"] == "repeated"
        plain = ask(building, event="height", done=2, height_mm=answer["base_mm"] + answer["thickness_mm"])
        assert plain["answer"] == "published", plain
    finally:
        building.close()
    # The journal alone is enough: the files of the maps are gone.
    for name in ("m.csv", "o.csv", "u.csv"):
        (tmp_path / name).unlink()
    assert made_again(maker, tmp_path / "b", tmp_path / "again")
    entries = list(read_journal(tmp_path / "b" / "journal.jsonl"))
    assert sum("map" in entry for entry in entries) == 1
