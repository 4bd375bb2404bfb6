"""From agreed contours to a verified program: fit, partition, order, write, read back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ebamcheck.atomic_file import COMPRESSION
from ebamcheck.checks.marked import marked_validated
from ebamcheck.checks.matching import matched
from ebamcheck.checks.metal import FIELD_FILE, Deposit, deposit, write_field
from ebamcheck.checks.metal_rules import deposit_checks
from ebamcheck.checks.remedies import told
from ebamcheck.checks.text_heat import build_times_s, known_sections
from ebamcheck.curves import Curves
from ebamcheck.curves.per_part import surface_kept
from ebamcheck.findings import has_fault
from ebamcheck.kinematics import side_by_side
from ebamcheck.layer_numbers import numbered
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.nc.files import ProgramFiles
from ebamcheck.nc.motions import NCProgram
from ebamcheck.pipeline import gates, noticed_in_program
from ebamcheck.pipeline.choice import witness_backend
from ebamcheck.pipeline.cross_check import CrossCheck
from ebamcheck.pipeline.entry_program import Entry, write_entry
from ebamcheck.pipeline.fitted import FitResult, beside_others, fitted, held_against
from ebamcheck.pipeline.gates import Gate
from ebamcheck.pipeline.live_program import write_live
from ebamcheck.pipeline.planned_power import plan_program
from ebamcheck.pipeline.plate_record import plate_record
from ebamcheck.pipeline.solid_metal import of_mesh, solid_check
from ebamcheck.pipeline.stages import (
    LaidOut,
    header_of,
    judged_program,
    laid_out,
    smooth_layers,
    smooth_sections,
    written,
)
from ebamcheck.pipeline.work import Job, one_beside
from ebamcheck.program import Check, program_summary, read_program, verify_program
from ebamcheck.scan import ScanPlan
from ebamcheck.writing.events import event_totals, process_events
from ebamcheck.writing.inputs import deposition_heights
from ebamcheck.writing.tracks import Toolpath

TOTALS = (
    "motions",
    "contour_mm",
    "hatch_mm",
    "travel_mm",
    "deposit_s",
    "travel_s",
    "pause_s",
    "wire_mm",
    "wire_kg",
)
"""Columns of the program's summary that add up over the layers."""


@dataclass(frozen=True)
class ProgramResult:
    """Every step from the curves to the verified program."""

    fit: FitResult
    plan: ScanPlan
    event_totals: Mapping[str, float]
    """Sums of the columns of `process.csv` over the layers, and `time_s`."""
    proof: ProgramProof
    files: ProgramFiles
    """Files of the program, marked validated where it is."""
    entry: Entry | None
    """The program that begins at a layer; None where none is asked for."""
    live: Mapping[str, Any] | None
    """Record of the main program that waits between layers; None where none is asked for."""
    gates: tuple[Gate, ...]


@dataclass(frozen=True)
class ProgramProof:
    """What the text of a program was found to do."""

    checks: Sequence[Check]
    witness: str
    """Slicer whose contours the metal was held against."""
    totals: Mapping[str, float]
    """Sums of :data:`TOTALS` over the layers."""
    kinematics: pd.DataFrame
    """Feeds of the program beside those of polygons."""
    build_s: Mapping[str, float]
    """Build time by the measures against heat."""
    plate: Sequence[Mapping[str, Any]]
    """One record a part of a plate; none for a single part."""


def make_program(
    job: Job, primary: str, checked: CrossCheck, fine: Part | None, validated_so_far: bool
) -> ProgramResult:
    """Fit, partition, order, write, read back and verify."""
    config, layers = job.config, job.folder.read_layers(primary)
    error_bound_mm = checked.outcomes[primary].error_bound_mm
    # What asks for much arithmetic and little Python goes on beside the rest.
    with ExitStack() as kept, one_beside(job.ended) as aside:
        kept.enter_context(surface_kept(job.part))
        fit_result = fitted(job, layers, error_bound_mm)
        compared = aside.submit(beside_others, job, layers, fit_result, error_bound_mm)
        compared.add_done_callback(lambda _: kept.close())
        with_reference = aside.submit(lambda: held_against(job, layers, compared.result(), fine))
        with job.stage("partition and order", len(layers)):
            smooth = smooth_layers(fit_result.curves)
            plan = plan_program(smooth, config, job.observer.advance)
            plan.to_parquet(job.folder.path / "scan.parquet")
            numbered(plan.metrics).to_csv(job.folder.path / "scan.csv", index=False)
        job.add_finding(*noticed_in_program.of_heat(plan, config))
        with job.stage("program", 1):
            laid = laid_out(smooth, plan, config)
            laid.beads.to_parquet(job.folder.path / "beads.parquet")
            summed = aside.submit(_write_events, job, laid.path, plan)
            files = written(laid, job.part, config, job.folder.program_folder)
            sections = _Sections(layers, fit_result.curves, _witness(job, layers, checked.done))
            proof = _verified(job, files, laid, sections, aside)
            totals, fit_result = summed.result(), with_reference.result()
    made = tuple(judged_program(fit_result.verdict, proof.checks, plan.metrics, config))
    entry = _entry(job, files, layers)
    if entry is not None:
        made = (*made, gates.entry_gate(entry.check))
    if validated_so_far and all(gate.passed for gate in made) and not has_fault(job.findings):
        files = marked_validated(files)
        entry = entry and entry.marked_validated()
    live = None
    if job.live:
        live = write_live(
            job.folder.path, config, float(job.part.size[2]), files.validated, header_of(job.part)
        )
        job.observer.note(f"waiting main program {live['name']}: {live['check']['text']}")
    return ProgramResult(fit_result, plan, totals, proof, files, entry, live, made)


