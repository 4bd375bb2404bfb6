"""The job: makes all figures, one after the other."""

from __future__ import annotations

import os
import platform
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ebamcheck import __version__
from ebamcheck_reports.markup import Markup
from ebamcheck_reports.paper import bitmap, corners, partition, polar, timing
from ebamcheck_reports.paper.comparison import comparison
from ebamcheck_reports.paper.effort import Effort, Note
from ebamcheck_reports.paper.subject import find_subject


@dataclass(frozen=True)
class Reproduction:
    """Content of ``paper.json``, and the pictures of the page by section."""

    record: dict[str, Any]
    pictures: dict[str, list[Markup]]


def reproduce(effort: Effort, bunny: Path | None, units: str, note: Note) -> Reproduction:
    """Make every figure, beginning with the cheap ones that may fail on a given mesh.

    Parameters
    ----------
    effort
        How much is measured.
    bunny
        Mesh for Figures 3 to 8, or None for the stand-in.
    units
        Unit of its numbers.
    note
        Told what is being done.
    """
    subject = find_subject(bunny, units)
    note(f"figures 3 to 8: {subject.part.name}, layer {subject.layer + 1}")
    found = {
        "bitmap": bitmap.measure(subject),
        "corners": corners.measure(subject),
        "partition": partition.measure(subject),
        "polar": polar.measure(effort, note),
    }
    record: dict[str, Any] = {
        "ebamcheck": __version__,
        "effort": asdict(effort),
        "machine": {"system": platform.platform(), "processors": os.cpu_count()},
        "subject": {
            "part": subject.part.name,
            "about": subject.about,
            "facets": len(subject.part.faces),
            "size_mm": subject.part.size.tolist(),
            "sha256": subject.part.source_sha256 or subject.part.sha256,
        },
        **{name: values for name, (values, _) in found.items()},
        "timing": timing.measure(effort, note),
    }
    record["comparison"] = comparison(record)
    return Reproduction(record, {name: pictures for name, (_, pictures) in found.items()})
