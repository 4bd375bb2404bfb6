"""Settings of part, layers, slicing and comparison, of regression reports, and the slicers of each machine.

`ebamcheck select --write` writes the sections ``[machines.NAME]``; a run takes that of its own machine.
"""

from __future__ import annotations

import os
import platform
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field

from ebamcheck.settings.base import Angle, Between, NotNegative, Place, Section, Tolerance, known_as
from ebamcheck.settings.tilt import OnTable

if TYPE_CHECKING:
    from ebamcheck.settings.config import Config

Component = Annotated[float, Between(-1e6, 1e6)]
"""Component of a direction, of any length but 0."""


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


Count = Annotated[int, Between(1, 10**12)]
"""Number of things that a job makes."""


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


MACHINE_VARIABLE = "EBAMCHECK_MACHINE"
"""Environment variable that names the machine where its host name does not (in a container, say)."""


def machine_name() -> str:
    """Name of this machine: that of the environment variable ``EBAMCHECK_MACHINE``, else its host name."""
    return os.environ.get(MACHINE_VARIABLE, "") or platform.node() or "localhost"


def for_this_machine(config: Config) -> Config:
    """Return the settings with the choice of this machine in force.

    The primary slicer is that of the machine's section, and what it requires is required on top of what the
    settings require anyway. Without a section for this machine nothing changes. The sections themselves go, so that
    the hash of a run's settings does not depend on what other machines use.
    """
    choice = config.machines.of(machine_name())
    slicing = config.slicing
    if choice is not None:
        required = tuple(dict.fromkeys((*slicing.required, *choice.required)))
        slicing = slicing.model_copy(
            update={"primary": choice.primary or slicing.primary, "required": required}
        )
    return config.model_copy(update={"slicing": slicing, "machines": MachineSections()})
