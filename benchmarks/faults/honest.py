"""Honest runs: parts, settings and controls for which no check may fail, with comments and without."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.faults.finished import Workshop
from benchmarks.faults.judging import Said, failures, strip
from benchmarks.faults.subjects import CONTROLS, SUBJECTS
from ebamcheck.pipeline.verify import verify_against_part, verify_run

SINUMERIK, LINUXCNC, PLAIN = CONTROLS

SETTINGS: dict[str, dict[str, dict[str, Any]]] = {
    "bspline": {"machine": {"curve_form": "bspline"}},
    "arcs": {"machine": {"curve_form": "arcs"}},
    "lines": {"machine": {"curve_form": "lines"}},
    "ramps": {"process": {"ramp_up_mm": 4.0, "crater_fill_mm": 5.0}},
    "overlap": {"process": {"overlap_mm": 6.0, "seam_shift_mm": 9.0}},
    "allowance": {"process": {"machining_allowance_mm": 1.0}},
    "retract": {"process": {"wire_retract_mm": 5.0}},
    "dwell": {"process": {"interpass": "dwell", "power_schedule": ((0.0, 1.0), (60.0, 0.8))}},
    "stripes": {"scan": {"partition": "stripes", "order": "raster"}},
    "whole": {"scan": {"partition": "whole"}},
    "decimals": {"machine": {"decimals": 4}},
    "offset": {"machine": {"work_offset": "G56", "safe_height_mm": 35.0}},
}
"""Settings beside the default ones."""

LISTED: tuple[tuple[str, str, str], ...] = (
    *((part, control, "") for part in SUBJECTS for control in CONTROLS),
    *(
        ("bored", control, how)
        for control in CONTROLS
        for how in ("arcs", "lines", "ramps", "overlap", "allowance")
    ),
    *(("two-spheres", control, how) for control in CONTROLS for how in ("retract", "dwell")),
    *(("prism", control, how) for control in CONTROLS for how in ("stripes", "whole", "decimals", "offset")),
    *((part, SINUMERIK, "bspline") for part in ("bored", "torus", "two-spheres")),
)
"""Part, control and settings of each honest run."""


@dataclass(frozen=True)
class Honest:
    """An honest run, and what is said against it."""

    name: str
    said: dict[str, tuple[Said, ...]] = field(default_factory=dict)
    """By way of verification, and `run` for the gates of the run itself."""

    @property
    def alarm(self) -> str:
        """The false alarms in words; empty if there is none."""
        return "; ".join(
            f"{way}: {', '.join(f'{s.check} ({s.where} {s.text[:90]})' for s in said)}"
            for way, said in self.said.items()
            if said
        )


def honest_runs(workshop: Workshop, folder: Path) -> Iterator[Honest]:
    """Make each run, and verify it three ways."""
    for part, control, how in LISTED:
        name = f"{part}/{control}/{how or 'default'}"
        error: list[Said] = failures(lambda: _made(workshop, part, control, how))  # noqa: B023
        if error:
            yield Honest(name, {"run": tuple(error)})
            continue
        made = workshop.finished(SUBJECTS[part], control, **SETTINGS.get(how, {}))
        said = {"verify": failures(lambda: verify_run(made.run, made.part))}  # noqa: B023
        for way in ("text", "bare text"):
            alone = folder / "honest" / "program"
            shutil.rmtree(alone.parent, ignore_errors=True)
            shutil.copytree(made.run / "program", alone)
            if way == "bare text":
                strip(alone)
            said[way] = failures(lambda: verify_against_part(alone, made.part, made.config))  # noqa: B023
        yield Honest(name, {way: tuple(some) for way, some in said.items()})


def _made(workshop: Workshop, part: str, control: str, how: str) -> list[Any]:
    workshop.finished(SUBJECTS[part], control, **SETTINGS.get(how, {}))
    return []
