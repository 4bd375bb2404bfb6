"""Settings of a run, read from ``ebamcheck.toml`` or from ``[tool.ebamcheck]`` of a ``pyproject.toml``.

Every number that a stage uses stands here with its unit and its reason; unknown keys are refused. The
machine, process and material sections together are the *machine profile*.
"""

from __future__ import annotations

import difflib
import itertools
import math
import re
import tomllib
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from ebamcheck.errors import SettingsError
from ebamcheck.heights import bead_height_mm

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


PRINTED_PATH_MM = 1e-4
"""Distance that a path may have from its curve for the decimals of the program."""

ROUNDING_UNITS = 1.2
"""Error of a printed path in units of its last decimal: half a unit of the end point, and 0.635 times half a unit of
the coefficients of a polynomial, in X and in Y."""


class Section(BaseModel):
    """Base of every section: unknown keys are refused, values do not change, defaults are checked."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, validate_default=True, use_attribute_docstrings=True
    )


class PartSettings(Section):
    """How the part's file is read and placed."""

    units: Literal["mm", "cm", "m", "um", "in", "ft"] = "mm"
    """Unit of the numbers in the file; converted to mm once, at reading."""
    direction: tuple[Finite, Finite, Finite] = (0.0, 0.0, 1.0)
    """Slicing direction in the coordinates of the file; the part is turned so that it points up."""
    fix_orientation: bool = False
    """Turn closed bodies of negative volume and single flipped facets over, and say so in the report."""


class LayerSettings(Section):
    """Where the part is cut."""

    layer_height_mm: Positive | None = None
    """None: the height of one bead, from the mass balance of the process."""
    heights_mm: tuple[Finite, ...] = ()
    """Listed heights, absolute z; they take the place of uniform ones."""


class SlicingSettings(Section):
    """Which slicers run and how."""

    backends: tuple[str, ...] = ()
    """Empty: every backend that is available on this machine."""
    required: tuple[str, ...] = ()
    """A run ends with exit code 4 where one of these is not available."""
    primary: str = ""
    """Whose contours go on to fitting and the program; empty: the default exact backend."""
    witnesses: tuple[str, ...] = ()
    """Outside programs that slice, too: names, or `all` for those that are installed on this machine."""
    block_points: Annotated[int, Field(ge=1000)] = 4_000_000
    """Points of an exact contour that are worked on at once: layers are cut, compared and written in blocks of about
    so many, which bounds the memory of a job (about 100 bytes a point and method)."""
    time_limit_s: Positive = 600.0
    """Time of one backend's process for the whole stack; beyond it the process is ended and reported."""
    memory_limit_mb: Positive = 8192.0
    """Resident memory of one backend's process, watched from outside."""
    processes: Annotated[int, Field(ge=1)] | None = None
    """Backends that slice side by side; None: as many as there are cores. With 1 a job needs the least memory."""
    settings: dict[str, dict[str, Any]] = {}
    """Settings of each backend, by its name."""


class ComparisonSettings(Section):
    """When two slicers agree."""

    tolerance_mm: NotNegative = 0.001
    """Added to the two declared error bounds: agreement within bound_A + bound_B + tolerance."""
    plane_margin_mm: NotNegative | None = None
    """A layer is generic if no vertex lies nearer to its plane; None: the largest height bound compared."""


