"""Limits of the checks of heat, of preheating, and of programs that begin or end elsewhere, each just inside and just outside."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import shapely
from limit_cases import HIGH_MM, Case, Subject, _folder, cube, downwards, program_of, upwards
from prism_program import Made

from ebamcheck.checks.interpass_checks import PAUSE, sections_of, text_beads, text_bed_k, text_shapes
from ebamcheck.checks.text_checks import entry_check
from ebamcheck.layers.stack import from_polygons
from ebamcheck.program import Check
from ebamcheck.settings.config import Config

HEAT = ("layers", "heat")
AMBIENT_K = 293.15


@cache
def wide(mm: float) -> Subject:
    """The beads of the cube on wider sections, which take up more heat."""
    heights = cube().known["plan"].heights
    return cube().given(layers=from_polygons(heights, [[shapely.box(0, 0, mm, mm)]] * len(heights)))


def rise_k(name: str, mm: float) -> float:
    """Rise of the temperature that a balance finds, over the chamber."""
    return wide(mm).checks(*HEAT)[name].value - AMBIENT_K


def limited(f: float) -> Subject:
    """A limit over which the hottest entry, 933 K over the chamber, comes by so much."""
    return wide(90.0).by(process={"interpass_limit_k": AMBIENT_K + 933.0 / f})


def differing(f: float, mm: float, share: float, least_k: float) -> Subject:
    """A limit under the second balance: both may differ by a tenth of the limit's rise, or by 60 K."""
    rise = rise_k("balance of the heat", mm)
    limit = rise / (1.0 + f * share) if share else rise - f * least_k
    assert (limit > 600.0) == bool(share)
    return wide(mm).by(process={"interpass_limit_k": AMBIENT_K + limit})


@cache
def weaker(mm: float, layer: int) -> tuple[Subject, float]:
    """One layer with four fifths of the power, and how warm it is: as it would be with a hundredth of the power more."""
    subject = wide(mm).with_columns(cube().of_layer(layer), power_w=0.8 * 7200.0)
    beads = text_beads(subject.nc, subject.config)
    sections = sections_of(subject.known["layers"])
    shapes = text_shapes(subject.nc, subject.config, sections)
    bed_k, _ = text_bed_k(beads, subject.config, shapes, lowest=sections[0])
    return subject, float(bed_k[beads.layer == layer].max() - AMBIENT_K) * 0.81 / 0.8


def with_room(f: float, mm: float, layer: int, share: float, least_k: float) -> Subject:
    """A limit far over a weaker layer: under 0.85 of its rise, and under 80 K less, there is room for all of the power."""
    subject, rise = weaker(mm, layer)
    limit = f * rise / share if share else rise + f * least_k
    assert (0.85 * limit < limit - 80.0) == bool(share)
    return subject.by(process={"interpass": "both", "interpass_limit_k": AMBIENT_K + limit})


def melting(f: float) -> Subject:
    """The bead with the most wire lacks so much of the power that melts this, and what it remelts."""
    needed = 7200.0 / cube().checks(*HEAT)["melting power"].value
    row = cube().metal[np.argmax(cube().nc.wire_mm_s[cube().metal])]
    return cube().with_columns(row, power_w=needed * (1.0 - f * 1e-3))


def hot_behind_the_first(f: float) -> Subject:
    """One layer on the cold plate: only beads behind its first one are entered warm, the last 317 K over the chamber."""
    lines = [[(0.0, 4.32 * i), (60.0, 4.32 * i)] for i in range(6)]
    subject = program_of([lines], shapely.box(-50.0, -50.0, 110.0, 75.0))
    return subject.by(process={"interpass_limit_k": AMBIENT_K + 317.0 / f})


@cache
def cooled(wait_s: float, pause_s: float = 0.0) -> tuple[Subject, float]:
    """A wait before the last layer, and how warm it leaves the metal over the chamber; before it, that is over 900 K."""
    subject = wide(90.0).with_event(int(cube().of_layer(3)[0]) - 1, PAUSE, wait_s)
    subject = subject.by(process={"layer_pause_s": pause_s})
    found = subject.by(process={"layer_pause_s": 0.0}).checks(*HEAT)["least entry temperature"]
    assert f"after a wait of {wait_s:g} s" in found.text
    return subject, found.value - AMBIENT_K


