"""Feed along the path on a measured surface: where the wire stands at a limit of its feeder, the feed does the rest, and no more."""

import re
import shutil

import numpy as np
import pytest
from command_line import write_stl
from hypothesis import given, settings
from hypothesis import strategies as st
from measured_surfaces import SIZE, level_metal, map_of, surface_of
from parts import box
from program_text import Text

from ebamcheck.checks.metal import deposit
from ebamcheck.checks.value_checks import wire_check
from ebamcheck.live.height_map import figures_of, in_cells
from ebamcheck.live.heights import at_layer_feed, has_room
from ebamcheck.live.making import LayerMaker, Wanted
from ebamcheck.mesh.files import load
from ebamcheck.pipeline import stages
from ebamcheck.program import read_program
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import feed_shares, speed_window, wire_at
from ebamcheck.verification.verify import verify

WANTED = Wanted(2, 3.4, 1.7, "MAIN_K0003R1")
SUB = "MAIN_K0003R1_L0001.SPF"
WINDOWS = {"a least wire that is near": (36.0, 60.0), "little room on both sides": (32.0, 38.0)}


def config_of(window):
    low, high = window
    # By a fixed order: faults are planted in beads that every layer has.
    return Config().changed(process={"wire_speed_min_mm_s": low, "wire_speed_max_mm_s": high}, scan={"order": "raster"})


@pytest.fixture(scope="module")
def paths():
    """Tracks that were planned last for a program, by its folder."""
    return {}


@pytest.fixture(scope="module", params=WINDOWS)
def made(request, tmp_path_factory, paths):
    """A layer on a hump of 0.7 mm with a feeder of a narrow window; the same with the wire alone; folder and judge."""
    folder = tmp_path_factory.mktemp("along")
    part, config = write_stl(box(upper=SIZE), folder / "box.stl"), config_of(WINDOWS[request.param])
    with LayerMaker(load(part), config) as maker:
        metal = level_metal(maker)
        figures = figures_of(
            in_cells(map_of(surface_of(3.4, 0.7, (14.0, 18.0), 5.0)), metal.surface), metal.surface, config
        )
        under = metal.mapped(figures, 1.0)
        laid_out, last = stages.planned_path, []

        def recorded(*given):
            last.append(laid_out(*given))
            return last[-1]

        stages.planned_path = recorded
        try:
            maker.make(WANTED, under, folder / "along" / "program")
        finally:
            stages.planned_path = laid_out
        paths[folder / "along" / "program"] = last[-1]
        along = maker.make(WANTED, under, folder / "along" / "program")
        alone = maker._made(WANTED, under, folder / "alone" / "program", maker.config_of(WANTED, True, along=False))
        sections = maker._slicings[maker.witness].at(along.cut_mm)

        def hump(layer):
            nc = read_program(layer.files.main, layer.config)
            found = deposit(nc, sections, np.array([5.1]), layer.config, stands=under.surface)
            return nc, float(found.layers["high_mm"].iloc[0])

        yield folder, along, hump(along), hump(alone)


def test_the_feed_goes_on_where_the_wire_ends_and_the_surface_gets_flatter(made):
    _, along, (nc, high), (other, high_alone) = made
    assert along.passed, along.why
    process, rows = along.config.process, np.flatnonzero(nc.deposit & nc.wire)
    feed, wire = nc.feed_mm_min[rows] / 60.0, nc.wire_mm_s[rows]
    assert process.feed_along_path
    assert len(np.unique(feed)) > 5
    assert len(np.unique(other.feed_mm_min[other.deposit])) == 1
    low, high_wire = process.wire_speed_min_mm_s, process.wire_speed_max_mm_s
    assert (wire >= low - 1e-6).all()
    assert (wire <= high_wire + 1e-6).all()
    faster, slower = feed > 1.0005 * process.travel_speed_mm_s, feed < 0.9995 * process.travel_speed_mm_s
    assert wire[faster] == pytest.approx(low)
    assert wire[slower] == pytest.approx(high_wire)
    assert faster.any()
    least, most = speed_window(along.config)
    assert (feed <= most * process.travel_speed_mm_s + 1e-6).all()
    assert (feed >= least * process.travel_speed_mm_s - 1e-6).all()
    assert high < 0.75 * high_alone


def test_such_a_layer_verifies_from_its_text(made):
    folder, along, _, _ = made
    checks = verify(folder / "along" / "program", folder / "box.stl", along.config)
    assert all(check.passed for check in checks), [c.in_words() for c in checks if not c.passed]


def fast_block(text):
    """Line of a bead at another feed than that of the process, and its feed."""
    counts = [m[1] for line in text.lines[SUB] if (m := re.search(r"G1 .* F([\d.]+)$", line))]
    usual = max(set(counts), key=counts.count)
    return next(
        (i, float(m[1]))
        for i, line in enumerate(text.lines[SUB])
        if (m := re.search(r"G1 .* F([\d.]+)$", line)) and abs(float(m[1]) / float(usual) - 1.0) > 0.05
    )


