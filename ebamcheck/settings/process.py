"""Settings of the process: beam, wire, beads; and the height of one bead by itself."""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from ebamcheck.settings.base import Angle, Between, Length, Place, Section, Share, Temperature

Width = Annotated[float, Between(0.1, 100.0)]  # mm, of a bead, a wall or a hole

Height = Annotated[float, Between(0.0, 1e5)]  # height over the plate, mm
Current = Annotated[float, Between(0.01, 1e4)]  # current of the beam, mA
WireSpeed = Annotated[float, Between(0.001, 1e4)]  # speed of the wire, mm/s
Ratio = Annotated[float, Between(0.001, 100.0)]  # one height over another

LineEnergy = Annotated[float, Between(0.01, 1e6)]  # J/mm along a bead, or J/mm3 of wire

Seconds = Annotated[float, Between(0.0, 1000.0)]  # time that a ramp takes
Voltage = Annotated[float, Between(0.1, 1000.0)]  # accelerating voltage, kV
TravelSpeed = Annotated[float, Between(0.01, 1e4)]  # speed along a bead, mm/s
Metal = Annotated[float, Between(0.001, 1e4)]  # section of a bead, mm2
Off = Annotated[float, Between(1e-9, 1.0)]  # share by which something may be off

# Heights over the base plate, mm, rising, and the share of the beam's power there
PowerTable = Annotated[tuple[tuple[Height, Share], ...], Field(min_length=1)]


def _in_order(window: tuple[float, float], what: str = "") -> tuple[float, float]:
    if window[0] >= window[1]:
        raise ValueError(f"{what}give the lower one first")
    return window


def _not_falling(window: tuple[float, float]) -> tuple[float, float]:
    if window[0] > window[1]:
        raise ValueError("give the lower one first")
    return window


class KeepOut(Section):
    """A place that the bead must not enter: a clamp, a fixture, a probe."""

    name: str = "clamp"
    """Name in messages."""
    outline_mm: Annotated[tuple[tuple[Place, Place], ...], Field(min_length=3)]
    """Corners of its outline in X and Y of the work offset, in order; the outline closes itself."""
    z_mm: tuple[Place, Place] = (0.0, 1000.0)
    """From which Z up to which Z it stands in the way."""

    @model_validator(mode="after")
    def _upright(self) -> Self:
        if self.z_mm[0] >= self.z_mm[1]:
            raise ValueError(f"z_mm {self.z_mm}: give the lower Z first")
        return self


