"""Settings of the machine: its control, its limits and its axes, a tilt table with the part that stands on it, and its OPC UA
server."""

from __future__ import annotations

import math
import re
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

import numpy as np
from pydantic import Field, field_validator, model_validator

from ebamcheck.settings.base import Between, Length, Place, Section

Speed = Annotated[float, Between(0.001, 1e6)]  # speed of an axis or along a path, mm/s
Acceleration = Annotated[float, Between(0.01, 1e7)]  # acceleration of an axis, mm/s2
Jerk = Annotated[float, Between(0.1, 1e12)]  # jerk of an axis, mm/s3
Increment = Annotated[float, Between(0.0, 1000.0)]  # least step of a process value
PRINTED_PATH_MM = 1e-4  # distance that a path may have from its curve for the decimals of the program
# Error of a printed path in units of its last decimal: half a unit of the end point, and 0.635 times half a unit of the coefficients of a
# polynomial, in X and in Y
ROUNDING_UNITS = 1.2


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
    line_tolerance_mm: Annotated[float, Between(1e-6, 10.0)] = 0.01
    """Distance from the curve where it is written as chords or arcs."""
    decimals: Annotated[int, Between(3, 8)] | None = None
    """Decimals of coordinates and coefficients in the program; None: the fewest whose rounding keeps the path within
    a tenth of every tolerance, six with the defaults."""
    feed_increment_mm_min: Increment = 0.0
    """Least step in which the control takes a feed: the program holds multiples of it; 0: up to six decimals. As for the
    others, what the rounding changes is no fault of a check, and a value that is no multiple is one."""
    power_increment_w: Increment = 0.0
    """The same of the beam's power, for templates with {power_w}."""
    voltage_increment_kv: Increment = 0.0
    """The same of the accelerating voltage."""
    current_increment_ma: Increment = 0.0
    """The same of the beam current."""
    wire_increment_mm_s: Increment = 0.0
    """The same of the wire speed."""
    travel_min_mm: tuple[Place, Place, Place] = (-1000.0, -1000.0, 0.0)
    """Software limits of X, Y and Z in the work offset: least positions."""
    travel_max_mm: tuple[Place, Place, Place] = (1000.0, 1000.0, 1500.0)
    """Software limits of X, Y and Z in the work offset."""
    base_plate_min_mm: tuple[Place, Place] | None = None
    """Least X and Y of the base plate in the work offset, such as [-300, -200]; None: not known, and not checked."""
    base_plate_max_mm: tuple[Place, Place] | None = None
    """Greatest X and Y of the base plate; together with base_plate_min_mm."""
    work_offset: Literal["G54", "G55", "G56", "G57"] = "G54"
    """Settable work offset in which the program runs."""
    length_unit: Literal["G71", "G710"] = "G710"
    """Millimetres on a SINUMERIK: G710 for positions and feeds alike; G71 for positions alone, where feeds are in the unit
    that the control was set up in. G70 and G700 (inches) are refused."""
    safe_height_mm: Annotated[float, Between(0.01, 1e4)] = 20.0
    """Rise above the current layer for moves over more than one island gap, and at the end."""
    clearance_mm: Annotated[float, Between(0.01, 1e4)] = 5.0
    """What a travel longer than a hop keeps over all that stands: base plate, clamps, beads."""
    head_radius_mm: Length = 20.0
    """Radius of the head, gun nozzle and wire guide, as a cylinder around the axis of the tool."""
    head_above_tip_mm: Length = 15.0
    """Height of the head's lower face over the tip of the wire."""
    park_mm: tuple[Place, Place] = (0.0, 0.0)
    """X and Y at which the program ends, over all that stands; the nearest place of the travel where it is beyond it."""
    optional_stop: bool = False
    """Stop before each layer where the operator asks for it (M1), over the part, beam and wire off."""
    trailing_comments: bool = True
    """Write the comments that stand behind the codes of the templates."""
    program_limit_mb: Annotated[float, Between(1e-6, 1e6)] | None = None
    """Room for the program on the control, of 10^6 bytes; None: not known, and not checked."""
    spool_kg: Annotated[float, Between(1e-3, 1e6)] | None = None
    """Wire on the spool that can be fed, kg; None: not known, and not checked. With optional_stop a new spool of as much may
    be put on before any layer."""
    cathode_h: Annotated[float, Between(1e-3, 1e6)] | None = None
    """Hours that the gun's cathode lasts with the beam on; None: not known, and not checked. With optional_stop a new one may
    be put in before any layer."""
    rapid_mm_s: Speed = 100.0
    """Speed of rapid moves, for times only; G0 itself carries no feed."""
    feed_min_mm_s: Speed = 1.0
    """Least feed that a program may command."""
    feed_max_mm_s: Speed = 50.0
    """Greatest feed that a program may command."""
    smoothing: tuple[str, ...] = ("SOFT", "FFWON", "G642")
    """Words of the block that sets acceleration, feed-forward and corner rounding. One of them has to keep the path within
    smoothing_tolerance_mm: G60, G642, G643 or G645."""
    smoothing_tolerance_mm: Annotated[float, Between(1e-6, 10.0)] = 0.05
    """Axis tolerance of G642 (CTOL): the path driven may leave the path programmed by this."""
    workpiece_directory: str = "EBAMCHECK"
    """Name of the WPD folder on the control."""
    program_name: str = "MAIN"
    """Base name of the main program; the part's name is not a legal NC name in general."""
    beam_codes: tuple[str, ...] | None = None
    """What the codes of the beam mean, "CODE: MEANING" with on, off, voltage_kv, current_ma or power_w; such as "M60: on",
    "H2: current_ma", "M68 E1 Q: current_ma". None: the stock codes of the control, and those of the templates below, by
    the placeholder that they carry. A template whose codes mean something else than its name says is refused."""
    wire_codes: tuple[str, ...] | None = None
    """The same of the wire, with on, off, wire_mm_s or wire_retract_mm."""
    aux_codes: tuple[str, ...] = ()
    """Other codes that templates may hold: M and H codes that move nothing and change neither beam nor wire, such as "M77"
    or "H9". All else in a template is refused, and so is an axis, a mode, a feed or a tool behind a code."""
    # Templates: {power_w} {voltage_kv} {current_ma} {wire_mm_s} {wire_retract_mm} {feed_mm_min} {layer_pause_s}
    # {layer} {height_mm} are filled in; {defocus} in set_focus alone.
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
    set_wire: tuple[str, ...] = ("H3={wire_mm_s} ; wire speed, mm/s",)
    """Blocks that change the speed of the running wire, where a bead needs more or less of it along itself."""
    wire_stop: tuple[str, ...] = ("M63 ; wire off",)
    """Blocks that stop the wire."""
    wire_retract: tuple[str, ...] = ("H4={wire_retract_mm} ; wire drawn back, mm",)
    """Blocks that draw the stopped wire back, where the process asks for it."""
    layer_pause: tuple[str, ...] = ("G4 F{layer_pause_s} ; wait, s",)
    """Blocks that wait between two layers, where the process asks for it."""
    set_focus: tuple[str, ...] = ()
    """Blocks that set the focus of the beam to {defocus}, such as "H5={defocus} ; focus": for preheating, 0 for beads. Empty: the
    machine has none."""
    layer_begin: tuple[str, ...] = ()
    """Blocks before the first motion of a layer."""
    layer_end: tuple[str, ...] = ()
    """Blocks after the last motion of a layer."""
    tilt_axes: bool = False
    """The machine can turn the part between layers. Off and without rotary, `relayer --direction` is refused."""
    rotary: Annotated[tuple[RotaryAxis, ...], Field(max_length=2)] = ()
    """Rotary axes of its tilt table, from the machine's bed to the plate: the second is carried by the first. With them the program
    of a turned layer turns the table and sets the frame; without them the user does."""
    live_r: Annotated[int, Between(0, 990)] = 100
    """First of the R parameters by which a main program that waits between layers (`run --live`) and `live` agree: layers done,
    layer released (-1: the part is built), number of its program, least wait before it, two of the program's own, and, as the
    twelfth and thirteenth, key and seal of the release."""
    live_poll_s: Annotated[float, Between(0.01, 60.0)] = 0.5
    """How often that program looks whether its next layer is released."""
    live_timeout_s: Annotated[float, Between(1.0, 1e6)] = 1800.0
    """Time without a released layer after which it switches wire and beam off and says so."""
    live_late: Literal["stop", "end"] = "stop"
    """What it does then: stops (M0), and waits anew when the operator starts it again, or parks the tool and ends (M30)."""

    @property
    def printed_decimals(self) -> int:
        """Decimals of the program: those set, else the fewest that keep the path within a tenth of every tolerance."""
        if self.decimals is not None:
            return self.decimals
        least_mm = min(PRINTED_PATH_MM, self.smoothing_tolerance_mm, self.line_tolerance_mm)
        return min(max(math.ceil(-math.log10(0.1 * least_mm / ROUNDING_UNITS)), 3), 8)

    @property
    def park_position_mm(self) -> tuple[float, float]:
        """X and Y at which the program ends, within the travel."""
        x, y = np.clip(self.park_mm, self.travel_min_mm[:2], self.travel_max_mm[:2]).tolist()
        return x, y

    @field_validator("layer_pause")
    @classmethod
    def _one_wait(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        # The reader adds up the waits that it finds.
        if "".join(line.split(";", 1)[0] for line in value).count("{layer_pause_s}") != 1:
            raise ValueError("give {layer_pause_s} in one block, once: the wait is read back from it")
        return value

    @field_validator("program_name", "workpiece_directory")
    @classmethod
    def _legal_name(cls, value: str) -> str:
        legal = re.fullmatch(r"([A-Z]{2}|_[A-Z])[A-Z0-9_]{0,17}|O[0-9]{4,8}", value)
        if not legal or value in ("CON", "PRN", "AUX", "NUL"):  # devices
            raise ValueError(
                "an NC name has 2 to 19 characters of A-Z, 0-9 and _, and starts with two letters or an underscore and a letter; "
                "or it is the number of a program, such as O0001"
            )
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if any(a >= b for a, b in zip(self.travel_min_mm, self.travel_max_mm, strict=True)):
            raise ValueError("travel_min_mm must be under travel_max_mm on every axis")
        low, high = self.base_plate_min_mm, self.base_plate_max_mm
        crossed = low and high and any(a >= b for a, b in zip(low, high, strict=True))
        if (low is None) != (high is None) or crossed:
            raise ValueError("give base_plate_min_mm and, over it on both axes, base_plate_max_mm; or neither")
        if self.safe_height_mm < self.clearance_mm:
            raise ValueError("safe_height_mm must be at least clearance_mm: travel would not clear the beads")
        names = [axis.name for axis in self.rotary]
        if len(set(names)) < len(names):
            raise ValueError(f"rotary: the axis {names[0]} stands there twice")
        if self.feed_min_mm_s >= self.feed_max_mm_s:
            raise ValueError("feed_min_mm_s must be under feed_max_mm_s")
        licensed = {"poly": self.poly_licensed, "bspline": self.bspline_licensed}
        if not licensed.get(self.curve_form, True):
            raise ValueError(
                f"curve_form {self.curve_form!r} needs machine.{self.curve_form}_licensed: the control is said not to have that option"
            )
        return self


class KinematicsSettings(Section):
    """What the axes can do: limits by which the feed along the path is worked out (`ebamcheck.kinematics`).

    The defaults are those of a heavy gantry, with the jerk that a SINUMERIK is delivered with (SOFT).
    """

    axis_speed_mm_s: tuple[Speed, Speed, Speed] = (200.0, 200.0, 100.0)
    """Greatest speeds of X, Y and Z."""
    axis_acceleration_mm_s2: tuple[Acceleration, Acceleration, Acceleration] = (1000.0, 1000.0, 500.0)
    """Greatest accelerations of X, Y and Z."""
    axis_jerk_mm_s3: tuple[Jerk, Jerk, Jerk] = (20000.0, 20000.0, 10000.0)
    """Greatest jerks of X, Y and Z."""
    speed_jump_mm_s: Annotated[float, Between(0.0, 1000.0)] = 0.1
    """Step of speed that an axis takes at a corner without being told to smooth it."""
    curvature_share: Annotated[float, Between(0.001, 0.999)] = 0.8
    """Share of the acceleration that may go into curvature; sqrt(1 - share^2) of it is left for the feed."""
    dip_share: Annotated[float, Between(0.001, 0.999)] = 0.95
    """Where the feed falls under this share of the feed programmed, the bead grows: a dip."""


# -- a tilt table ----------------------------------------------------------------------------------

Component = Annotated[float, Between(-1e6, 1e6)]  # component of a direction, of any length but 0

Triple = tuple[Place, Place, Place]

ROUNDING = 1e-9  # of the digits of a settings file: rows of a rotation may be so far off


class RotaryAxis(Section):
    """A rotary axis of a tilt table: how it is programmed, and the line about which it turns the plate."""

    name: Annotated[str, Field(pattern="^[ABC][0-9]{0,2}$")]
    """Address in the program: A, B or C, or one with a number, such as C1, which is written with an equals sign."""
    axis: tuple[Component, Component, Component]
    """Direction of its line in the work offset, of any length but 0, where all rotary axes stand at 0."""
    point_mm: Triple
    """A place on that line in the work offset; Z counts from the surface of the base plate."""
    min_deg: Annotated[float, Between(-36000.0, 36000.0)] = -180.0
    """Least position."""
    max_deg: Annotated[float, Between(-36000.0, 36000.0)] = 180.0
    """Greatest position."""
    sign: Literal[1, -1] = 1
    """1: towards greater positions the plate turns counter-clockwise for one who looks against the direction of the line; -1:
    clockwise. Try it on the machine: a wrong one turns the part the other way."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not np.linalg.norm(self.axis) > 0.0:
            raise ValueError(f"rotary axis {self.name}: axis {self.axis} is no direction")
        if not self.min_deg <= 0.0 <= self.max_deg or self.min_deg == self.max_deg:
            raise ValueError(
                f"rotary axis {self.name}: min_deg {self.min_deg:g} and max_deg {self.max_deg:g} leave no room about 0, where the table "
                "stands before and after"
            )
        return self


class OnTable(Section):
    """How the part of a program stands on a tilt table: `ebamcheck` writes it to the settings of a layer of a turned part."""

    direction: tuple[Component, Component, Component]
    """Slicing direction, in the coordinates of the file, that points up where all rotary axes stand at 0: that of the layers
    before."""
    turn: tuple[Triple, Triple, Triple]
    """Rows are the directions of X, Y and Z of the table in the coordinates of the program."""
    shift_mm: Triple
    """Place of the table's zero (that of the work offset) in the coordinates of the program: there p @ turn + shift_mm is what p is
    on the table."""
    low_mm: Triple
    """Least corner of the part's box on the table."""
    high_mm: Triple
    """Greatest corner of the part's box on the table."""
    built_mm: Annotated[float, Between(0.0, 1e6)] = 0.0
    """Height over the base plate up to which it was built along `direction` before it was turned."""

    @field_validator("turn")
    @classmethod
    def _rotation(cls, value: tuple[Triple, Triple, Triple]) -> tuple[Triple, Triple, Triple]:
        turn = np.array(value, np.float64)
        if np.abs(turn @ turn.T - np.eye(3)).max() > ROUNDING or np.linalg.det(turn) < 0.0:
            raise ValueError("turn: is no rotation")
        return value


Seconds = Annotated[float, Between(0.01, 1e6)]  # time to wait, s

ROLES = (
    "done", "released", "number", "wait", "waited", "height",
    "measured", "begin_at", "owner", "digest", "key", "seal",
)  # fmt: skip
"""What the nodes of the handshake are called here, in the order in which their R parameters follow on ``machine.live_r``,
where that of the time left (R5) is left out: the program alone uses it."""

# Further nodes, of text, which a control has only where the settings name them
TEXT_ROLES = ("name", "sha256", "map")

WARMTH_ROLES = ("surface_k", "after_s")  # the same of numbers, of a pyrometer


class OpcuaSettings(Section):
    """The control as an OPC UA server (`ebamcheck live RUN --opcua`); the defaults are those of a SINUMERIK 840D sl."""

    url: str = "opc.tcp://127.0.0.1:4840"
    """Address of the server of the control."""
    security: Literal["sign_and_encrypt", "sign", "none"] = "sign_and_encrypt"
    """How messages are protected. `none` is for a desk: it takes no password and needs `anonymous`."""
    policy: Literal["Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss"] = "Basic256Sha256"
    """Security policy of the channel."""
    certificate: str = ""
    """File of our certificate, PEM or DER; needed unless security is `none`."""
    private_key: str = ""
    """File of its key, PEM or DER."""
    server_certificate: str = ""
    """File of the certificate of the control: no other server is spoken to. Needed unless security is `none`."""
    application_uri: str = "urn:ebamcheck:live"
    """Name of this program in its certificate."""
    user: str = ""
    """User of the control who may write R parameters and files; needed unless `anonymous`."""
    password_variable: str = "EBAMCHECK_OPCUA_PASSWORD"
    """Environment variable that holds the password: passwords do not belong into settings, which go into records."""
    password_file: str = ""
    """File that holds the password, where that variable is not set; readable by its owner alone."""
    anonymous: bool = False
    """Write without a user: for a desk alone."""
    r_node: str = "ns=2;s=/Channel/Parameter/R[u1,{r}]"
    """Node of an R parameter; {r} is its number."""
    nodes: dict[str, str] = Field(default={})
    """Nodes that are no R parameters, by what they are: done, released, number, wait, waited, height, measured, begin_at, owner,
    digest, key, seal (the waiting main program reads its own in R parameters); and, where the control has such variables for text,
    name and sha256, which are written, and map: the name of the file of a height map, which stands for the height where it is not
    empty; and surface_k and after_s, the temperature that a pyrometer read, K, and how long after the layer, s, which are used
    where the first is not 0."""
    methods_node: str = "ns=2;s=/Methods"
    """Object whose methods copy files."""
    upload_node: str = "ns=2;s=/Methods/CopyFileToServer"
    """Method that writes a file: name, content, whether one that is there is replaced."""
    download_node: str = "ns=2;s=/Methods/CopyFileFromServer"
    """Method that reads a file: name."""
    folder: str = "Sinumerik/FileSystem/Work Pieces/{directory}.WPD"
    """Folder of the programs on the control; {directory} is machine.workpiece_directory."""
    file_limit_mb: Annotated[float, Between(0.001, 1e4)] = 16.0
    """Greatest file that the control takes, of 10^6 bytes; a layer that is larger is not released."""
    replace: bool = False
    """Replace a file of another build that has the name of a layer. Off, the layer is kept back until somebody deletes it."""
    grid_s: Annotated[float, Between(0.01, 60.0)] = 0.1
    """Sampling and publishing interval of the subscription; a SINUMERIK knows 100 ms, 250 ms and more."""
    look_s: Annotated[float, Between(0.05, 600.0)] = 1.0
    """The values are read at least this often, whether the subscription reports or not."""
    request_s: Seconds = 10.0
    """Longest time for an answer of the control; after it the connection counts as lost."""
    retry_s: Seconds = 1.0
    """Time before the next try, of a connection or of a layer that was not taken; it doubles up to `longest_retry_s`."""
    longest_retry_s: Seconds = 30.0
    """Longest time between two tries."""
    late_s: Seconds = 600.0
    """Time after a layer is done, without its height, after which `live` says that it is late."""

    @field_validator("url")
    @classmethod
    def _is_a_url(cls, value: str) -> str:
        if not value.startswith("opc.tcp://") or "@" in value or len(value) <= len("opc.tcp://"):
            raise ValueError("give opc.tcp://HOST:PORT, without a user: that is opcua.user, its password in a variable")
        try:
            port = urlsplit(value).port
        except ValueError:
            port = None
        if not port:
            raise ValueError("no port from 1 to 65535: give opc.tcp://HOST:PORT, that of a SINUMERIK is 4840")
        return value

    @field_validator("nodes")
    @classmethod
    def _known_roles(cls, value: dict[str, str]) -> dict[str, str]:
        known = (*ROLES, *TEXT_ROLES, *WARMTH_ROLES)
        for role in value:
            if role not in known:
                raise ValueError(f"{role!r} is none of {', '.join(known)}")
        return value

    @field_validator("r_node")
    @classmethod
    def _has_its_number(cls, value: str) -> str:
        if value.count("{r}") != 1:
            raise ValueError("give the place of the number, {r}, once")
        return value

    @model_validator(mode="after")
    def _rising_waits(self) -> Self:
        if self.longest_retry_s < self.retry_s:
            raise ValueError("longest_retry_s must be at least retry_s")
        return self

    @property
    def problem(self) -> str:
        """What is missing for a connection that may write; empty: nothing."""
        if self.security == "none":
            if not self.anonymous:
                return "opcua.security is 'none': set opcua.anonymous for a desk; no password goes over an open channel"
            return ""
        for key in ("certificate", "private_key", "server_certificate"):
            if not getattr(self, key):
                return f"opcua.{key} is missing: give a file (the profile for a desk is written by `ebamcheck machine RUN --opcua`)"
        if not self.user and not self.anonymous:
            return "opcua.user is missing: nothing is written without a user unless opcua.anonymous is set"
        return ""
