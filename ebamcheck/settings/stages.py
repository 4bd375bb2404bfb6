"""Settings of part, layers and single stages: slicing, comparison, curves, partition and order, preheating, height maps; and each
machine's slicers."""

from __future__ import annotations

import os
import platform
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, field_validator

from ebamcheck.installed import entry_points
from ebamcheck.settings.base import (
    Angle,
    Between,
    InnerAngle,
    Length,
    NotNegative,
    Place,
    Section,
    Share,
    Temperature,
    Tolerance,
    known_as,
)
from ebamcheck.settings.machine import OnTable

if TYPE_CHECKING:
    from ebamcheck.settings.config import Config


class CurveSettings(Section):
    """Cleaning and fitting of contours."""

    method: Literal["bounded", "surface", "chord", "paper"] = "bounded"
    """Fit: the fewest lines, arcs and cubics within the tolerance of the surface that the mesh stands for; a cubic for
    each of its points; an interpolating spline by chord length; or that of the paper."""
    tolerance_mm: Annotated[float, Between(1e-6, 10.0)] = 0.02
    """Distance that `bounded` may keep from the smooth curve."""
    crease_angle_deg: InnerAngle = 40.0
    """Edges of the mesh whose facets differ by this angle are sharp, for `bounded` and `surface`."""
    polygon_angle_deg: InnerAngle = 12.0
    """Flat strips between two rims are a cylinder or cone where they turn by less than this from one to the next (30 sides
    around)."""
    polygon_sagitta_mm: Tolerance = 0.1
    """Strips that turn by more are still a cylinder where they leave it by less than this, times the square of the ratio of
    the angle above and theirs: 0.064 mm for 24 sides, 0.016 mm for 12. 0.1 mm is as coarse as CAD systems export by
    default; who rounds a polygon leaves its part, who keeps one loses no more than the export has. Else they are the sides
    of a polygon and stay so, unless roundings of the part that touch their flat sides as tangents are as coarse. 0: go by
    the angle alone."""
    corner_angle_deg: InnerAngle = 140.0
    """A contour splits where the angle between its segments is under this (paper, section 3.2)."""
    near_point_mm: Tolerance = 0.001
    """Neighbouring points closer than this become one."""
    collinear_mm: Tolerance = 0.001
    """Inner points nearer than this to the chord of a straight run go."""
    straight_run_mm: Annotated[float, Between(0.001, 1e4)] = 5.0
    """A segment at least this long, and three times longer than those beside it, is a straight run, not part of a
    curve."""
    largest_lift_mm: Annotated[float, Between(0.001, 1000.0)] = 1.0
    """How far a curve of `bounded` or `surface` may lie from the chords of the mesh, which it leaves for the surface behind
    them: the limit of the fit's gate. More is a mesh too coarse for its part."""
    largest_bulge_mm: Annotated[float, Between(0.001, 1e6)] = 0.2
    """A curved run that leaves the chords of its contour by more than this stays a polyline: the mesh is too coarse
    there to tell the curve that it stands for. For `paper` and `chord` it is the limit of the fit's gate, too."""
    section_tolerance_mm: Annotated[float, Between(0.001, 100.0)] = 0.25
    """How far the contour path may leave the section of the mesh at any place, whatever the fit has evidence for: the largest
    bulge of a run that the mesh can tell, and what fit and inset leave. A ring of curves that would leave it farther stays
    the polygon of its contour."""


ORDERS = "ebamcheck.orders"  # entry point group of scan orders


def order_names() -> list[str]:
    """Names of the scan orders that are installed, sorted; none is loaded."""
    return sorted({point.name for point in entry_points(group=ORDERS)})