class ProcessSettings(Section):
    """Wire electron-beam process (values: Pixner et al. 2020, Materials 13:3310, and common practice)."""

    voltage_kv: Annotated[float, Between(1.0, 500.0)] = 60.0
    """Accelerating voltage."""
    current_ma: Current = 120.0
    """Beam current; with the voltage it gives the beam power."""
    current_max_ma: Current = 250.0
    """Greatest beam current of the gun."""
    travel_speed_mm_s: Annotated[float, Between(0.01, 1e4)] = 10.0
    """Speed of the beam along a bead."""
    wire_diameter_mm: Annotated[float, Between(0.05, 20.0)] = 1.6
    """Diameter of the wire."""
    wire_speed_mm_s: WireSpeed = 2000.0 / 60.0
    """Wire speed of one bead by itself, which gives the bead its height. In a program the wire follows what a bead is to
    lay: the spacing of the beads times the height of the layer, more along a contour, less where beads overlap."""
    wire_speed_min_mm_s: WireSpeed = 1000.0 / 60.0
    """Least wire speed at which the feeder runs evenly and the wire melts drop-free: 1 m/min, the lower end of what is
    published for wire electron-beam processes; check it on the machine."""
    wire_speed_max_mm_s: WireSpeed = 6000.0 / 60.0
    """Greatest wire speed at which the melt pool takes up the wire: 6 m/min, the upper end of what is published."""
    layer_over_bead: Annotated[tuple[Ratio, Ratio], AfterValidator(_in_order)] = (0.5, 2.0)
    """Least and greatest layer height over the height of the bead that wire_speed_mm_s and travel_speed_mm_s give. Under a
    half the beam melts more of the layers below than of the wire; at twice the height of the default bead the layer is
    more than half as high as the bead is wide, the contact angle passes 90 degrees, and the melt runs over the sides."""
    line_energy_j_mm: Annotated[tuple[LineEnergy, LineEnergy], AfterValidator(_in_order)] = (150.0, 3000.0)
    """Least and greatest energy of the beam along a bead, P / v. The corners of the published window: 60 kV and 50 mA at
    20 mm/s, 60 kV and 250 mA at 5 mm/s. Less does not melt wire and base together, more boils and drops through."""
    voltage_window_kv: Annotated[tuple[Voltage, Voltage], AfterValidator(_in_order)] = (10.0, 200.0)
    """Least and greatest accelerating voltage that a program may set; guns for wire processes run at 40 to 150 kV."""
    current_window_ma: Annotated[tuple[Current, Current], AfterValidator(_in_order)] = (1.0, 1000.0)
    """Least and greatest beam current of a bead; its ramps may go below by ramp_power. current_max_ma holds, too."""
    feed_along_path: bool = False
    """Change the feed along a bead where its wire would be under wire_speed_min_mm_s or over wire_speed_max_mm_s, within the
    windows of feed, travel and line energy. `live` and `relayer` set it for layers on a measured surface to which one feed leaves
    too little room."""
    travel_window_mm_s: Annotated[tuple[TravelSpeed, TravelSpeed], AfterValidator(_in_order)] = (1.0, 100.0)
    """Least and greatest speed along a bead."""
    bead_section_mm2: Annotated[tuple[Metal, Metal], AfterValidator(_in_order)] = (0.5, 60.0)
    """Least and greatest metal of a bead over its length: section of the wire times wire speed over travel speed."""
    metal_energy_j_mm3: Annotated[tuple[LineEnergy, LineEnergy], AfterValidator(_in_order)] = (10.0, 600.0)
    """Least and greatest energy of the beam over the wire that it melts, P / (section of the wire x wire speed). Ten is what
    titanium or steel needs to be molten at all."""
    least_wall_mm: Width | None = None
    """Thinnest wall that may be built: a thinner one of the part is a fault. None: none is, but walls are told of that are thinner
    than bead_width_mm, or than as much less as wire_speed_min_mm_s is under the wire speed of a layer."""
    least_hole_mm: Width | None = None
    """Narrowest hole, slot, gap or notch that may be built: a narrower one of the part is a fault. None: none is, but those are
    told of that are narrower than bead_width_mm, since the melt of the beads around them bridges them. Who wants them filled, to be
    drilled later, sets a width under theirs."""
    base: Literal["cooled", "insulated"] = "cooled"
    """What the heat model assumes under the base plate: a table that keeps its temperature, or no heat flow."""
    base_plate_mm: Annotated[float, Between(0.1, 5000.0)] = 25.0
    """Thickness of the plate on which the part is built: depth of the heat model under height 0."""
    ambient_temperature_k: Temperature = 293.15
    """Temperature of the chamber, to which the part radiates."""
    surface_temperature_k: Temperature = 900.0
    """Temperature at which the radiation of the layer is made linear."""
    mass_tolerance: Off = 0.02
    """Share by which the metal of a program, and of each of its layers, may be off that of the sections, and by which the layers
    may add to the solid or leave out of it."""
    inside_tolerance: Off = 0.03
    """Share by which the mean height of the metal may be off that of the layer further than a bead width from the border."""
    edge_tolerance: Off = 0.1
    """The same within a bead width of the border."""
    outside_share: Off = 0.05
    """Share of a program's metal that may lie beside the sections and the allowance for machining; three times that of a
    layer. A bead along a contour lies inside of it; what is outside is where walls are thinner than a bead."""
    outside_reach_mm: Annotated[float, Between(0.001, 100.0)] = 1.0
    """How far beside them a bead may reach: the unevenness of a side as it is built, which is machined off."""
    surface_tolerance_mm: Annotated[float, Between(0.001, 100.0)] | None = None
    """How far the surface may come to lie over or under its height while it is built; None: half a bead width, which is
    about as deep as the pool: beyond, the wire melts over the pool or runs into the part."""
    bead_width_mm: Width = 6.0
    """Width of one bead."""
    bead_spacing: Annotated[float, Between(0.05, 1.0)] = 0.72
    """Distance between parallel beads over the bead width."""
    machining_allowance_mm: Annotated[float, Between(0.0, 100.0)] = 0.0
    """Metal left on the contour for machining: contour beads lie outward by this; at most their inset."""
    contour_direction: Literal["same", "alternating"] = "same"
    """Direction of contour beads: outer ones counter-clockwise and inner ones clockwise in every layer (same), or turned over in
    every second layer (alternating), so that starts, ends and the pull of the melt do not all lie one way."""
    overlap_mm: Length = 0.0
    """Length by which a closed contour bead runs on over its own start, at most once around."""
    seam_shift_mm: Length = 0.0
    """Way along a contour from the seam below to its start, so that seams do not lie on top of each other."""
    ramp_up_mm: Length = 0.0
    """Length at the start of a bead along which the beam rises to full power."""
    crater_fill_mm: Length = 0.0
    """Length at the end of a bead along which the beam falls, so that the crater is filled."""
    ramp_power: Share = 0.5
    """Share of the full power at which a ramp begins, and at which a crater fill ends. The wire runs along both: so little that it
    does not melt is found (process.metal_energy_j_mm3)."""
    ramp_steps: Annotated[int, Between(1, 50)] = 4
    """Steps of power along a ramp."""
    ramp_up_window_s: Annotated[tuple[Seconds, Seconds], AfterValidator(_not_falling)] | None = None
    """Least and greatest time that the beam takes from the start of a bead to its full power, by feed and length as they stand
    in the program; None: measured and told, not limited. A bead under the length of both ramps may take less."""
    crater_fill_window_s: Annotated[tuple[Seconds, Seconds], AfterValidator(_not_falling)] | None = None
    """The same of the time from the full power to the end of a bead."""
    wire_retract_mm: Annotated[float, Between(0.0, 1000.0)] = 0.0
    """Wire drawn back at the end of a bead, so that it does not freeze in. The feeder, or the codes of `machine.wire_start`, have
    to feed it forward again: no other block does."""
    layer_pause_s: Annotated[float, Between(0.0, 1e6)] = 0.0
    """Least wait between two layers with the beam off; `interpass` makes it longer where the part is too hot."""
    longest_wait_s: Annotated[float, Between(1.0, 1e6)] = 14400.0
    """Longest wait that a program may have in one place: four hours, after which a plan waits no further. A longer one is a slip,
    or leaves the part colder than its power was planned for."""
    interpass: Literal["dwell", "power", "both", "off"] = "both"
    """What keeps the part cool: waits before layers and beads (dwell), less power as it gets warm (power), power first
    and waits where the least power is still too much (both), or nothing (off)."""
    interpass_limit_k: Temperature | None = None
    """Temperature over which no bead may be entered; None: that of the material. With `interpass` off, the solidus."""
    least_entry_temperature_k: Temperature | None = None
    """Temperature under which no bead may be entered; None: no wait may leave a bead less than 0.6 of the rise of the limit over
    the chamber, or of the bead before where that is less."""
    pyrometer_limit_k: Annotated[float, Between(1.0, 1000.0)] = 150.0
    """How far a measured temperature of the surface may lie off the model, which it then corrects (`live`); beyond it is
    refused."""
    interpass_at: Literal["bead", "layer"] = "bead"
    """Where the limit holds: wherever the beam comes on, at contours, islands and their further beads, which may be waited
    for within a layer, too, or at the first bead of each layer alone."""
    power_schedule: Literal["taper"] | PowerTable = "taper"
    """Share of the beam's power: full on the cold base and, by the heat of the plan, down to the least at which the wire
    melts (taper); or a table of heights over the plate and shares, linear between, [[0, 1], [60, 0.5]]."""
    melting_efficiency: Share = 0.37
    """Share of the absorbed power that melts metal; the rest is conducted away. 0.37 (1/e) is the most that a point source
    moving over a thick body reaches, 0.48 a line through a sheet (Swift-Hook and Gick 1973; Okada 1977), nominal."""
    dilution: Annotated[float, Between(0.0, 0.999)] = 0.5
    """Share of remelted metal in the melt pool, the rest is wire: half, as of flat beads that overlap by 0.72 (nominal)."""
    least_seam_distance_mm: Length = 0.0
    """Least distance between the starts of contours in neighbouring layers; 0: not limited."""
    travel_sectors_deg: tuple[tuple[Angle, Angle], ...] = ()
    """Directions of travel that a side feeder allows, each from an angle counter-clockwise to another; empty: all."""
    keep_out: tuple[KeepOut, ...] = ()
    """Places that no bead and no rapid below their top may enter."""
    largest_overhang_deg: Annotated[float, Between(0.01, 89.99)] | None = None
    """Greatest angle from the vertical at which a slope may reach out over the layer below. Whatever it is, and where none is
    set, a layer reaches out by the width of a bead at most, so that no bead has nothing at all under it."""

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
    def largest_unevenness_mm(self) -> float:
        """How far the surface may lie over or under its height, mm."""
        return 0.5 * self.bead_width_mm if self.surface_tolerance_mm is None else self.surface_tolerance_mm

    @property
    def bead_metal_mm(self) -> float:
        """Width of a rectangle as high as one bead by itself and of the same section, mm."""
        return PARABOLA * self.bead_width_mm

    @property
    def bead_height_mm(self) -> float:
        """Height of one bead from the mass balance, mm."""
        return bead_height_mm(self.wire_diameter_mm, self.wire_speed_mm_s, self.travel_speed_mm_s, self.bead_width_mm)

    @field_validator("power_schedule")
    @classmethod
    def _rising(cls, value: str | tuple[tuple[float, float], ...]) -> str | tuple[tuple[float, float], ...]:
        if not isinstance(value, str) and any(a[0] >= b[0] for a, b in itertools.pairwise(value)):
            raise ValueError("give the heights of power_schedule in rising order")
        return value

    @model_validator(mode="after")
    def _limits_in_order(self) -> Self:
        _in_order(
            (self.wire_speed_min_mm_s, self.wire_speed_max_mm_s),
            "wire_speed_min_mm_s is not under wire_speed_max_mm_s: ",
        )
        least_k, limit_k = self.least_entry_temperature_k, self.interpass_limit_k
        if least_k is not None and limit_k is not None and least_k >= limit_k:
            raise ValueError(f"least_entry_temperature_k {least_k:g} is not under interpass_limit_k {limit_k:g}")
        if self.current_ma > self.current_max_ma:
            raise ValueError(f"current_ma {self.current_ma} is over current_max_ma {self.current_max_ma}")
        return self


# Area of a parabolic bead over its width times its height (Pixner et al. 2020, Materials 13:3310)
PARABOLA = 2.0 / 3.0


def bead_height_mm(
    wire_diameter_mm: float, wire_speed_mm_s: float, travel_speed_mm_s: float, bead_width_mm: float
) -> float:
    """Height of one bead from the mass balance ``v_wire pi d^2 / 4 = v_travel A`` with ``A = 2/3 w h``.

    >>> round(bead_height_mm(1.6, 2000 / 60, 10.0, 6.0), 2)
    1.68
    """
    area_mm2 = wire_speed_mm_s * math.pi * wire_diameter_mm**2 / 4.0 / travel_speed_mm_s
    return area_mm2 / (PARABOLA * bead_width_mm)
