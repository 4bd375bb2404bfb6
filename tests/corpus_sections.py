"""Sections of the meshes of the corpus, as other programs have measured them."""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path


def simple_sections(corpus: Path) -> dict[str, list[dict[str, str]]]:
    """Rows of the corpus's table by file, from below: of sections on whose area and loops all programs agree."""
    by_file = defaultdict(list)
    with (corpus / "REFERENCE.csv").open(newline="", encoding="utf-8") as table:
        for row in csv.DictReader(table):
            if row["simple"] == "1" and (corpus / row["file"]).exists():
                by_file[row["file"]].append(row)
    return {file: sorted(rows, key=lambda row: float(row["z"])) for file, rows in by_file.items()}
