"""Honest runs: parts, settings and controls for which no check may fail, with comments and without."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.faults.judging import Said, failures, strip
from benchmarks.faults.kinds import SINUMERIK
from benchmarks.faults.subjects import CONTROLS, SUBJECTS, Workshop
from ebamcheck.atomic_file import replacing
from ebamcheck.program import Check
from ebamcheck.verification.verify import verify_against_part, verify_run

LETTERS = 90
"""Letters of what a check says that are kept."""

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

PARTS = {
    **dict.fromkeys(("arcs", "lines", "ramps", "overlap", "allowance"), "bored"),
    **dict.fromkeys(("retract", "dwell"), "cube"),
    **dict.fromkeys(("stripes", "whole", "decimals", "offset"), "prism"),
}
"""Part on which each of the other settings is tried, for every control."""

LISTED: tuple[tuple[str, str, str], ...] = (
    *((part, control, "") for part in SUBJECTS for control in CONTROLS),
    *(
        (part, CONTROLS[(turn + n) % len(CONTROLS)], how)
        for turn in range(len(CONTROLS))
        for n, (how, part) in enumerate(PARTS.items())
    ),
    *((part, SINUMERIK, "bspline") for part in ("bored", "torus", "two-spheres")),
)
"""Part, control and settings of each honest run."""


def honest_runs(workshop: Workshop, folder: Path) -> Iterator[tuple[str, str]]:
    """Name of each honest run, and the false alarms of it in words; what is known of this code is not made again."""
    folder.mkdir(parents=True, exist_ok=True)
    for part, control, how in LISTED:
        name = f"{part}/{control}/{how or 'default'}"
        memory = folder / f"honest-{name.replace('/', '-')}.txt"
        if not memory.is_file():
            alarms = _alarms(workshop, workshop.folder, part, control, how)
            with replacing(memory) as temporary:
                temporary.write_text(alarms, encoding="utf-8")
        yield name, memory.read_text(encoding="utf-8")


def _alarms(workshop: Workshop, folder: Path, part: str, control: str, how: str) -> str:
    """What is said against a run by its own gates, and by its verification in three ways."""
    settings = SETTINGS.get(how, {})

    def made() -> list[Check]:  # errors of the run are alarms
        workshop.finished(SUBJECTS[part], control, **settings)
        return []

    said: dict[str, list[Said]] = {"run": failures(made)}
    if not said["run"]:
        run = workshop.finished(SUBJECTS[part], control, **settings)
        alone = folder / "honest" / "program"
        shutil.rmtree(alone.parent, ignore_errors=True)
        shutil.copytree(run.run / "program", alone)
        said["verify"] = failures(lambda: verify_run(run.run, run.part))
        said["text"] = failures(lambda: verify_against_part(alone, run.part, run.config))
        strip(alone)
        said["bare text"] = failures(lambda: verify_against_part(alone, run.part, run.config))
    return "; ".join(
        f"{way}: {', '.join(f'{s.check} ({s.where} {s.text[:LETTERS]})' for s in some)}"
        for way, some in said.items()
        if some
    )