class ScanSettings(Section):
    """Partition, filling and order."""

    partition: Literal["hexagons", "squares", "stripes", "whole"] = "hexagons"
    """Islands of a layer: hexagons (the paper), squares (a chessboard) or stripes of their width, or solids undivided."""
    hexagon_side_mm: Annotated[float, Between(0.5, 1000.0)] | None = None
    """Side of the hexagons; None: planned from layer area, wall thickness and bead width. Squares and stripes are as
    wide as these hexagons."""
    rectangle: Literal["paper", "exact"] = "exact"
    """Enclosing rectangle: rotations in steps of pi/10 (paper, equation 11), or the exact minimum."""
    lattice_angle_deg: Angle = 37.0
    """Turn of the cells from layer to layer, so that their borders do not lie over each other: near 60 times the golden
    section, which keeps the hexagons of any few layers apart. The lowest layer lies as in the paper; 0: all do."""
    lattice_shift: bool = True
    """Shift the cells from layer to layer, too, each time by another share of a cell."""
    first_angle_deg: Angle = 0.0
    """Direction of the hatch in the lowest layer, counter-clockwise from +X."""
    layer_angle_deg: Angle = 15.0
    """Turn of the hatch from layer to layer (paper, section 1, after Jia et al.)."""
    island_angle_deg: Angle = 60.0
    """Turn of the hatch from island to island, by one of three colours of hexagons (two of squares and stripes). Islands
    that touch all the same with one colour take another multiple, or one halfway between, so that neighbours differ by
    15 degrees at least (a quarter of this angle, where that is less); but two that are narrower than the spacing, each
    of which is filled along its long side. 0: all islands of a layer have one direction."""
    order: str = "thermal"
    """Scan order of the islands of a layer: thermal (coolest first by a heat model, at a price on travel), nearest
    (the paper's rule, section 4.2; nearest-any by its full name), nearest-last, nearest-sum, farthest, raster,
    stride, random, least-heat, or one that is installed."""
    seed: Annotated[int, Between(0, 2**32 - 1)] = 0
    """Seed of all random choices: each layer's first island, the order `random`, the annealing of `thermal`."""
    stride: Annotated[int, Between(2, 1_000_000)] = 7
    """The order `stride` takes every so many islands of the raster."""
    travel_share: Annotated[float, Between(0.001, 100.0)] = 0.5
    """The order `thermal` travels at most this share of what `farthest` does; more only where an island would else follow
    one that it touches."""
    start_travel_mm: Length = 10.0
    """Travel that weighs as much as one start of the wire, for `thermal`."""
    annealing_steps: Annotated[int, Between(0, 10_000_000)] = 40000
    """Moves of islands that `thermal` tries at the end, keeping those that help: at most 800 an island and a million over their
    number, none over 500 islands."""
    carry_heat: bool = True
    """Orders by heat begin each layer with what those under it have left; off: each layer on a cold part."""
    least_coverage: Share = 0.98
    """Gate of the coverage: fraction of each layer's area that the beads must cover."""
    gap_width: Annotated[float, Between(0.001, 10.0)] = 0.2
    """Bare spots this wide, over the bead width, get a bead of their own; narrower ones (corners of 90 degrees: 0.17)
    only while a layer is covered less than least_coverage, for every bead is a start of the wire."""
    contour_offset_mm: Annotated[float, Between(0.0, 100.0)] | None = None
    """Inset of the contour bead's centre line from the contour; None: half a bead width."""

    @field_validator("order")
    @classmethod
    def _known_order(cls, value: str) -> str:
        if value not in (known := order_names()):
            raise ValueError(f"unknown order: choose one of {', '.join(known)}")
        return value


Kelvins = Annotated[float, Between(1.0, 1000.0)]  # difference of temperatures, K


LEAST_LINE_MM = 0.1  # shorter lines of a preheating scan are left out
# Ends of lines of a preheating scan nearer than this, over the spacing, are joined under the beam, where the way lies within the region
JOINED_SPACINGS = 1.6

AIM_K = 3.0  # the passes of a preheating scan aim so far over the target: travel and chunks of time make no more between plan and text
LEAST_REST_S = 5.0  # in which the surface of a layer comes to what lies under it, at least


class PreheatSettings(Section):
    """Preheating by scans of plate and layers; off unless it is asked for.

    It needs `machine.set_focus`, and a control with subprograms.
    """

    when: Literal["off", "plate", "layers"] = "off"
    """Never; before the first layer, on the base plate; or before every layer, too, on what stands, where that is colder than
    target_k."""
    scan_in: Literal["own", "layer"] = "own"
    """Where a scan stands: in a subprogram of its own, which the main program calls; or at the beginning of its layer's, which then
    is all that is to be called. `live` and `relayer` write it so, since a layer is released as one file."""
    pattern: Literal["lines", "crossed"] = "crossed"
    """Lines along X in every pass, every second one half a spacing aside; or along X and Y in turn."""
    current_ma: Annotated[float, Between(0.01, 1e4)] = 20.0
    """Current of the beam while it preheats."""
    defocus: Annotated[float, Between(-1e6, 1e6)] = 0.0
    """What {defocus} in machine.set_focus stands for, in the machine's own unit: how far the focus is off for a beam of spot_mm.
    0 is the focus of the beads, and is refused."""
    spot_mm: Annotated[float, Between(0.1, 500.0)] = 20.0
    """Diameter of the beam on the surface when it is out of focus, four standard deviations of its intensity."""
    speed_mm_s: Annotated[float, Between(0.01, 1e4)] = 50.0
    """Speed of the beam."""
    spacing_mm: Annotated[float, Between(0.1, 500.0)] = 10.0
    """Distance of the lines."""
    passes: Annotated[int, Between(1, 10000)] | None = None
    """How many times the surface is scanned; None: as often as the target asks for, by the heat model."""
    most_passes: Annotated[int, Between(1, 10000)] = 100
    """How often at most, where passes is not set."""
    target_k: Temperature = 450.0
    """Mean temperature of the scanned surface that is to be reached when the first bead begins."""
    over_k: Kelvins = 50.0
    """How far it may lie over that."""
    evenness_k: Kelvins = 60.0
    """Greatest difference of temperatures on the scanned surface then."""
    soak_s: Annotated[float, Between(0.0, 1e5)] = 30.0
    """Wait with the beam off after the last pass, in which the temperature evens out."""
    margin_mm: Length = 10.0
    """How far the scan of the plate reaches beyond the box around the lowest section."""


