"""Reference parts from mesh to program, judged by one table: ``python -m benchmarks.acceptance``; reports/metal/acceptance.md.

Every part goes through the pipeline as by ``ebamcheck run`` at the default settings, and where these refuse it, with its
remedy, too. Then the run folder is read as
anybody could: what the plan says of each layer (``process.csv``, the sums of its events) beside what the text says
(``program.csv``, the sums of its motions, and its wire starts); the metal of the text over the part's own sections and
over the exact volume of the solid; the greatest temperature at which a bead is entered, by the plan and by a balance
driven by the text alone; and what ``ebamcheck verify`` says of the run.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from benchmarks.figures import machine, markdown
from ebamcheck.pipeline import RunResult, run_job
from ebamcheck.plugins.registry import Model, models
from ebamcheck.program import read_program
from ebamcheck.settings.config import Config
from ebamcheck.verification.verify import verify
from ebamcheck_models import write_stl

PARTS = (
    "cube",
    "bracket",
    "thin-walls",
    "two-spheres",
    "prism",
    "torus",
    "impeller",
    "helical-channel",
    "bulkhead",
)
"""The nine reference parts: five that the default bead can build, and four that need a remedy."""

DEFAULTS = "defaults"
BACKENDS = ("planecut", "manifold")
MODEL_TOLERANCE_MM = 0.02


class Remedy(NamedTuple):
    """Settings with which a part that is refused at the default ones can be built, and why it needs them."""

    changes: dict[str, dict[str, Any]]
    why: str

    def __str__(self) -> str:
        """Say the settings as one writes them in a file."""
        return "; ".join(f"{table}.{key} = {v}" for table, keys in self.changes.items() for key, v in keys.items())


ALLOWANCE = {"process": {"machining_allowance_mm": 3.0}}
"""Half a bead of metal on every side, to be machined off: no wall is then narrower than a bead."""

REMEDIES = {
    "bracket": Remedy(ALLOWANCE, "the brace between its legs is 0.8 mm thick, and no bead is narrower than 3.2 mm"),
    "thin-walls": Remedy(ALLOWANCE, "its rungs are walls of 0.01 to 1 mm, and no bead is narrower than 3.2 mm"),
    "impeller": Remedy(ALLOWANCE, "the tips of its blades are thinner than 3.2 mm, and no bead is narrower"),
    "two-spheres": Remedy(
        {"part": {"direction": [-0.370623, -0.1076, 0.92253]}},
        "the smaller sphere begins 15 mm beside the larger one, in the air; along this direction both stand on the plate",
    ),
}

PAIRS = {
    "contour_mm": ("contour_mm",), "hatch_mm": ("hatch_mm", "turn_mm", "wall_mm", "gap_mm"), "travel_mm": ("travel_mm",),
    "deposit_s": ("deposit_s",), "travel_s": ("travel_s",), "pause_s": ("wait_s",), "wire_mm": ("wire_mm",),
}  # fmt: skip
"""Columns of the text's sums, and those of the plan's that make them up."""

MASS_SHARE = 0.02
"""Metal over the part, less 1, at most."""

DEFAULT_OUTPUT = Path("reports/metal")

TEXT = """# Reference parts from mesh to program

By `python -m benchmarks.acceptance`, backends {backends}, on {cpu}: every part at the default settings, and where they refuse it, with the remedy named below.

*plan and program*: the greatest difference of a layer's sums by the plan's events and by the text (lengths of contours, hatch and travel; times; waits; wire), over the greatest layer; and wire starts by both. *metal over sections*: what the text lays over the part's sections times the layer height, within {share:.0f} % asked for; *over solid*: over the exact volume of the solid, which layers of whole height cannot always meet. *entry*: the greatest temperature of the surface when a bead is entered, by the plan and by a balance of the text. *verify*: `ebamcheck verify` of the run folder, which has to pass if, and only if, the run is validated.