class CurveSettings(Section):
    """Cleaning and fitting of contours."""

    method: Literal["bounded", "surface", "chord", "paper"] = "bounded"
    """Fit: the fewest lines, arcs and cubics within the tolerance of the surface that the mesh stands for; a cubic for
    each of its points; an interpolating spline by chord length; or that of the paper."""
    tolerance_mm: Positive = 0.02
    """Distance that `bounded` may keep from the smooth curve."""
    crease_angle_deg: Annotated[float, Field(gt=0, lt=180)] = 40.0
    """Edges of the mesh whose facets differ by this angle are sharp, for `bounded` and `surface`."""
    corner_angle_deg: Annotated[float, Field(gt=0, lt=180)] = 140.0
    """A contour splits where the angle between its segments is under this (paper, section 3.2)."""
    near_point_mm: NotNegative = 0.001
    """Neighbouring points closer than this become one."""
    collinear_mm: NotNegative = 0.001
    """Inner points nearer than this to the chord of a straight run go."""
    straight_run_mm: Positive = 5.0
    """A segment at least this long, and three times longer than those beside it, is a straight run, not part of a
    curve."""
    largest_lift_mm: Positive = 1.0
    """How far a curve of `bounded` or `surface` may lie from the chords of the mesh, which it leaves for the surface behind
    them: the limit of the fit's gate. More is a mesh too coarse for its part."""
    largest_bulge_mm: Positive = 0.2
    """A curved run that leaves the chords of its contour by more than this stays a polyline: the mesh is too coarse
    there to tell the curve that it stands for. For `paper` and `chord` it is the limit of the fit's gate, too."""


SCAN_ORDERS = (
    "nearest", "nearest-any", "nearest-last", "nearest-sum", "farthest", "raster",
    "stride", "random", "least-heat", "thermal",
)  # fmt: skip
"""Orders of the house; others are found by the entry point group ``ebamcheck.orders``."""


class ScanSettings(Section):
    """Partition, filling and order."""

    partition: Literal["hexagons", "squares", "stripes", "whole"] = "hexagons"
    """Islands of a layer: hexagons (the paper), squares (a chessboard) or stripes of their width, or solids undivided."""
    hexagon_side_mm: Positive | None = None
    """Side of the hexagons; None: planned from layer area, wall thickness and bead width. Squares and stripes are as
    wide as these hexagons."""
    rectangle: Literal["paper", "exact"] = "exact"
    """Enclosing rectangle: rotations in steps of pi/10 (paper, equation 11), or the exact minimum."""
    lattice_angle_deg: Finite = 37.0
    """Turn of the cells from layer to layer, so that their borders do not lie over each other: near 60 times the golden
    section, which keeps the hexagons of any few layers apart. The lowest layer lies as in the paper; 0: all do."""
    lattice_shift: bool = True
    """Shift the cells from layer to layer, too, each time by another share of a cell."""
    first_angle_deg: Finite = 0.0
    """Direction of the hatch in the lowest layer, counter-clockwise from +X."""
    layer_angle_deg: Finite = 15.0
    """Turn of the hatch from layer to layer (paper, section 1, after Jia et al.)."""
    island_angle_deg: Finite = 60.0
    """Turn of the hatch from island to island, by one of three colours of hexagons (two of squares and stripes), so that
    neighbours differ."""
    order: str = "thermal"
    """Scan order of the islands of a layer: thermal (coolest first by a heat model, at a price on travel), nearest
    (the paper's rule, section 4.2; nearest-any by its full name), nearest-last, nearest-sum, farthest, raster,
    stride, random, least-heat, or one that is installed."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of all random choices: each layer's first island, the order `random`, the annealing of `thermal`."""
    stride: Annotated[int, Field(ge=2)] = 7
    """The order `stride` takes every so many islands of the raster."""
    travel_share: Positive = 0.5
    """The order `thermal` travels at most this share of what `farthest` does."""
    start_travel_mm: NotNegative = 10.0
    """Travel that weighs as much as one start of the wire, for `thermal`."""
    annealing_steps: Annotated[int, Field(ge=0)] = 4000
    """Moves of islands that `thermal` tries at the end, keeping those that help; fewer on layers of many islands."""
    least_coverage: Annotated[float, Field(gt=0, le=1)] = 0.98
    """Gate of the coverage: fraction of each layer's area that the beads must cover."""
    gap_width: Positive = 0.2
    """Bare spots this wide, over the bead width, get a bead of their own; narrower ones (corners of 90 degrees: 0.17)
    only while a layer is covered less than least_coverage, for every bead is a start of the wire."""
    contour_offset_mm: NotNegative | None = None
    """Inset of the contour bead's centre line from the contour; None: half a bead width."""

    @field_validator("order")
    @classmethod
    def _known_order(cls, value: str) -> str:
        known = [*SCAN_ORDERS, *sorted({point.name for point in entry_points(group="ebamcheck.orders")})]
        if value not in known:
            raise ValueError(f"unknown order: choose one of {', '.join(known)}")
        return value