def _entry(job: Job, files: ProgramFiles, layers: Layers) -> Entry | None:
    """Write the program from a layer on, where one is asked for, and tell what its check found."""
    if job.from_layer <= 1:
        return None
    z_of = deposition_heights(layers.heights, job.config.layer_height_mm, job.config.base_mm)
    entry = write_entry(files, job.from_layer, z_of, job.config)
    job.observer.note(f"program from layer {job.from_layer} on: {entry.check.in_words()}")
    return entry


def _witness(job: Job, layers: Layers, done: Sequence[str]) -> Layers:
    """Contours by another exact method than the one that made the program, where there is one."""
    name = witness_backend(layers.backend, done)
    return layers if name == layers.backend else job.folder.read_layers(name)


def _write_events(job: Job, path: Toolpath, plan: ScanPlan) -> dict[str, float]:
    """Write the events of the program and their totals by layer; the sums of these over the part."""
    events = process_events(path, plan, job.config)
    events.to_parquet(job.folder.path / "events.parquet", index=False, compression=COMPRESSION)
    totals = event_totals(events, len(path.z), job.config)
    numbered(totals).to_csv(job.folder.path / "process.csv", index=False)
    sums = {name: float(totals[name].sum()) for name in totals.columns if name != "layer"}
    return {**sums, "time_s": sums["deposit_s"] + sums["travel_s"] + sums["wait_s"]}


def _laid(job: Job, program: NCProgram, witness: Layers) -> Deposit:
    """Lay the metal of the program over the sections of the witness."""
    z_of = deposition_heights(witness.heights, job.config.layer_height_mm, job.config.base_mm)
    return deposit(program, witness, z_of, job.config, asked=True)


def _weighed(job: Job, program: NCProgram, witness: Layers, found: Deposit) -> list[Check]:
    """Record and check the metal of the program as it lies over the sections of the witness."""
    z_of = deposition_heights(witness.heights, job.config.layer_height_mm, job.config.base_mm)
    numbered(found.layers).to_csv(job.folder.path / "deposit.csv", index=False)
    if found.worst >= 0:
        thickness_mm = float(np.diff(z_of, prepend=job.config.base_mm)[found.worst])
        write_field(job.folder.path / FIELD_FILE, found.fields[found.worst], found.worst, thickness_mm)
    solid = solid_check(job.part, witness, job.config)
    checks = [
        *deposit_checks(program, found, job.config),
        solid.check,
        *of_mesh(job.part, witness, job.config),
    ]
    job.add_finding(*noticed_in_program.of_metal(checks))
    job.add_finding(*noticed_in_program.of_narrow(found.narrow, witness.heights, job.config))
    low_mm, top_mm = job.part.bounds[:, 2].tolist()
    if not solid.tells_of(top_mm):
        job.add_finding(*noticed_in_program.of_height(top_mm - low_mm, witness.heights, job.config))
    return checks


class _Sections(NamedTuple):
    """Sections of the part: contours of the primary slicer, the curves fitted to them, and contours of the witness."""

    contours: Layers
    curves: Curves
    witness: Layers


def _verified(
    job: Job, files: ProgramFiles, laid: LaidOut, sections: _Sections, aside: Executor
) -> ProgramProof:
    """Read the text of a program back and check it against what it was made from."""
    config, witness, heights = job.config, sections.witness, sections.contours.heights
    program, _ = matched(read_program(files.main, config), laid.path)
    job.add_finding(*noticed_in_program.of_seams(program, heights, config))
    job.add_finding(*noticed_in_program.of_consumables(program, config))
    metal = aside.submit(_laid, job, program, witness)
    feeds = aside.submit(side_by_side, program, sections.contours, config)
    times = aside.submit(build_times_s, program, config, known_sections(laid.plan, witness))
    checks = verify_program(
        program,
        config=config,
        curves=laid.beads,
        plan=laid.plan,
        path=laid.path,
        layers=witness,
        beads=True,
        laid=metal.result,
        heat=True,
        sha256=files.sha256,
        smooth=smooth_sections(sections.curves, config),
    )
    job.add_finding(*noticed_in_program.of_overhang(checks, config))
    job.add_finding(*noticed_in_program.of_limit(checks, laid.plan, config))
    checks += _weighed(job, program, witness, metal.result())
    checks = told(checks, program, heights, config.layer_height_mm, config.base_mm)
    job.add_finding(*noticed_in_program.of_checks(checks))
    summary = program_summary(program, config)
    numbered(summary).to_csv(job.folder.path / "program.csv", index=False)
    job.add_finding(*noticed_in_program.of_interpass(summary, laid.plan, config))
    kinematics = feeds.result()
    kinematics.to_csv(job.folder.path / "kinematics.csv")
    return ProgramProof(
        checks=checks,
        witness=witness.backend,
        totals={c: float(summary[c].sum()) for c in TOTALS},
        kinematics=kinematics,
        build_s=times.result(),
        plate=plate_record(job.part, config, program),
    )