Step = Annotated[float, Between(0.001, 100.0)]  # distance of the points of a grid, mm


class HeightMapSettings(Section):
    """Maps of the measured surface (`relayer --height-map`, `live`), where a map does not bring its own frame."""

    origin_mm: tuple[Place, Place] = (0.0, 0.0)
    """X and Y of the point of the first column and the lowest row, in the coordinates of the program."""
    step_mm: tuple[Step, Step] = (1.0, 1.0)
    """Distance of columns and of rows; of NPY and TIFF, whose files do not tell it."""
    turn_deg: Angle = 0.0
    """Turn of the grid about its origin, counterclockwise."""
    rows: Literal["up", "down"] = "down"
    """Whether Y grows from the first row of the file to the last, or falls, as in a picture."""
    unit_mm: Annotated[float, Between(1e-9, 1000.0)] = 1.0
    """Height that a value of 1 stands for: 0.001 for micrometres."""
    zero_mm: Place = 0.0
    """Height over the base plate that a value of 0 stands for."""
    hole: Annotated[float, Between(-1e12, 1e12)] | None = None
    """Value that stands for a hole, beside NaN and infinite ones; None: there is none."""
    spike_mm: Annotated[float, Between(0.01, 1000.0)] = 5.0
    """Points further than this from the median of the layer count as holes: spatter, and what is not the part."""
    least_known: Share = 0.6
    """Share of the layer of which the height has to be known; holes get that of the nearest place."""
    uneven_mm: Annotated[float, Between(0.001, 100.0)] | None = None
    """How far a spot of a bead may lie over or under the mean of the layer; a layer that is more uneven is refused with the place.
    None: half the usual height of a layer, and no more than process.surface_tolerance_mm."""


# -- part, layers, slicing, comparison -------------------------------------------------------------

Component = Annotated[float, Between(-1e6, 1e6)]  # component of a direction, of any length but 0


class PartSettings(Section):
    """How the part's file is read and placed."""

    units: Annotated[Literal["mm", "cm", "m", "um", "in", "ft"], BeforeValidator(known_as)] | None = None
    """Unit of the numbers in the file, by its short or its usual longer name ("inch", "inches"); converted to mm once, at
    reading. None: that of the file where it has one (3MF), else mm; a file's own unit that is another is an error."""
    direction: tuple[Component, Component, Component] = (0.0, 0.0, 1.0)
    """Slicing direction in the coordinates of the file; the part is turned so that it points up."""
    rotate_deg: Angle = 0.0
    """Turn of the part about the vertical, counter-clockwise seen from above, once its slicing direction points up."""
    place_at_mm: Annotated[tuple[Place, ...], Field(min_length=2, max_length=3)] | None = None
    """Where the middle of the part's box comes to lie in X and Y of the work offset and, if a third number is given, its
    lowest point in Z, such as [100, 50]; None: where the file has it. A program counts Z from the base plate anyway."""
    on_table: OnTable | None = None
    """How the part stands on a tilt table (machine.rotary), of a layer whose program turns the table; None: nothing is turned.
    `ebamcheck relayer --direction` sets it."""
    fix_orientation: bool = False
    """Turn closed bodies of negative volume and single flipped facets over, and say so in the report."""


class LayerSettings(Section):
    """Where the part is cut."""

    layer_height_mm: Annotated[float, Between(0.005, 100.0)] | None = None
    """None: the height of one bead, from the mass balance of the process; of a run see `fit_height`."""
    fit_height: bool = True
    """Where no layer height is set, a run whose layers of a bead's height would be off the solid's metal by more than
    `process.mass_tolerance`, since level faces lie within layers, takes the nearest height with which they are not."""
    heights_mm: tuple[Place, ...] = ()
    """Listed heights, absolute z; they take the place of uniform ones."""
    base_mm: NotNegative = 0.0
    """Height of what stands under the lowest layer, over the base plate: a program of layers on a part that is half
    built begins there. Its heights are given by `heights_mm`."""


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
    block_points: Annotated[int, Between(1000, 10**9)] = 4_000_000
    """Points of an exact contour that are worked on at once: layers are cut, compared and written in blocks of about
    so many, which bounds the memory of a job (about 100 bytes a point and method)."""
    time_limit_s: Annotated[float, Between(0.001, 1e7)] = 600.0
    """Time of one backend's process for the whole stack; beyond it the process is ended and reported."""
    memory_limit_mb: Annotated[float, Between(1.0, 1e7)] = 8192.0
    """Resident memory of one backend's process, watched from outside."""
    slabs: Annotated[int, Between(1, 10_000)] | None = None
    """Slabs of z in which `check` reads, cuts and compares a binary STL file, one after the other, so that only one is in
    memory; their layers are dropped. 1: the part as a whole. None: that, unless the whole would need more memory than
    `work.most_memory_mb` or `slicing.memory_limit_mb` allow; then slabs of some four million facets."""
    processes: Annotated[int, Between(1, 1024)] | None = None
    """Backends that slice side by side; None: as many as there are cores. With 1 a job needs the least memory."""
    settings: dict[str, dict[str, Any]] = Field(default={})
    """Settings of each backend, by its name."""


