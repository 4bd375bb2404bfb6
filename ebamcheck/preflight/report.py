"""The preflight of a job: part, layer height, heights and all checks, made once and handed on.

A level face within a layer moves to one of its borders, so that metal is added or lacks there, unless the layer height divides its
height."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.kernels import Floats
from ebamcheck.layers.heights import cut_heights, nearest_fitting, share_off
from ebamcheck.mesh.inspection import Inspection, inspect
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import read_part
from ebamcheck.preflight.room import of_bodies, room_checks, sense_checks, sizes, suspicions
from ebamcheck.preflight.workload import RUN, Workload, work_checks, workload
from ebamcheck.result import Check, preflight_record
from ebamcheck.settings.config import Config
from ebamcheck.showing.short_text import counted

SPOOL = "wire on the spool"  # name of a check, here and of a program


@dataclass(frozen=True)
class Preflight:
    """All checks of a preflight."""

    checks: tuple[Check, ...]
    work: Workload

    @property
    def passed(self) -> bool:
        """Whether there is no fault; there may be warnings."""
        return all(check.level != "fault" for check in self.checks)

    @property
    def exit_code(self) -> ExitCode:
        """0, or 1 where there is a fault."""
        return ExitCode.PASS if self.passed else ExitCode.OUT_OF_TOLERANCE

    def as_dict(self) -> dict[str, Any]:
        """All checks and the estimate, for JSON."""
        checks = [preflight_record(check) for check in self.checks]
        return {"passed": self.passed, "checks": checks, "work": asdict(self.work)}

    def stop(self, job: str) -> None:
        """Refuse a job that cannot come to a good end: the SettingsError tells the first fault that stops it, how many more there
        are, and what to do."""
        faults = [check for check in self.checks if check.level == "fault" and job in check.stops]
        if not faults:
            return
        first, more = faults[0], f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        said = f"{first.name}: {first.text}{more}: {first.remedy}"
        raise SettingsError(f"preflight: {said}; `ebamcheck preflight` shows all")


@dataclass(frozen=True, eq=False)
class Ready:
    """A part that is ready to be sliced, as placed, with its inspection, the settings of the job with the layer height that a run
    takes where they leave it open, and the heights (L,) of the cuts, mm. `turned` facets were turned over; `fitted` tells of a
    layer height chosen for the part."""

    part: Part
    turned: int
    found: Inspection
    config: Config
    heights: Floats
    preflight: Preflight
    fitted: str = ""


def ready(path: str | Path, config: Config, job: str = RUN, yes: bool = False) -> Ready:
    """Read and place a part (a mesh file, or ``plate.toml``), and look at all that can be known before it is sliced for a ``run``
    or a ``check``; with `yes` more work than the settings allow is a warning."""
    part, turned = read_part(path, config.part)
    found = inspect(part)
    chosen = chosen_height(part, found.passed, config) if job == RUN else None
    config = chosen.config if chosen else config
    heights = cut_heights(part, config)
    work = workload(part, heights, config, job)
    checks = _checks(part, found, heights, work, config, yes, [chosen.check] if chosen else [])
    fitted = chosen.check.text if chosen and chosen.fitted else ""
    return Ready(part, turned, found, config, heights, Preflight(tuple(checks), work), fitted)


def _checks(
    part: Part,
    found: Inspection,
    heights: Floats,
    work: Workload,
    config: Config,
    yes: bool,
    of_layers: Sequence[Check],
) -> Iterator[Check]:
    yield _mesh(found)
    yield from (replace(finding, name="bodies") for finding in of_bodies(found))
    yield from _units(found, config)
    yield _thickness(found, config)
    if config.machine.spool_kg is not None and found.passed:
        yield _wire(part, config.machine.spool_kg, config)
    yield from of_layers
    step = float(heights[1] - heights[0]) if len(heights) > 1 else config.layer_height_mm
    layers_mm = float(heights[-1] - heights[0]) + step
    yield from room_checks(part, config, layers_mm)
    yield from sense_checks(config)
    yield from work_checks(work, config, yes)


def _mesh(found: Inspection) -> Check:
    bodies = counted(found.bodies, "body", "bodies")
    # What is to be done stands behind what was found, where the verdict knows more than that the mesh is to be mended.
    why, _, remedy = found.why.partition("; ")
    text = f"{counted(found.facets, 'facet')}, {bodies}: {found.verdict}, {why}"
    if found.passed:
        return Check.preflight("mesh", "pass", text, 0.0, 0.0, "faults")
    return Check.preflight("mesh", "fault", text, 1.0, 0.0, "faults", remedy or "mend the mesh")


def _units(found: Inspection, config: Config) -> Iterator[Check]:
    told = [replace(finding, name="units") for finding in suspicions(found, config)]
    size = f"{sizes(found.size_mm)} mm, read as {found.units} ({found.units_from})"
    yield from told or [Check.preflight("units", "pass", size, max(found.size_mm), None, "mm")]


def _thickness(found: Inspection, config: Config) -> Check:
    thin, bead = min(found.size_mm[:2]), config.process.bead_width_mm
    text = f"{thin:.6g} mm across at its narrowest extent; a bead is {bead:g} mm wide"
    if thin >= bead:
        return Check.preflight("size against the bead", "pass", text, thin, bead, "mm")
    remedy = "use a narrower bead, allow for machining, or check the unit (--units)"
    return Check.preflight("size against the bead", "warning", text, thin, bead, "mm", remedy)


def _wire(part: Part, spool_kg: float, config: Config) -> Check:
    """What the part weighs is what its wire weighs: the program is held to the same, to the motion in which it ends."""
    part_kg = part.volume * 1e-9 * config.material.density_kg_m3
    text = f"the part weighs {part_kg:.4g} kg, the spool holds {spool_kg:g} kg"
    if part_kg <= spool_kg or config.machine.optional_stop:
        return Check.preflight(SPOOL, "pass", text, part_kg, spool_kg, "kg")
    remedy = (
        "begin with a fuller spool (machine.spool_kg), or stop before layers to put on another (machine.optional_stop)"
    )
    return Check.preflight(SPOOL, "warning", text, part_kg, spool_kg, "kg", remedy)


# -- the height of layers --------------------------------------------------------------------------

NAME = "layer height"


class ChosenHeight(NamedTuple):
    """What the layers of a run are to be as high as, and why."""

    config: Config  # settings with the layer height that was chosen
    check: Check
    fitted: bool  # whether that is another height than a bead's


def chosen_height(part: Part, sound: bool, config: Config) -> ChosenHeight:
    """Settings of a run with a layer height that fits the part, where they leave it open; of a mesh that is not `sound`, nothing is
    known."""
    bead_mm, limit = config.layer_height_mm, config.process.mass_tolerance
    if config.layers.layer_height_mm is not None or config.layers.heights_mm or config.base_mm > 0.0:
        return _kept(config, f"{bead_mm:g} mm, as set" if not config.layers.heights_mm else "as listed")
    if not (sound and config.layers.fit_height):
        return _kept(config, f"{bead_mm:g} mm, that of a bead")
    share = share_off(part, config)
    if share <= limit:
        text = f"{bead_mm:g} mm, that of a bead: layers are off by {100.0 * share:.2f} % of the solid's metal"
        return ChosenHeight(config, Check.preflight(NAME, "pass", text, share, limit, "of the part"), False)
    found = nearest_fitting(part, config)
    if found is None:
        text = (
            f"layers of {bead_mm:g} mm, or of any other height near that, add {100.0 * share:.2f} % to the metal of the solid or "
            "leave as much out: level faces of the part lie within layers"
        )
        remedy = "list the layers (layers.heights_mm), or move the faces"
        check = Check.preflight(NAME, "warning", text, share, limit, "of the part", remedy)
        return ChosenHeight(config, check, False)
    text = (
        f"layers of {found.height_mm:g} mm in place of a bead's {bead_mm:g} mm, which would be off by {100.0 * share:.2f} % of the "
        f"solid's metal, since level faces lie within such layers; these are off by {100.0 * found.share:.2f} %"
    )
    fitting = config.changed(layers={"layer_height_mm": found.height_mm})
    return ChosenHeight(fitting, Check.preflight(NAME, "pass", text, found.share, limit, "of the part"), True)


def _kept(config: Config, text: str) -> ChosenHeight:
    check = Check.preflight(NAME, "pass", text, config.layer_height_mm, None, "mm")
    return ChosenHeight(config, check, False)