class MachineSettings(Section):
    """The machine: a SINUMERIK 840D sl with an electron-beam gun and a wire feeder."""

    name: str = "wire electron-beam machine (default profile)"
    """Name of the machine, as it stands in the header of the program."""
    control: str = "sinumerik-840d-sl"
    """Control that the program is for: the name of a post-processor. Beam and wire templates that are left at their
    defaults are those of its language."""
    poly_licensed: bool = True
    """Polynomial interpolation (POLY) is an option of the control."""
    bspline_licensed: bool = True
    """Spline interpolation (BSPLINE) is an option of the control."""
    curve_form: Literal["poly", "bspline", "arcs", "lines"] = "poly"
    """How splines are written: polynomials, B-splines, or arcs (G2, G3) or chords (G1) within line_tolerance_mm.
    Arcs of the contour are always written as such."""
    bspline_shift: Literal[2, 3, "uniform"] = 2
    """Which knot interval a BSPLINE block's PL carries; `uniform` for a control that chooses even intervals itself:
    no PL, and splines of other intervals in another form. See the header of the program."""
    line_tolerance_mm: Positive = 0.01
    """Distance from the curve where it is written as chords or arcs."""
    decimals: Annotated[int, Field(ge=3, le=8)] | None = None
    """Decimals of coordinates and coefficients in the program; None: the fewest whose rounding keeps the path within
    a tenth of every tolerance, six with the defaults."""
    travel_min_mm: tuple[Finite, Finite, Finite] = (-1000.0, -1000.0, 0.0)
    """Software limits of X, Y and Z in the work offset: least positions."""
    travel_max_mm: tuple[Finite, Finite, Finite] = (1000.0, 1000.0, 1500.0)
    """Software limits of X, Y and Z in the work offset."""
    work_offset: Literal["G54", "G55", "G56", "G57"] = "G54"
    """Settable work offset in which the program runs."""
    safe_height_mm: Positive = 20.0
    """Rise above the current layer for moves over more than one island gap, and at the end."""
    rapid_mm_s: Positive = 100.0
    """Speed of rapid moves, for times only; G0 itself carries no feed."""
    feed_min_mm_s: Positive = 1.0
    """Least feed that a program may command."""
    feed_max_mm_s: Positive = 50.0
    """Greatest feed that a program may command."""
    smoothing: tuple[str, ...] = ("SOFT", "FFWON", "G642")
    """Words of the block that sets acceleration, feed-forward and corner rounding."""
    smoothing_tolerance_mm: Positive = 0.05
    """Axis tolerance of G642 (CTOL): the path driven may leave the path programmed by this."""
    workpiece_directory: str = "EBAMCHECK"
    """Name of the WPD folder on the control."""
    program_name: str = "MAIN"
    """Base name of the main program; the part's name is not a legal NC name in general."""
    # Templates: {power_w} {voltage_kv} {current_ma} {wire_mm_s} {wire_retract_mm} {feed_mm_min} {layer} {height_mm}
    # are filled in.
    beam_on: tuple[str, ...] = ("M60 ; beam on",)
    """Blocks that switch the beam on; the codes are the machine maker's."""
    beam_off: tuple[str, ...] = ("M61 ; beam off",)
    """Blocks that switch the beam off."""
    set_beam: tuple[str, ...] = (
        "H1={voltage_kv} ; accelerating voltage, kV",
        "H2={current_ma} ; beam current, mA",
    )
    """Blocks that set voltage and current, before the first layer."""
    set_power: tuple[str, ...] = ("H2={current_ma} ; beam current, mA",)
    """Blocks that change the power along a bead, where the process ramps the beam."""
    wire_start: tuple[str, ...] = ("H3={wire_mm_s} ; wire speed, mm/s", "M62 ; wire on")
    """Blocks that start the wire at the speed of the layer."""
    wire_stop: tuple[str, ...] = ("M63 ; wire off",)
    """Blocks that stop the wire."""
    wire_retract: tuple[str, ...] = ("H4={wire_retract_mm} ; wire drawn back, mm",)
    """Blocks that draw the stopped wire back, where the process asks for it."""
    layer_begin: tuple[str, ...] = ()
    """Blocks before the first motion of a layer."""
    layer_end: tuple[str, ...] = ()
    """Blocks after the last motion of a layer."""

    @property
    def printed_decimals(self) -> int:
        """Decimals of the program: those set, else the fewest that keep the path within a tenth of every tolerance."""
        if self.decimals is not None:
            return self.decimals
        least_mm = min(PRINTED_PATH_MM, self.smoothing_tolerance_mm, self.line_tolerance_mm)
        return min(max(math.ceil(-math.log10(0.1 * least_mm / ROUNDING_UNITS)), 3), 8)

    @field_validator("program_name", "workpiece_directory")
    @classmethod
    def _legal_name(cls, value: str) -> str:
        if not re.fullmatch(r"([A-Z]{2}|_[A-Z])[A-Z0-9_]{0,17}", value) or value in (
            "CON",
            "PRN",
            "AUX",
            "NUL",
        ):
            raise ValueError(
                "an NC name has 2 to 19 of A-Z, 0-9 and _, and starts with two letters or an underscore and a letter"
            )
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if any(a >= b for a, b in zip(self.travel_min_mm, self.travel_max_mm, strict=True)):
            raise ValueError("travel_min_mm must be under travel_max_mm on every axis")
        if self.feed_min_mm_s >= self.feed_max_mm_s:
            raise ValueError("feed_min_mm_s must be under feed_max_mm_s")
        if (self.curve_form == "poly" and not self.poly_licensed) or (
            self.curve_form == "bspline" and not self.bspline_licensed
        ):
            raise ValueError(
                f"curve_form {self.curve_form!r} needs an option that the control is said not to have"
            )
        return self