class ComparisonSettings(Section):
    """When two slicers agree."""

    tolerance_mm: Tolerance = 0.001
    """Added to the two declared error bounds: agreement within bound_A + bound_B + tolerance."""
    plane_margin_mm: Tolerance | None = None
    """A layer is generic if no vertex lies nearer to its plane; None: the largest height bound compared."""
    evidence_share: Annotated[float, Between(0.001, 0.5)] = 0.1
    """Agreement with a slicer whose error bound is over this share of process.bead_width_mm, or whose height bound is over
    this share of the layer height, is no evidence: it agrees with too much. Within a bound r a wall may be wrong by 2 r;
    with the default one that is a fifth of the narrowest wall, which one bead makes. Such a slicer can still disagree."""
    doubt_mm: Tolerance = 0.01
    """Most that a slicer's declared doubt may add to that limit, in the places that it declares and nowhere else; layers
    that agree by it are counted and told. 0: a doubt changes nothing."""


Count = Annotated[int, Between(1, 10**12)]  # number of things that a job makes


class WorkSettings(Section):
    """How much work a job may be without a question: it is estimated before it begins, and `--yes` lets it go on."""

    most_layers: Count = 20_000
    """Layers; the thinnest ones of wire are some tenths of a millimetre."""
    most_points: Count = 1_000_000_000
    """Points of the contours of all layers, as an exact slicer finds them."""
    most_islands: Count = 500_000
    """Islands of all layers."""
    most_time_s: Annotated[float, Between(0.001, 1e8)] = 6 * 3600.0
    """Time of the whole job on this machine, as estimated; it is right within a factor of three or so."""
    most_memory_mb: Annotated[float, Between(1.0, 1e8)] | None = None
    """Memory of the whole job, of 10^6 bytes, as estimated; None: that of this machine."""


class RegressionSettings(Section):
    """Regression reports (`ebamcheck regress`)."""

    baselines: str = ""
    """Folder of the baselines; empty: reports/baselines of the checkout in which the command runs."""
    history: str = ""
    """SQLite file of the history; empty: history.sqlite in the output folder."""
    tolerances: dict[str, dict[str, Any]] = Field(default={})
    """What may grow by how much: metrics.NAME and backends.BACKEND.NAME, each with absolute and relative."""


class MachineChoice(Section):
    """The slicers of one machine, as `ebamcheck select --write` chose them."""

    primary: str = ""
    """Whose contours go on to fitting and the program."""
    required: tuple[str, ...] = ()
    """A run on this machine ends with exit code 4 where one of these is not available."""
    provenance: dict[str, Any] = Field(default={})
    """What the choice rests on: part, settings, versions and figures of every backend."""


class MachineSections(Section):
    """Slicers by machine, [machines.NAME]; a run takes those of its own machine (EBAMCHECK_MACHINE, else the host)."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, MachineChoice] = Field(init=False)

    def of(self, machine: str) -> MachineChoice | None:
        """Return the choice of a machine, or None."""
        return (self.model_extra or {}).get(machine)


MACHINE_VARIABLE = "EBAMCHECK_MACHINE"  # environment variable that names the machine where its host name does not (in a container, say)


def machine_name() -> str:
    """Name of this machine: that of the environment variable ``EBAMCHECK_MACHINE``, else its host name."""
    return os.environ.get(MACHINE_VARIABLE, "") or platform.node() or "localhost"


def for_this_machine(config: Config) -> Config:
    """Return the settings with the choice of this machine in force: its primary slicer, and what it requires besides; the sections
    of machines go."""
    slicing = config.slicing
    if (choice := config.machines.of(machine_name())) is not None:
        required = tuple(dict.fromkeys((*slicing.required, *choice.required)))
        primary = choice.primary or slicing.primary
        slicing = slicing.model_copy(update={"primary": primary, "required": required})
    return config.model_copy(update={"slicing": slicing, "machines": MachineSections()})