def cooled_under(f: float, wait_s: float, share: float, least_k: float) -> Subject:
    """A limit so far over what a wait leaves: six tenths of its rise are to be left, or all but 60 K."""
    subject, rise = cooled(wait_s)
    limit = rise / (f * share) if share else rise + f * least_k
    assert (limit > 150.0) == bool(share)
    assert limit < 900.0
    return subject.by(process={"interpass_limit_k": AMBIENT_K + limit})


def waited(f: float) -> Subject:
    """A wait that leaves the metal cold, and is so much longer than the pause that the settings ask for."""
    return cooled(1800.0 + f * 1e-6, 1800.0)[0]


def set_least(f: float) -> Subject:
    """A least temperature that the first bead, on the plate at that of the chamber, is over by so much."""
    return wide(90.0).by(process={"least_entry_temperature_k": AMBIENT_K / f})


# -- preheating ----------------------------------------------------------------------------------------


@cache
def preheated() -> Subject:
    """A prism whose plate is preheated."""
    given = {"when": "plate", "defocus": 20.0, "current_ma": 10.0, "target_k": 330.0, "spot_mm": 20.0}
    config = Config().changed(preheat=given, machine={"set_focus": ["H5={defocus} ; focus"]}, scan={"order": "raster"})
    config = config.changed(process={"interpass": "off"})
    prism = Made(_folder(), shapely.box(0, 0, 40, 40), config, layers=2)
    return Subject(prism.read(), config, {"layers": prism.layers})


def scanning(**values) -> Subject:
    """The preheating with one motion under the beam changed."""
    scans = Subject(preheated().nc.preheating, preheated().config)
    row = np.flatnonzero(scans.nc.beam)[2]
    return with_scans(
        scans.with_columns(row, **{name: change(getattr(scans.nc, name)[row]) for name, change in values.items()})
    )


def with_scans(scans: Subject) -> Subject:
    return replace(preheated(), nc=replace(preheated().nc, preheating=scans.nc))


def scan_current(f: float) -> Subject:
    return with_scans(
        Subject(preheated().nc.preheating, preheated().config).with_values("current_ma", lambda v: v * (1.0 + f * 1e-3))
    )


def scan_height(f: float) -> Subject:
    def up(end):
        return end + np.array([0.0, 0.0, f * 0.01])

    return scanning(end=up)


def scan_reach(f: float) -> Subject:
    """A line of the scan whose end lies beside the region that may be preheated."""
    scans = Subject(preheated().nc.preheating, preheated().config)
    rows = np.flatnonzero(scans.nc.beam)
    far = rows[np.argmax(scans.nc.end[rows, 0])]
    margin = preheated().config.preheat.margin_mm
    return with_scans(scans.with_ends(far, 40.0 + margin + f * 0.01 - scans.nc.end[far, 0], 0))


def told(name: str) -> float:
    return preheated().checks("layers")[name].value


def aimed(f: float) -> Subject:
    return preheated().by(preheat={"target_k": told("preheat temperature") / f})


def over_target(f: float) -> Subject:
    settings = preheated().config.preheat
    return preheated().by(preheat={"over_k": (told("preheat overheating") - settings.target_k) / f})


def uneven(f: float) -> Subject:
    return preheated().by(preheat={"evenness_k": told("preheat evenness") / f})


def molten(f: float) -> Subject:
    return preheated().by(material={"solidus_k": told("preheat melting") / f})


def apart(f: float) -> Subject:
    """Lines of the scan so far apart: 1.5 spacings and the decimals of a program are allowed."""
    return preheated().by(preheat={"spacing_mm": (told("preheat lines") / f - 0.01) / 1.5})