def feed_changed(by):
    def plant(text):
        i, feed = fast_block(text)
        text.lines[SUB][i] = re.sub(r" F[\d.]+$", by(feed), text.lines[SUB][i])

    return plant


def wire_not_at_its_limit(text):
    i, _ = fast_block(text)
    before = next(k for k in range(i, 0, -1) if "H3=" in text.lines[SUB][k])
    text.lines[SUB][before] = re.sub(r"H3=[\d.]+", "H3=37.2", text.lines[SUB][before])


def slower_where_wire_has_room(text):
    """Feed and wire down together: the metal is right, and nothing asked for it."""
    lines = text.lines[SUB]
    feeds = [m[1] for line in lines if (m := re.search(r"G1 .* F([\d.]+)$", line))]
    usual, feed, wire, at = max(set(feeds), key=feeds.count), "", 0.0, 0
    for i, line in enumerate(lines):
        if m := re.search(r"H3=([\d.]+)", line):
            wire, at = float(m[1]), i
        if m := re.search(r"G1 X\S+ Y\S+(?: F([\d.]+))?$", line):
            feed = m[1] or feed
            if feed == usual and wire not in (32.0, 36.0, 38.0, 60.0):
                lines[at] = re.sub(r"H3=[\d.]+", f"H3={0.98 * wire:.6f}", lines[at])
                lines[i] = re.sub(r" F[\d.]+$", "", line) + f" F{0.98 * float(usual):.6f}"
                return
    raise AssertionError("no such bead")


FAULTS = {
    "a feed beyond the window": (feed_changed(lambda feed: " F2900"), {"process window"}),
    "wire that is not at its limit": (wire_not_at_its_limit, {"process values"}),
    "slower where the wire has room": (slower_where_wire_has_room, {"process values", "process window"}),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_the_feed_is_found_from_the_text(name, made, tmp_path):
    plant, wanted = FAULTS[name]
    folder, along, _, _ = made
    shutil.copytree(folder / "along" / "program", tmp_path / "program")
    text = Text(tmp_path / "program")
    plant(text)
    text.save()
    checks = verify(tmp_path / "program", folder / "box.stl", along.config)
    failed = {check.name for check in checks if not check.passed}
    assert failed & wanted, failed


@pytest.mark.parametrize("by", [lambda feed: "", lambda feed: f" F{1.3 * feed:.6f}"], ids=["lost", "off"])
def test_a_feed_that_lays_other_metal_than_planned_shuts_the_gate(by, made, paths, tmp_path):
    """Nothing in the text of a layer tells what was measured under it: its maker knows, and the journal has its hash."""
    folder, along, _, _ = made
    shutil.copytree(folder / "along" / "program", tmp_path / "program")
    text = Text(tmp_path / "program")
    path = paths[along.files.folder]
    assert wire_check(read_program(tmp_path / "program", along.config), along.config, path).passed
    feed_changed(by)(text)
    text.save()
    found = wire_check(read_program(tmp_path / "program", along.config), along.config, path)
    assert not found.passed
    assert found.value > 0.04


def test_a_layer_of_one_feed_has_no_other(made, tmp_path):
    """The same text by settings that let no feed change."""
    folder, along, _, _ = made
    config = along.config.changed(process={"feed_along_path": False})
    checks = verify(folder / "along" / "program", folder / "box.stl", config)
    failed = {check.name: check for check in checks if not check.passed}
    assert "in place of" in failed["process values"].text


# -- laws --------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=80)
@given(st.floats(1.0, 400.0), st.floats(0.2, 1.0))
def test_wire_over_feed_stays_within_the_windows(wire, share):
    config = Config().changed(process={"feed_along_path": True})
    feed = feed_shares(np.array([wire]), config, share)
    laid = wire_at(np.array([wire]), feed, config)
    low, high = speed_window(config, share)
    assert min(low, 1.0) - 1e-9 <= feed[0] <= max(high, 1.0) + 1e-6
    process = config.process
    if process.wire_speed_min_mm_s <= wire <= process.wire_speed_max_mm_s:
        assert feed[0] == 1.0
    if 1.001 * low < feed[0] < 0.999 * high:
        assert laid[0] / feed[0] == pytest.approx(wire, rel=1e-4)
        assert process.wire_speed_min_mm_s - 1e-9 <= laid[0] <= process.wire_speed_max_mm_s + 1e-9


def test_it_is_asked_for_where_one_feed_leaves_too_little_room_and_nowhere_else():
    narrow, wide = config_of((32.0, 38.0)), Config()
    assert has_room(at_layer_feed(wide, 1.7, True), 1.7)
    assert not at_layer_feed(wide, 1.7, True).process.feed_along_path
    assert at_layer_feed(narrow, 1.7, True).process.feed_along_path
    assert not at_layer_feed(narrow, 1.7).process.feed_along_path
    assert not at_layer_feed(narrow, 1.7, True, along=False).process.feed_along_path
    # Off, nothing of it is in the hash of the settings.
    assert "feed_along_path" not in wide.model_dump()["process"]
