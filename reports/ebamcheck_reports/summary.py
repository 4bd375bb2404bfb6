"""``summary.csv``: one flat row a gate, a finding, a backend, a pair and a check, so that many runs can be put under each other."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from typing import Any

from ebamcheck.atomic_file import replacing
from ebamcheck.record.run_folder import RunFolder
from ebamcheck_reports.run_data import RunData

NAME = "summary.csv"

# Figures that a kind of row does not have are empty; ``NaN`` and ``Infinity`` stand as in ``run.json``
COLUMNS = (
    "part", "part_sha256", "settings_sha256", "exit_code", "kind", "name", "backend", "against", "passed", "figure", "limit", "unit",
    "where", "text", "layers", "compared_layers", "agreeing_layers", "max_hausdorff_mm", "max_p95_mm", "max_area_difference_mm2", "min_iou",
)  # fmt: skip


def write(run: RunFolder) -> list[str]:
    """Write the file into the run folder and return its name."""
    data = RunData(run)
    part = data.part_of("part")
    common = {
        "part": part["name"],
        "part_sha256": part["sha256"] or part["mesh_sha256"],
        "settings_sha256": data.manifest["settings_sha256"],
        "exit_code": data.manifest["exit_code"],
    }
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
    table.writeheader()
    table.writerows({**common, **row} for row in rows(data))
    with replacing(run.path / NAME) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8", newline="")
    return [NAME]


def rows(run: RunData) -> Iterator[dict[str, Any]]:
    """Rows without the columns that all of them share."""
    for gate in run.gates:
        yield {"kind": "gate", **{k: gate[k] for k in ("name", "passed", "figure", "limit", "unit", "text")}}
    for found in run.findings:
        yield {
            "kind": "finding",
            "name": found["code"],
            "passed": found["severity"] != "fault",
            **{k: found[k] for k in ("figure", "limit", "unit")},
            "where": found["place"],
            "text": f"{found['severity']}: {found['text']}",
        }
    for name, record in run.backends.items():
        done = record["status"] == "done"
        yield {
            "kind": "backend",
            "name": name,
            "backend": name,
            "passed": done,
            "figure": record["error_bound_mm"],
            "unit": "mm error bound",
            "text": record["summary"] if done else f"{record['status']}: {record['why']}",
        }
    for pair in run.pairs:
        yield {
            "kind": "pair",
            "name": f"{pair['a']} - {pair['b']}",
            "backend": pair["a"],
            "against": pair["b"],
            "passed": pair["agree"] == pair["gated"] if pair["gated"] and run.compared else "",
            "figure": pair["max_depth_mm"],
            "limit": pair["limit_mm"],
            "unit": "mm depth",
            "layers": pair["layers"],
            "compared_layers": pair["gated"],
            "agreeing_layers": pair["agree"],
            **{k: pair[k] for k in ("max_hausdorff_mm", "max_p95_mm", "max_area_difference_mm2", "min_iou")},
        }
    for check in run.checks:
        yield {
            "kind": "check",
            "name": check["name"],
            **{k: check[k] for k in ("passed", "limit", "unit", "where", "text")},
            "figure": check["value"],
        }