def longer_scan(f: float) -> Subject:
    """A scan of two passes that is longer than these: by 0.02 of the pass of 340 mm that would follow."""
    scans = Subject(preheated().nc.preheating, preheated().config)
    lit = np.flatnonzero(scans.nc.beam)
    assert scans.nc.lengths[lit].sum() == 820.0
    last = int(lit[-1])
    way = (scans.nc.end - scans.nc.start)[last, :2]
    axis = int(np.argmax(np.abs(way)))
    longer = with_scans(scans.with_ends(last, np.sign(way[axis]) * f * 0.02 * 340.0, axis))
    return longer.by(preheat={"passes": 2})


# -- elsewhere -----------------------------------------------------------------------------------------


def released(z_mm: float, first: bool) -> Subject:
    """A layer that is called by itself, which ends or begins over what stands at a height."""
    subject = cube().by(machine={"program_name": "MAIN_K0003R1"})
    nc = subject.nc
    rows = np.flatnonzero(nc.file == nc.file[subject.of_layer(0)[0]])
    return subject.with_columns((rows[0] if first else rows[-1], 2), end=z_mm)


def entered(f: float) -> Check:
    nc = cube().nc
    check = entry_check(nc, nc, 1, HIGH_MM + f * 1e-3, cube().config, validated=False)
    faults = "begins at Z" in check.text
    return Check("entry", not faults, check.value, 0.0, "faults", check.where, check.text)


CASES: tuple[Case, ...] = (
    upwards("interpass temperature", "process.interpass_limit_k", limited, *HEAT),
    upwards("balance of the heat", "heat_again.MODELS_SHARE", lambda f: differing(f, 90.0, 0.1, 0.0), *HEAT),
    upwards("balance of the heat", "heat_again.MODELS_K", lambda f: differing(f, 140.0, 0.0, 60.0), *HEAT),
    upwards("power", "interpass_checks.ROOM", lambda f: with_room(f, 90.0, 2, 0.85, 0.0), *HEAT),
    upwards("power", "interpass_checks.ROOM_K", lambda f: with_room(f, 140.0, 0, 0.0, 80.0), *HEAT),
    upwards("interpass temperature", "process.interpass_limit_k", hot_behind_the_first, *HEAT),
    upwards("melting power", "checks.VALUE_SHARE", melting, *HEAT),
    downwards("least entry temperature", "interpass_checks.WARM_SHARE", lambda f: cooled_under(f, 120.0, 0.6, 0.0), *HEAT),
    upwards("least entry temperature", "heat_again.MODELS_K", lambda f: cooled_under(f, 3600.0, 0.0, 60.0), *HEAT),
    upwards("least entry temperature", "checks.PRINTED", waited, *HEAT),
    downwards("least entry temperature", "process.least_entry_temperature_k", set_least, *HEAT),
    upwards("preheat state", "preheating.VALUE_SHARE preheat.current_ma", scan_current, "layers"),
    upwards("preheat path", "preheating.VALUE_SHARE preheat.speed_mm_s", lambda f: scanning(feed_mm_min=lambda v: v * (1.0 + f * 1e-3)), "layers"),
    upwards("preheat path", "preheating.PLACE_MM", scan_height, "layers"),
    upwards("preheat path", "preheating.PLACE_MM preheat.margin_mm", scan_reach, "layers"),
    upwards("preheat lines", "preheating.WIDEST preheat.spacing_mm", apart, "layers"),
    upwards("preheat count", "preheating.LENGTH_SHARE", longer_scan, "layers"),
    downwards("preheat temperature", "preheat.target_k", aimed, "layers"),
    upwards("preheat overheating", "preheat.over_k", over_target, "layers"),
    upwards("preheat evenness", "preheat.evenness_k", uneven, "layers"),
    upwards("preheat melting", "material.solidus_k", molten, "layers"),
    upwards("layer by itself", "checks.TWO_PLACES_MM machine.clearance_mm", lambda f: released(HIGH_MM + 5.0 - f * 2e-3, False)),
    upwards("layer by itself", "checks.TWO_PLACES_MM machine.clearance_mm", lambda f: released(5.0 - f * 2e-3, True)),
    upwards("entry", "checks.PLACE_MM", lambda f: f, judge=entered),
)  # fmt: skip