{table}
{causes}
{remedies}"""
"""Text of the report."""


def measured(result: RunResult, model: Model, config: Config) -> dict[str, Any]:
    """Figures of one run folder."""
    folder, manifest = result.folder.path, result.manifest
    program, checks = manifest.get("program", {}), manifest.get("program", {}).get("checks", [])
    shut = [gate for gate in result.gates if not gate.passed]
    found: dict[str, Any] = {
        "verdict": "VALIDATED" if program.get("validated") else "NOT VALIDATED",
        "gates": " ".join(gate.name for gate in shut),
        "cause": "; ".join(f"`{gate.name}`: {gate.text}" for gate in shut),
    }
    if not (folder / "program.csv").is_file():
        return found
    plan, text = pd.read_csv(folder / "process.csv"), pd.read_csv(folder / "program.csv")
    metal = pd.read_csv(folder / "deposit.csv")
    nc = read_program(next((folder / "program").glob("*.MPF")), config)
    solid_kg = model.volume * config.material.density_kg_m3 * 1e-9
    heat = [gate for gate in result.gates if gate.name == "heat"]
    by_text = [check["value"] for check in checks if check["name"] == "interpass temperature"]
    sound = all(check.passed for check in verify(folder))
    return {
        **found,
        "verify": "passes" if sound else "does not pass",
        "layers": len(text),
        "apart": apart(plan, text),
        "starts_plan": int(plan["starts"].sum()),
        "starts_text": sum(name == "wire_start" for name in nc.events.name),
        "over_sections": metal["laid_mm3"].sum() / metal["wanted_mm3"].sum(),
        "over_solid": text["wire_kg"].sum() / solid_kg,
        "plan_k": heat[0].figure if heat else np.nan,
        "text_k": by_text[0] if by_text else np.nan,
        "limit_k": heat[0].limit if heat else np.nan,
        "hours": (text["deposit_s"] + text["travel_s"] + text["pause_s"]).sum() / 3600.0,
    }


def apart(plan: pd.DataFrame, text: pd.DataFrame) -> float:
    """Greatest difference of a layer's sums by plan and text, over the greatest sum of a layer."""
    worst = 0.0
    for theirs, ours in PAIRS.items():
        by_plan, by_text = plan[list(ours)].sum(axis=1).to_numpy(), text[theirs].to_numpy()
        most = max(float(np.abs(by_plan).max()), float(np.abs(by_text).max()))
        if most > 0.0:
            worst = max(worst, float(np.abs(by_plan - by_text).max()) / most)
    return worst


def row(name: str, model: Model, config: Config, settings: str) -> dict[str, Any]:
    """Run one part in a folder that goes."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{name}.stl"
        write_stl(model.tessellate(MODEL_TOLERANCE_MM), file)
        found = measured(run_job(file, Path(folder) / "run", config, force=True), model, config)
    return {"part": name, "settings": settings, **found, "seconds": time.perf_counter() - began}


def rendered(table: pd.DataFrame) -> str:
    """Write the report."""
    columns = ["part", "settings", "layers", "plan and program", "metal over sections", "over solid"]
    columns += ["entry, K: plan, text", "build, h", "verdict", "verify"]
    rows = [
        [
            *(part["part"], part["settings"], f"{part['layers']:.0f}"),
            f"{part['apart']:.0e}; {part['starts_plan']:.0f}, {part['starts_text']:.0f} starts",
            f"{part['over_sections']:.3f}, {'met' if abs(part['over_sections'] - 1.0) <= MASS_SHARE else 'missed'}",
            *(
                f"{part['over_solid']:.3f}",
                f"{part['plan_k']:.0f}, {part['text_k']:.0f} (limit {part['limit_k']:.0f})",
            ),
            *(f"{part['hours']:.1f}", part["verdict"], part["verify"]),
        ]
        for part in table.to_dict("records")
    ]
    shut = table[table["verdict"] != "VALIDATED"]
    causes = [f"- {part}: {cause}" for part, cause in zip(shut["part"], shut["cause"], strict=True)]
    remedies = [f"- {part}: `{REMEDIES[part]}`: {REMEDIES[part].why}." for part in shut["part"] if part in REMEDIES]
    return TEXT.format(
        backends=" and ".join(BACKENDS),
        cpu=machine()["cpu"],
        share=100.0 * MASS_SHARE,
        table=markdown(columns, rows),
        causes="\n".join(["What shut the gates:", "", *causes]) + "\n" if causes else "",
        remedies="\n".join(["The remedies, and why:", "", *remedies]) + "\n" if remedies else "",
    )


def main() -> None:
    """Run what is missing in the table, and render it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT)
    parser.add_argument("--parts", nargs="*", default=PARTS)
    parser.add_argument("--again", action="store_true", help="run parts again that the table has")
    options = parser.parse_args()
    config = Config().changed(slicing={"backends": BACKENDS})
    options.output.mkdir(parents=True, exist_ok=True)
    file = options.output / "acceptance.csv"
    known = [] if options.again or not file.is_file() else pd.read_csv(file).to_dict("records")
    rows: dict[tuple[str, str], dict[str, Any]] = {
        (str(found["part"]), str(found["settings"])): {str(k): v for k, v in found.items()} for found in known
    }

    def run(name: str, model: Model, changed: Config, settings: str) -> bool:
        """Run a part that the table lacks; whether it is validated."""
        if (name, settings) not in rows:
            rows[name, settings] = row(name, model, changed, settings)
            seconds = rows[name, settings]["seconds"]
            print(f"{name}, {settings}: {rows[name, settings]['verdict']}, {seconds:.0f} s", flush=True)
            pd.DataFrame(list(rows.values())).to_csv(file, index=False)
        return bool(rows[name, settings]["verdict"] == "VALIDATED")

    for name, model in models(tuple(options.parts)).items():
        remedy = REMEDIES.get(name)
        if not run(name, model, config, DEFAULTS) and remedy is not None:
            run(name, model, config.changed(**remedy.changes), str(remedy))
    order = [*PARTS, *sorted({part for part, _ in rows} - set(PARTS))]
    table = pd.DataFrame([rows[key] for key in sorted(rows, key=lambda key: order.index(key[0]))])
    (options.output / "acceptance.md").write_text(rendered(table), encoding="utf-8")


if __name__ == "__main__":
    main()
