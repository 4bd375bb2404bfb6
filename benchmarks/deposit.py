"""The metal of whole programs: ``python -m benchmarks.deposit``; its tables in reports/metal.

Every part goes through the pipeline as by ``ebamcheck run`` at the default settings: reference models, parts that nobody
chose (:mod:`benchmarks.chance_parts`), and, where EBAMCHECK_CORPUS names a folder of meshes, its sound ones, scaled. A part
that stands in the table is not run again, so that a run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from shapely.geometry.base import BaseGeometry

from benchmarks.chance_parts import chance_part, kind_of
from benchmarks.machine import machine
from benchmarks.scan_orders import markdown
from ebamcheck.checks.metal import deposit
from ebamcheck.checks.metal_rules import deposit_checks
from ebamcheck.curves import Curves
from ebamcheck.errors import EbamcheckError
from ebamcheck.geometry.regions import eroded, split_thin, valid_polygons
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import Part
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.pipeline import RunResult, run_job
from ebamcheck.pipeline.gates import deposit_gate
from ebamcheck.plugins.registry import models
from ebamcheck.printable import indexed
from ebamcheck.program import read_program, write_program
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.scan import ScanPlan
from ebamcheck.scan.islands.regions import CORNER
from ebamcheck.settings.config import Config, validated
from ebamcheck_models import write_stl

BACKENDS = ("planecut", "manifold")
CORPUS, CORPUS_FOLDER = "EBAMCHECK_CORPUS", "good"
DEFAULT_OUTPUT = Path("reports/metal")

MODEL_TOLERANCE_MM = 0.02
CORPUS_MM = 100.0
"""Greatest extent to which meshes are scaled: as large as that, most have walls of two beads."""

LARGEST_MM3 = 1.1e6
"""Larger models (blade, bulkhead, ladder, nozzle: minutes to an hour each) run with ``--large`` alone."""

SERIES = ("first", "fresh")
"""Names of the series of parts that nobody chose: the first one was run before anything was mended, the second after."""

PARTS_IN_SERIES = 28

BUILDABLE_BEADS = 2.0
"""Walls and holes from so many beads on are what an engineer would call buildable."""

FIGURES = (
    "mass", "least_layer", "most_layer", "outside", "reach_mm", "low_mm", "high_mm", "inside", "edge", "entry_k",
)  # fmt: skip
"""Columns of a row that are figures of the metal or of the heat."""


def chosen(groups: list[str], large: bool) -> Iterator[tuple[str, str, Callable[[], Part]]]:
    """Group, name and maker of every part that is asked for."""
    if "models" in groups:
        for name, model in models().items():
            if large or model.volume <= LARGEST_MM3:
                yield "models", name, partial(model.tessellate, MODEL_TOLERANCE_MM)
    for series in groups:
        if series in SERIES:
            for number in range(PARTS_IN_SERIES):
                name = f"{series}-{number:02}"
                yield series, name, partial(chance_part, name)
    folder = os.environ.get(CORPUS)
    if "corpus" in groups and folder:
        for file in sorted((Path(folder) / CORPUS_FOLDER).glob("*.stl")):
            yield "corpus", file.stem, partial(_scaled_file, file)


def _rows_of(file: Path) -> list[dict[str, Any]]:
    return [{str(k): v for k, v in found.items()} for found in pd.read_csv(file).to_dict("records")]


def _scaled_file(file: Path) -> Part:
    return scaled(load(file))


def scaled(part: Part) -> Part:
    """Scale a part to :data:`CORPUS_MM`."""
    return replace(part, vertices=part.vertices * (CORPUS_MM / part.size.max()))


def under_two_beads(layers: Layers, config: Config) -> str:
    """Layers with walls, and with holes, narrower than two beads, in words; empty where an engineer would build the part.

    A wall is a long thin piece of the section, or a neck without which there is one part, or one hole, more or less.
    """
    least_mm = BUILDABLE_BEADS * config.process.bead_width_mm
    walls = holes = 0
    for k in range(len(layers)):
        section = layers.section(k)
        _, thin = split_thin(section, least_mm, CORNER * least_mm**2)
        opened = shapely.buffer(eroded(section, 0.5 * least_mm), 0.5 * least_mm)
        rings = [shapely.Polygon(ring) for part in valid_polygons(section) for ring in part.interiors]
        walls += bool(thin) or shape_of(section) != shape_of(opened)
        holes += any(2.0 * shapely.maximum_inscribed_circle(hole).length < least_mm for hole in rings)
    parts = [f"{count} {what}" for count, what in ((walls, "walls"), (holes, "holes")) if count]
    return ", ".join(parts)


def shape_of(section: BaseGeometry) -> tuple[int, int]:
    """Number of parts and of holes."""
    parts = valid_polygons(section)
    return len(parts), sum(len(part.interiors) for part in parts)


def measured(result: RunResult, config: Config) -> dict[str, Any]:
    """Figures of a run."""
    gates = {gate.name: gate for gate in result.gates}
    shut = [gate for gate in result.gates if not gate.passed]
    found: dict[str, Any] = {
        "verdict": "VALIDATED" if result.manifest.get("program", {}).get("validated") else "NOT VALIDATED",
        "gates": " ".join(gate.name for gate in shut),
        "cause": shut[0].text if shut else "",
    }
    if shut and any(gate.name == "deposit" for gate in shut):
        found["cause"] = gates["deposit"].text
    table = result.folder.path / "deposit.csv"
    if not table.is_file():
        return found
    found |= {
        **figures_of(indexed(pd.read_csv(table))),
        "entry_k": gates["heat"].figure,
        "under two beads": under_two_beads(result.folder.read_layers(BACKENDS[0]), config),
    }
    return found


def figures_of(table: pd.DataFrame) -> dict[str, Any]:
    """Figures of the metal of all layers."""
    solid = table.query("wanted_mm3 > 0 or laid_mm3 > 0")
    share = solid["laid_mm3"] / solid["wanted_mm3"]
    worst = int(np.argmax(np.abs(share - 1.0)))
    return {
        "layers": len(solid),
        "mass": solid["laid_mm3"].sum() / solid["wanted_mm3"].sum(),
        "worst_layer": int(solid["layer"].iloc[worst]) + 1,
        "least_layer": share.min(),
        "most_layer": share.max(),
        "outside": solid["outside_mm3"].sum() / solid["laid_mm3"].sum(),
        **{name: solid[name].max() for name in ("reach_mm", "low_mm", "high_mm")},
        **{zone: _mean(solid, zone) for zone in ("inside", "edge")},
    }


def laid_again(run: Path) -> dict[str, Any]:
    """Figures of the plan of a kept run, laid out, written, read and weighed by the code that is here now."""
    folder = RunFolder(run)
    manifest, config = folder.manifest(), validated(folder.manifest()["settings"], "run.json")
    plan, beads = ScanPlan.from_parquet(run / "scan.parquet"), Curves.from_parquet(run / "beads.parquet")
    witness = folder.read_layers(manifest["program"]["witness"])
    with tempfile.TemporaryDirectory() as place:
        program = read_program(write_program(beads, plan, config, Path(place)).main, config)
    found = deposit(
        program, witness, deposition_heights(witness.heights, config.layer_height_mm, config.base_mm), config
    )
    gate = deposit_gate(deposit_checks(program, found, config), config)
    return {
        "verdict": "deposit open" if gate.passed else "deposit shut",
        "gates": "" if gate.passed else "deposit",
        "cause": "" if gate.passed else gate.text,
        **figures_of(found.layers),
        "under two beads": under_two_beads(folder.read_layers(BACKENDS[0]), config),
    }


def again(name: str, runs: Path) -> Iterator[dict[str, Any]]:
    """Rows of all kept runs of a folder that came to a program."""
    for run in sorted(runs.glob("*.run")):
        if (run / "beads.parquet").is_file() and (run / "deposit.csv").is_file():
            began = time.perf_counter()
            row = {
                "group": name,
                "part": run.stem,
                "kind": kind_of(run.stem) if "-" in name else "",
                **laid_again(run),
            }
            yield {**row, "seconds": time.perf_counter() - began}


def _mean(solid: pd.DataFrame, zone: str) -> float:
    area = solid[f"{zone}_mm2"].to_numpy()
    some = area > 0.0
    return float(np.average(solid[zone].to_numpy()[some], weights=area[some])) if some.any() else np.nan


def row(group: str, name: str, make: Callable[[], Part], config: Config, keep: Path | None) -> dict[str, Any]:
    """Run one part in a folder that goes, unless it is to be kept."""
    began = time.perf_counter()
    found: dict[str, Any] = {"group": group, "part": name, "kind": kind_of(name) if group in SERIES else ""}
    with tempfile.TemporaryDirectory() as folder:
        place = keep or Path(folder)
        try:
            file = place / f"{name}.stl"
            write_stl(make(), file)
            found |= measured(run_job(file, place / f"{name}.run", config, force=True), config)
        except EbamcheckError as error:
            found |= {"verdict": "refused", "cause": str(error)}
    return {**found, "seconds": time.perf_counter() - began}


def rendered(table: pd.DataFrame) -> str:
    """The report: rates, medians and worst figures of each group, then every part."""
    how = (
        f"By `python -m benchmarks.deposit`, default settings, backends {' and '.join(BACKENDS)}, on {machine()['cpu']}. "
        "*under two beads*: layers with walls, or with holes, narrower than two beads; the other parts are *buildable*."
    )
    groups = [rates(group, rows) for group, rows in table.groupby("group", sort=False)]
    lines = ["# The metal of whole programs", how, markdown(pd.DataFrame(groups))]
    shown = table.copy()
    for name in FIGURES:
        digits = 0 if name == "entry_k" else 2 if name.endswith("_mm") else 3
        if name not in shown:
            continue
        shown[name] = [f"{value:.{digits}f}" if np.isfinite(value) else "" for value in shown[name]]
    for group, rows in shown.groupby("group", sort=False):
        columns = ["part", "kind", "layers", *FIGURES, "under two beads", "verdict", "gates"]
        text = rows[columns].copy()
        text["layers"] = [f"{value:.0f}" if np.isfinite(value) else "" for value in rows["layers"]]
        lines += [f"## {group}", markdown(text.fillna(""))]
        causes = rows[~rows["verdict"].isin(["VALIDATED", "deposit open"])]
        lines += [f"- {part}: {cause}" for part, cause in zip(causes["part"], causes["cause"], strict=True)]
    return "\n\n".join(lines).replace("\n\n- ", "\n- ") + "\n"


def rates(group: object, rows: pd.DataFrame) -> dict[str, Any]:
    """Row of a group."""
    known = rows[rows["mass"].notna()]
    sound = known[known["under two beads"].fillna("") == ""]
    validated = rows["verdict"] == "VALIDATED"
    relaid = rows["verdict"].str.startswith("deposit").all()  # the other gates were not asked again
    result: dict[str, Any] = {
        "group": group,
        "parts": len(rows),
        "validated": int(validated.sum()) if not relaid else "-",
        "buildable": len(sound),
        "buildable and validated": int((sound["verdict"] == "VALIDATED").sum()) if not relaid else "-",
        "gate deposit open": int(open_gate(known).sum()),
        "buildable and open": int(open_gate(sound).sum()),
    }
    for name in ("mass", "outside", "reach_mm", "low_mm", "high_mm", "inside", "edge"):
        values = sound[name].dropna()
        centre = 1.0 if name in ("mass", "inside", "edge") else 0.0
        if len(values):
            worst = values.iloc[int(np.argmax(np.abs(values - centre)))]
            result[name] = f"{values.median():.3f} ({worst:.3f})"
    return result


def open_gate(rows: pd.DataFrame) -> pd.Series:
    """Whether the gate of the metal is open for each part."""
    return ~rows["gates"].fillna("").str.contains("deposit")


def main() -> None:
    """Run what is missing in the table, and render it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT)
    parser.add_argument("--groups", default="models,first,fresh,corpus")
    parser.add_argument("--parts", nargs="*", help="only these, again where the table has them")
    parser.add_argument("--large", action="store_true", help="the largest models, too")
    parser.add_argument(
        "--again",
        nargs=2,
        metavar=("GROUP", "FOLDER"),
        help="lay the runs kept in a folder out again, as a group",
    )
    parser.add_argument("--keep", type=Path, help="folder for parts and runs, which else are removed")
    options = parser.parse_args()
    config = Config().changed(slicing={"backends": BACKENDS})
    options.output.mkdir(parents=True, exist_ok=True)
    file = options.output / "deposit.csv"
    rows: list[dict[str, Any]] = _rows_of(file) if file.is_file() else []
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    if options.again:
        group, runs = options.again
        rows = [r for r in rows if r["group"] != group] + list(again(group, Path(runs)))
        pd.DataFrame(rows).to_csv(file, index=False)
    for group, name, make in [] if options.again else chosen(options.groups.split(","), options.large):
        if options.parts is not None and name not in options.parts:
            continue
        if options.parts is None and name in {r["part"] for r in rows}:
            continue
        made = row(group, name, make, config, options.keep)
        rows = [r for r in rows if r["part"] != name] + [made]
        table = pd.DataFrame(rows)
        table.to_csv(file, index=False)
        cause = str(made.get("cause", ""))[:150]
        print(
            f"{name:16} {made['seconds']:6.1f} s  {made['verdict']}  {made.get('gates', '')}: {cause}",
            flush=True,
        )
    table = pd.DataFrame(rows)
    (options.output / "deposit.md").write_text(rendered(table), encoding="utf-8")


if __name__ == "__main__":
    main()
