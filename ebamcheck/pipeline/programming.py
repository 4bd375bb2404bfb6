"""From agreed contours to a verified program: fit, partition, order, write, read back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from typing import Any

from ebamcheck.checks.consumables import plate_record
from ebamcheck.checks.interpass_checks import build_times_s, known_sections
from ebamcheck.checks.matching import matched
from ebamcheck.checks.mesh_checks import of_mesh, solid_check
from ebamcheck.checks.metal import deposit
from ebamcheck.checks.metal_rules import deposit_checks
from ebamcheck.checks.rules import with_remedies
from ebamcheck.checks.text_checks import marked_validated
from ebamcheck.curves import Curves
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.nc.files import ProgramFiles
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.pipeline import findings as told
from ebamcheck.pipeline import gates, stages
from ebamcheck.pipeline.cross_check import CrossCheck, witness_backend
from ebamcheck.pipeline.entry_program import Entry, write_entry, write_live
from ebamcheck.pipeline.fit import FitResult, fit_result, fitted, other_fits
from ebamcheck.pipeline.job import Job, one_beside
from ebamcheck.pipeline.tables import Table, tables_of_metal, tables_of_plan, tables_of_program
from ebamcheck.program import read_program, verify_program
from ebamcheck.result import Check, has_fault
from ebamcheck.scan import ScanPlan
from ebamcheck.surface.part_surface import surface_kept


@dataclass(frozen=True)
class ProgramResult:
    """Every step from the curves to the verified program."""

    fit: FitResult
    plan: ScanPlan
    proof: ProgramProof
    files: ProgramFiles  # files of the program, marked validated where it is
    entry: Entry | None  # the program that begins at a layer; None where none is asked for
    # Record of the main program that waits between layers; None where none is asked for
    live: Mapping[str, Any] | None
    gates: tuple[Check, ...]
    findings: tuple[Check, ...]
    tables: Mapping[str, Table]  # its files in a run folder beside the program


@dataclass(frozen=True)
class ProgramProof:
    """What the text of a program was found to do."""

    checks: Sequence[Check]
    findings: Sequence[Check]
    tables: Mapping[str, Table]
    witness: str  # slicer whose contours the metal was held against
    build_s: Mapping[str, float]  # build time by the measures against heat
    plate: Sequence[Mapping[str, Any]]  # one record a part of a plate; none for a single part


def make_program(
    job: Job, primary: str, checked: CrossCheck, fine: Part | None, validated_so_far: bool
) -> ProgramResult:
    """Fit, partition, order, write, read back and verify."""
    config, layers = job.config, job.folder.read_layers(primary)
    bound_mm = checked.outcomes[primary].error_bound_mm
    # What asks for much arithmetic and little Python goes on beside the rest.
    with ExitStack() as kept, one_beside(job.ended) as aside:
        kept.enter_context(surface_kept(job.part))
        with job.stage("fit", len(layers)):
            verdict, table = fitted(layers, job.part, config, bound_mm, job.observer.advance)

        def others() -> dict[str, Curves]:
            with job.beside("other fits"):
                return other_fits(layers, job.part, config, bound_mm, job.go_on)

        def put_beside() -> FitResult:
            with job.beside("reference") if fine is not None else nullcontext():
                return fit_result(verdict, table, layers, compared.result(), fine, job.go_on)

        compared = aside.submit(others)
        compared.add_done_callback(lambda _: kept.close())
        fit = aside.submit(put_beside)
        with job.stage("partition and order", len(layers)):
            smooth = stages.smooth_layers(verdict.curves)
            plan = stages.plan_program(smooth, config, job.observer.advance)
        with job.stage("program", 1):
            laid = stages.laid_out(smooth, plan, config)
            of_plan = aside.submit(tables_of_plan, laid.path, plan, config)
            files = stages.written(laid, job.part, config, job.folder.program_folder)
            # Contours by another exact method than the one that made the program, where there is one.
            name = witness_backend(layers.backend, checked.done)
            witness = layers if name == layers.backend else job.folder.read_layers(name)
            proof = _proved(job, files, laid, layers, verdict.curves, witness, aside)
            planned: dict[str, Table] = {"scan.parquet": plan, "beads.parquet": laid.beads}
            planned |= of_plan.result()
            fitting = fit.result()
    made = tuple(stages.judged_program(fitting.verdict, proof.checks, plan.metrics, config))
    findings = (*told.fit_findings(verdict), *told.heat_findings(plan, config), *proof.findings)
    entry = _entry(job, files, layers)
    if entry is not None:
        made = (*made, gates.entry_gate(entry.check))
    if validated_so_far and all(gate.passed for gate in made) and not has_fault(findings):
        files = marked_validated(files)
        entry = entry and entry.marked_validated()
    live = None
    if job.live:
        top_mm, header = float(job.part.size[2]), stages.header_of(job.part)
        live = write_live(job.folder.path, config, top_mm, files.validated, header)
        job.observer.note(f"waiting main program {live['name']}: {live['check']['text']}")
    tables = {**fitting.tables, **planned, **proof.tables}
    return ProgramResult(fitting, plan, proof, files, entry, live, made, findings, tables)


def _entry(job: Job, files: ProgramFiles, layers: Layers) -> Entry | None:
    if job.from_layer <= 1:
        return None
    z_of = deposition_heights(layers.heights, job.config.layer_height_mm, job.config.base_mm)
    entry = write_entry(files, job.from_layer, z_of, job.config)
    job.observer.note(f"program from layer {job.from_layer} on: {entry.check.in_words()}")
    return entry


def _proved(
    job: Job,
    files: ProgramFiles,
    laid: stages.LaidOut,
    contours: Layers,
    curves: Curves,
    witness: Layers,
    aside: Executor,
) -> ProgramProof:
    """Read the text of a program back and check it against what it was made from, and against the contours of a witness."""
    part, config, heights = job.part, job.config, contours.heights
    z_of = deposition_heights(heights, config.layer_height_mm, config.base_mm)
    program, match = matched(read_program(files.main, config), laid.path)
    metal = aside.submit(deposit, program, witness, z_of, config, asked=True)
    of_program = aside.submit(tables_of_program, program, contours, config)
    times = aside.submit(build_times_s, program, config, known_sections(laid.plan, witness))
    checks = verify_program(
        program,
        config=config,
        curves=laid.beads,
        plan=laid.plan,
        match=match,
        layers=witness,
        beads=True,
        laid=metal.result,
        heat=True,
        sha256=files.sha256,
        smooth=stages.smooth_sections(curves, config),
    )
    found, solid = metal.result(), solid_check(part, witness, config)
    of_metal = [*deposit_checks(program, found, config), solid.check, *of_mesh(part, witness, config)]
    remedied = with_remedies([*checks, *of_metal], program, heights, config.layer_height_mm, config.base_mm)
    of_text = of_program.result()
    tables = {**of_text, **tables_of_metal(found, z_of, config.base_mm)}
    low_mm, top_mm = part.bounds[:, 2].tolist()
    findings = [
        *told.seam_findings(program, heights, config),
        *told.consumable_findings(program, config),
        *told.overhang_findings(checks, config),
        *told.limit_findings(checks, laid.plan, config),
        *told.metal_findings(of_metal),
        *told.narrow_findings(found.narrow, heights, config),
        *(() if solid.tells_of(top_mm) else told.height_findings(top_mm - low_mm, heights, config)),
        *told.failed_checks(remedied),
        *told.interpass_findings(of_text["program.csv"], laid.plan, config),
    ]
    plate = plate_record(part, config, program)
    return ProgramProof(remedied, findings, tables, witness.backend, times.result(), plate)