class KeepOut(Section):
    """A place that the bead must not enter: a clamp, a fixture, a probe."""

    name: str = "clamp"
    """Name in messages."""
    outline_mm: Annotated[tuple[tuple[Finite, Finite], ...], Field(min_length=3)]
    """Corners of its outline in X and Y of the work offset, in order; the outline closes itself."""
    z_mm: tuple[Finite, Finite] = (0.0, 1000.0)
    """From which Z up to which Z it stands in the way."""

    @model_validator(mode="after")
    def _upright(self) -> Self:
        if self.z_mm[0] >= self.z_mm[1]:
            raise ValueError(f"z_mm {self.z_mm}: give the lower Z first")
        return self


class ProcessSettings(Section):
    """Wire electron-beam process (values: Pixner et al. 2020, Materials 13:3310, and common practice)."""

    voltage_kv: Positive = 60.0
    """Accelerating voltage."""
    current_ma: Positive = 120.0
    """Beam current; with the voltage it gives the beam power."""
    current_max_ma: Positive = 250.0
    """Greatest beam current of the gun."""
    travel_speed_mm_s: Positive = 10.0
    """Speed of the beam along a bead."""
    wire_diameter_mm: Positive = 1.6
    """Diameter of the wire."""
    wire_speed_mm_s: Positive = 2000.0 / 60.0
    """Wire speed at the height of one bead; in a layer of another height it follows the mass balance."""
    base: Literal["cooled", "insulated"] = "cooled"
    """What the heat model assumes under the base plate: a table that keeps its temperature, or no heat flow."""
    base_plate_mm: Positive = 25.0
    """Thickness of the plate on which the part is built: depth of the heat model under height 0."""
    ambient_temperature_k: Positive = 293.15
    """Temperature of the chamber, to which the part radiates."""
    surface_temperature_k: Positive = 900.0
    """Temperature at which the radiation of the layer is made linear."""
    bead_width_mm: Positive = 6.0
    """Width of one bead."""
    bead_spacing: Annotated[float, Field(gt=0, le=1)] = 0.72
    """Distance between parallel beads over the bead width."""
    machining_allowance_mm: NotNegative = 0.0
    """Metal left on the contour for machining: contour beads lie outward by this; at most their inset."""
    overlap_mm: NotNegative = 0.0
    """Length by which a closed contour bead runs on over its own start, at most once around."""
    seam_shift_mm: NotNegative = 0.0
    """Way along a contour from the seam below to its start, so that seams do not lie on top of each other."""
    ramp_up_mm: NotNegative = 0.0
    """Length at the start of a bead along which the beam rises to full power."""
    crater_fill_mm: NotNegative = 0.0
    """Length at the end of a bead along which the beam falls, so that the crater is filled."""
    ramp_power: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Share of the full power at which a ramp begins, and at which a crater fill ends."""
    ramp_steps: Annotated[int, Field(ge=1, le=50)] = 4
    """Steps of power along a ramp."""
    wire_retract_mm: NotNegative = 0.0
    """Wire drawn back at the end of a bead, so that it does not freeze in."""
    least_seam_distance_mm: NotNegative = 0.0
    """Least distance between the starts of contours in neighbouring layers; 0: not limited."""
    travel_sectors_deg: tuple[tuple[Finite, Finite], ...] = ()
    """Directions of travel that a side feeder allows, each from an angle counter-clockwise to another; empty: all."""
    keep_out: tuple[KeepOut, ...] = ()
    """Places that no bead and no rapid below their top may enter."""
    largest_overhang_deg: Annotated[float, Field(gt=0, lt=90)] | None = None
    """Greatest angle from the vertical by which a layer may reach out over the one below; None: not limited."""

    @property
    def power_w(self) -> float:
        """Beam power U I, W."""
        return self.voltage_kv * self.current_ma

    @property
    def ramps_beam(self) -> bool:
        """Whether the power changes along a bead."""
        return self.ramp_up_mm > 0.0 or self.crater_fill_mm > 0.0

    @property
    def shapes_bead_ends(self) -> bool:
        """Whether beads start or end otherwise than the curves and hatch lines that they follow."""
        return self.ramps_beam or self.overlap_mm > 0.0 or self.seam_shift_mm > 0.0

    @property
    def hatch_spacing_mm(self) -> float:
        """Distance between parallel beads, mm."""
        return self.bead_width_mm * self.bead_spacing

    @property
    def bead_height_mm(self) -> float:
        """Height of one bead from the mass balance, mm."""
        return bead_height_mm(
            self.wire_diameter_mm, self.wire_speed_mm_s, self.travel_speed_mm_s, self.bead_width_mm
        )

    @model_validator(mode="after")
    def _current_in_range(self) -> Self:
        if self.current_ma > self.current_max_ma:
            raise ValueError(f"current_ma {self.current_ma} is over current_max_ma {self.current_max_ma}")
        return self


class KinematicsSettings(Section):
    """What the axes can do: limits by which the feed along the path is worked out (`ebamcheck.kinematics`).

    The defaults are those of a heavy gantry, with the jerk that a SINUMERIK is delivered with (SOFT).
    """

    axis_speed_mm_s: tuple[Positive, Positive, Positive] = (200.0, 200.0, 100.0)
    """Greatest speeds of X, Y and Z."""
    axis_acceleration_mm_s2: tuple[Positive, Positive, Positive] = (1000.0, 1000.0, 500.0)
    """Greatest accelerations of X, Y and Z."""
    axis_jerk_mm_s3: tuple[Positive, Positive, Positive] = (20000.0, 20000.0, 10000.0)
    """Greatest jerks of X, Y and Z."""
    speed_jump_mm_s: NotNegative = 0.1
    """Step of speed that an axis takes at a corner without being told to smooth it."""
    curvature_share: Annotated[float, Field(gt=0, lt=1)] = 0.8
    """Share of the acceleration that may go into curvature; sqrt(1 - share^2) of it is left for the feed."""
    dip_share: Annotated[float, Field(gt=0, lt=1)] = 0.95
    """Where the feed falls under this share of the feed programmed, the bead grows: a dip."""


DataPoints = Annotated[tuple[tuple[Positive, Positive], ...], Field(min_length=2)]
"""Temperatures and values of a material, by rising temperature; two points of one temperature make a jump."""


class MaterialSettings(Section):
    """The wire's material."""

    name: str = "Ti-6Al-4V"
    """Name of the material, as it stands in the header of the program."""
    density_kg_m3: Positive = 4430.0
    """Density of the wire, for its mass, and of the part, for its heat."""
    conductivity_w_mk: Positive = 20.0
    """Heat conductivity k of the linear heat model: Ti-6Al-4V at about 1200 K (Mills 2002: 1.26 + 0.0157 T under the
    beta transus)."""
    heat_capacity_j_kgk: Positive = 700.0
    """Heat capacity c of the linear heat model: Ti-6Al-4V at about 1000 K (Mills 2002: 483 + 0.215 T under 1268 K)."""
    conductivity_by_temperature: DataPoints = (
        (293.0, 5.86),
        (1268.0, 21.17),
        (1268.0, 19.61),
        (1877.0, 27.35),
        (1923.0, 33.40),
        (3533.0, 72.04),
    )
    """Heat conductivity of the nonlinear referee, (K, W/(m K)), linear between: 1.26 + 0.0157 T, 3.51 + 0.0127 T over the
    beta transus, -12.75 + 0.024 T liquid. Nominal, after Mills 2002: check them against the book before citing."""
    heat_capacity_by_temperature: DataPoints = (
        (293.0, 546.0),
        (1268.0, 755.6),
        (1268.0, 640.9),
        (1877.0, 750.6),
        (1923.0, 831.0),
        (3533.0, 831.0),
    )
    """Heat capacity of the nonlinear referee without the heat of fusion, (K, J/(kg K)), linear between: 483 + 0.215 T,
    412.7 + 0.180 T over the beta transus, 831 liquid. Nominal, as above."""
    latent_heat_j_kg: NotNegative = 286e3
    """Heat of fusion (Mills 2002)."""
    solidus_k: Positive = 1877.0
    """Temperature at which melting begins (Mills 2002)."""
    liquidus_k: Positive = 1923.0
    """Temperature at which it ends (Mills 2002)."""
    boiling_k: Positive = 3533.0
    """Temperature at which heat leaves as vapour, in the nonlinear referee (nominal)."""
    melt_mixing: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 4.0
    """Conduction of the melt over that of still melt, in the nonlinear referee: convection carries the heat. Factors from
    2 to 10 are in use; nominal."""
    emissivity: Annotated[float, Field(ge=0, le=1)] = 0.6
    """Radiation of the surface over that of a black body; 0.5 to 0.7 are published for hot Ti-6Al-4V."""
    absorptivity: Annotated[float, Field(gt=0, le=1)] = 0.87
    """Share of the beam's power that the part takes up; 0.85 to 0.9 are published for electrons on titanium."""

    @field_validator("conductivity_by_temperature", "heat_capacity_by_temperature")
    @classmethod
    def _rising(cls, value: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        if any(a[0] > b[0] for a, b in itertools.pairwise(value)):
            raise ValueError("give the temperatures in rising order")
        return value


class RegressionSettings(Section):
    """Regression reports (`ebamcheck regress`)."""

    baselines: str = ""
    """Folder of the baselines; empty: reports/baselines of the checkout in which the command runs."""
    history: str = ""
    """SQLite file of the history; empty: history.sqlite in the output folder."""
    tolerances: dict[str, dict[str, Any]] = {}
    """What may grow by how much: metrics.NAME and backends.BACKEND.NAME, each with absolute and relative."""


class MachineChoice(Section):
    """The slicers of one machine, as `ebamcheck select --write` chose them."""

    primary: str = ""
    """Whose contours go on to fitting and the program."""
    required: tuple[str, ...] = ()
    """A run on this machine ends with exit code 4 where one of these is not available."""
    provenance: dict[str, Any] = {}
    """What the choice rests on: part, settings, versions and figures of every backend."""


class MachineSections(Section):
    """Slicers by machine, [machines.NAME]; a run takes those of its own machine (EBAMCHECK_MACHINE, else the host)."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, MachineChoice] = Field(init=False)

    def of(self, machine: str) -> MachineChoice | None:
        """Return the choice of a machine, or None."""
        return (self.model_extra or {}).get(machine)


class Config(Section):
    """All settings of a run."""

    part: PartSettings = PartSettings()
    layers: LayerSettings = LayerSettings()
    slicing: SlicingSettings = SlicingSettings()
    comparison: ComparisonSettings = ComparisonSettings()
    curves: CurveSettings = CurveSettings()
    scan: ScanSettings = ScanSettings()
    machine: MachineSettings = MachineSettings()
    process: ProcessSettings = ProcessSettings()
    kinematics: KinematicsSettings = KinematicsSettings()
    material: MaterialSettings = MaterialSettings()
    regression: RegressionSettings = RegressionSettings()
    machines: MachineSections = MachineSections()

    @property
    def layer_height_mm(self) -> float:
        """Layer height: the one set, else that of one bead."""
        return self.layers.layer_height_mm or self.process.bead_height_mm

    @property
    def contour_offset_mm(self) -> float:
        """Inset of the contour bead's centre line, mm, less the allowance for machining."""
        offset = self.scan.contour_offset_mm
        inset = 0.5 * self.process.bead_width_mm if offset is None else offset
        return inset - self.process.machining_allowance_mm

    @model_validator(mode="after")
    def _cut_splines_can_be_written(self) -> Self:
        if (
            self.machine.curve_form == "bspline"
            and not self.machine.poly_licensed
            and self.process.shapes_bead_ends
        ):
            raise ValueError(
                "process.overlap_mm, seam_shift_mm, ramp_up_mm and crater_fill_mm cut splines, whose parts are written as "
                "POLY: with machine.curve_form 'bspline' machine.poly_licensed is needed; use 'arcs' or 'lines'"
            )
        return self

    @model_validator(mode="after")
    def _allowance_within_the_inset(self) -> Self:
        if self.contour_offset_mm < 0.0:
            raise ValueError(
                f"process.machining_allowance_mm {self.process.machining_allowance_mm:g} is over the inset of the contour "
                "beads: a section cannot grow; give a larger scan.contour_offset_mm or grow the part"
            )
        return self

    def changed(self, **sections: dict[str, Any]) -> Config:
        """Return the settings with some values of some sections changed, checked anew."""
        values = self.model_dump()
        for section, changes in sections.items():
            values[section] = {**values[section], **changes}
        return validated(values, "settings")


def load_config(path: str | Path | None = None) -> Config:
    """Read settings from a TOML file; without one, the defaults.

    Raises
    ------
    SettingsError
        If the file is missing, is not TOML, or a key is unknown or a value out of range; the message
        names the key and the value.
    """
    if path is None:
        return Config()
    path = Path(path)
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SettingsError(f"{path}: is not UTF-8 text, as TOML must be") from None
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from None
    if path.name == "pyproject.toml":
        values = values.get("tool", {}).get("ebamcheck", {})
    return validated(values, str(path))


def validated(values: dict[str, Any], where: str) -> Config:
    """Check a mapping of sections against :class:`Config`."""
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(k) for k in first["loc"]) or "settings"
        given = first.get("input")
        shown = "" if isinstance(given, dict | BaseModel) else f" (given {given!r})"
        what = _unknown_key(first["loc"]) if first["type"] == "extra_forbidden" else first["msg"] + shown
        raise SettingsError(f"{where}: {key}: {what}; `ebamcheck config` lists every key") from None


def _unknown_key(place: tuple[int | str, ...]) -> str:
    """Say that a key is unknown, and which known one of its section is most like it."""
    section = Config.model_fields.get(str(place[0])) if len(place) > 1 else None
    kind = section.annotation if section else Config
    known = list(kind.model_fields) if isinstance(kind, type) and issubclass(kind, BaseModel) else []
    near = difflib.get_close_matches(str(place[-1]), known, n=1)
    return "unknown key" + (f" (did you mean {near[0]!r}?)" if near else "")
