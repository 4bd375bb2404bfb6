"""The subject of the checks: a program, and what is known of it, each thing worked out once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.interpass_checks import known_sections, layer_shares, scheduled_shares, shares_of_text
from ebamcheck.checks.matching import Matching
from ebamcheck.checks.metal import Deposit, deposit
from ebamcheck.checks.text_checks import Truth
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.nc.inputs import (
    CurveColumns,
    Interpass,
    ScanColumns,
    TrackColumns,
    deposition_heights,
    interpass_of,
)
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.roles import by_height, by_section, nearest_layer
from ebamcheck.settings.config import Config

CONTOUR_SHARE = 0.125  # Of the bead's width: a bead this near to the inset of the section is a contour
BEAD_STEP_MM = 0.5  # Chords of curved beads: at a radius of 5 mm they err by 6 um


@dataclass(frozen=True, eq=False)
class Subject:
    """A program and what is known of it; None for what is not."""

    read: NCProgram  # The program as it was read, with the roles of its plan where `match` is known
    config: Config  # Machine and process: limits, modes, power, templates
    # What the program was made from, and which bead follows which track of it (matched).
    curves: CurveColumns | None = None
    plan: ScanColumns | None = None
    match: Matching | None = None
    # The part as placed; its sections by a slicer, best by one that did not make the program; and those with the curves that their chords
    # stand for.
    part: Part | None = None
    layers: Layers | None = None
    smooth: Layers | None = None
    cuts: Floats | None = None  # (L,) heights of the cuts; None: those of `curves`, `plan` or `layers`
    # Heat of what stands when the program begins, and its section; None: the cold plate, or not known.
    before: HeatColumn | None = None
    under: BaseGeometry | None = None
    sha256: Mapping[str, str] | None = None  # Recorded hash of each file by name
    # What is known of the program from elsewhere, against which its header is held.
    truth: Truth = field(default_factory=Truth)
    laid: Callable[[], Deposit] | None = None  # Gives the metal of the program, where it is laid elsewhere
    asked: frozenset[str] = frozenset()  # What is looked at beside the text: `beads`, `heat` and `metal`
    _laying: Lock = field(default_factory=Lock, init=False, repr=False)
    _chords: dict[int, Floats] = field(default_factory=dict, init=False, repr=False)

    def knows(self, need: str) -> bool:
        """Whether something is known, or asked for."""
        return need in self.asked or getattr(self, need, None) is not None

    @cached_property
    def heights(self) -> Floats | None:
        """(L,) heights of the cuts in the part, mm; None where nothing tells them."""
        if self.cuts is not None:
            return np.asarray(self.cuts, np.float64)
        return next((x.heights for x in (self.curves, self.plan, self.layers) if x is not None), None)

    @cached_property
    def z_of(self) -> Floats:
        """(L,) Z of each layer in the program, mm; none where no height is known."""
        heights = np.zeros(0) if self.heights is None else np.asarray(self.heights, np.float64)
        return deposition_heights(heights, self.config.layer_height_mm, self.config.base_mm)

    @cached_property
    def nc(self) -> NCProgram:
        """The program with layers by its heights, and roles by who knows most of them: a plan, sections, or their shape alone."""
        nc, config = by_height(self.read, self.z_of), self.config
        if self.match is not None or self.layers is None:
            return nc
        near_mm = CONTOUR_SHARE * config.process.bead_width_mm
        return by_section(nc, self.layers, self.z_of, config.contour_offset_mm, near_mm)

    @property
    def path(self) -> TrackColumns | None:
        """Tracks that the program is to follow."""
        return None if self.match is None else self.match.path

    @cached_property
    def filled(self) -> Bools:
        """(L,) whether each layer is to have metal, as far as is known: all of them, if nothing is."""
        if self.path is not None:
            return np.asarray(np.diff(self.path.track_starts[self.path.layer_starts]) > 0)
        if self.layers is not None:
            return np.array([section.area > 0.0 for section in self.witness_sections or ()], np.bool_)
        return np.ones(self.z_of.size, np.bool_)

    @cached_property
    def sections(self) -> list[BaseGeometry] | None:
        """(L,) sections that the program was planned for, else the best that are known."""
        return known_sections(self.plan, self.smooth, self.layers)

    @property
    def witness(self) -> Layers:
        """Sections by a slicer, where they are known."""
        assert self.layers is not None
        return self.layers

    @cached_property
    def witness_sections(self) -> list[BaseGeometry] | None:
        """(L,) sections of the `layers`, each as one region; who prepares one makes its own."""
        return known_sections(None, self.layers)

    @cached_property
    def waits(self) -> Interpass | None:
        """Waits and power of the plan."""
        return None if self.plan is None else interpass_of(self.plan, self.config)

    @cached_property
    def shares(self) -> Floats:
        """(L,) share of the beam's power: by the table of the plan, by the schedule of the settings, else as the text has it."""
        if self.plan is not None:
            found = np.asarray(getattr(self.plan, "metrics", {}).get("power_share", np.nan), np.float64)
            return np.where(np.isnan(found), 1.0, found) * np.ones(len(self.plan.heights))
        scheduled = scheduled_shares(self.heights, self.config)
        if scheduled is not None:
            return scheduled
        if "heat" in self.asked:
            return shares_of_text(self.nc, self.config, self.sections)
        return np.minimum(layer_shares(self.nc, self.config), 1.0)

    @cached_property
    def bead_rows(self) -> list[Ints]:
        """Motions of the beads of each layer (L,)."""
        rows = np.flatnonzero(self.nc.deposit)
        layer = nearest_layer(self.nc.end[rows, 2], self.z_of)
        order = np.argsort(layer, kind="stable")
        return np.split(rows[order], np.searchsorted(layer[order], np.arange(1, len(self.z_of))))

    def chords(self, k: int) -> Floats:
        """Centre lines of the beads of a layer, (S, 4) x0, y0, x1, y1, mm; without those from or to a place that is not known."""
        if k not in self._chords:
            _, chords = self.nc.chords(self.bead_rows[k], BEAD_STEP_MM)
            # Widened lines of unknown places end the process within GEOS.
            self._chords[k] = chords[np.isfinite(chords).all(axis=1)]
        return self._chords[k]

    @property
    def deposit(self) -> Deposit:
        """Metal that the program lays over the `layers`: laid once, whichever rule asks for it first."""
        with self._laying:
            return self._deposit

    @cached_property
    def _deposit(self) -> Deposit:
        if self.laid is not None:
            return self.laid()
        return deposit(self.nc, self.witness, self.z_of, self.config, asked="beads" in self.asked)
