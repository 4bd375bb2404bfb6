"""Slice with every backend and compare all of them, block of layers by block of layers."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ebamcheck.atomic_file import COMPRESSION
from ebamcheck.backend import BackendSettings
from ebamcheck.comparison import Comparison, compare_all
from ebamcheck.comparison.consensus import EVERY_AGREEMENT
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.layer_numbers import numbered
from ebamcheck.layers.files import LayerFile, count_kept, kept_blocks
from ebamcheck.layers.heights import layer_blocks
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline.choice import primary_backend
from ebamcheck.pipeline.independence import evidence_rule, no_evidence
from ebamcheck.pipeline.noticed import lost
from ebamcheck.pipeline.work import Job
from ebamcheck.plugins import registry
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Limits, Outcome, bounds_of, declared_bounds, slice_all
from ebamcheck.slicers.layer_forms import file_fault


@dataclass(frozen=True)
class CrossCheck:
    """What every backend came to, and how they compare."""

    outcomes: Mapping[str, Outcome]
    comparison: Comparison

    @property
    def done(self) -> list[str]:
        """Names of the backends that came to an end."""
        return [name for name, outcome in self.outcomes.items() if outcome.file is not None]


def cross_check(
    job: Job,
    backends: Mapping[str, BackendSettings],
    resume: bool,
    meanwhile: Callable[[], None] | None = None,
) -> CrossCheck:
    """Slice and compare; layers, pairs and figures of every layer are on disk afterwards.

    `meanwhile` is called once the first slicers are at work. No more than one block of layers of every backend is in memory
    at a time (``slicing.block_points``), and two while they are compared: the next one is read meanwhile.
    """
    borders = layer_blocks(job.part, job.heights, job.config.slicing.block_points)
    outcomes = _slice(job, backends, borders, resume, meanwhile)
    return CrossCheck(outcomes, _compare(job, outcomes, borders))


def compared_layers(
    stacks: Mapping[str, LayerSource],
    part: Part,
    bounds: Mapping[str, tuple[float, float]],
    config: Config,
    *,
    count_evidence: bool = True,
    progress: Callable[[int], None] | None = None,
    borders: NDArray[np.int64] | None = None,
) -> Comparison:
    """Compare what slicers made of a part, by what the registry says of each.

    Parameters
    ----------
    stacks
        Layers by slicer.
    bounds
        Error bound and height bound that each declares, mm.
    count_evidence
        Count an agreement as evidence only as ``comparison.evidence_share`` has it.
    progress
        Told how many layers are done.
    borders
        Edges of the blocks of layers that are compared at a time.
    """
    slicers = {name: registry.slicer(name) for name in stacks}
    return compare_all(
        stacks,
        part,
        bounds=bounds,
        exact={name: slicer.exact for name, slicer in slicers.items()},
        rules={name: slicer.coplanar_rule for name, slicer in slicers.items()},
        settings=config.comparison,
        progress=progress,
        borders=borders,
        evidence=evidence_rule(config, stacks) if count_evidence else EVERY_AGREEMENT,
    )


def _slice(
    job: Job,
    backends: Mapping[str, BackendSettings],
    borders: NDArray[np.int64],
    resume: bool,
    meanwhile: Callable[[], None] | None,
) -> dict[str, Outcome]:
    """Slice with every backend, each in its own process; results are on disk as they come in."""
    chosen = job.config.slicing
    limits = Limits(chosen.time_limit_s, chosen.memory_limit_mb, chosen.processes)
    kept = _kept(job, backends) if resume else {}

    def finished(outcome: Outcome) -> None:
        if outcome.file is None:
            job.add_finding(lost(outcome))

    waiting = {n: s for n, s in backends.items() if n not in kept}
    for name in waiting:
        if blocks := count_kept(job.folder.layers_file(name)):
            job.observer.note(
                f"{name}: {blocks} of {borders.size - 1} blocks of layers of the former run are kept"
            )
    with job.stage("slice", len(waiting) * len(job.heights)):
        made = slice_all(
            job.part,
            job.heights,
            waiting,
            job.folder.layers_folder,
            limits,
            lambda _, done: job.observer.advance(done),
            finished,
            borders,
            job.workers,
            keep_blocks=True,
            meanwhile=meanwhile,
        )
        if job.workers is not None:
            job.workers.dismiss()
        # Of slicers that came to no end.
        for left in kept_blocks(job.folder.layers_folder):
            shutil.rmtree(left, ignore_errors=True)
    return {name: kept[name] if name in kept else made[name] for name in backends}


def _kept(job: Job, backends: Mapping[str, BackendSettings]) -> dict[str, Outcome]:
    """Outcomes of the backends whose layers a killed run has left behind, whole; strangers slice again."""
    kept = {}
    for name, settings in backends.items():
        file = job.folder.layers_file(name)
        if not file.is_file() or registry.is_stranger(name) or file_fault(file, job.part, job.heights, False):
            continue
        error_mm, height_mm = declared_bounds(job.part, {name: settings})[name]
        kept[name] = Outcome(
            name, file=file, probe=registry.probe(name), error_bound_mm=error_mm, height_bound_mm=height_mm
        )
        job.observer.note(f"{name}: layers of the former run are kept")
    return kept


def _compare(job: Job, outcomes: Mapping[str, Outcome], borders: NDArray[np.int64]) -> Comparison:
    done = {name: outcome for name, outcome in outcomes.items() if outcome.file is not None}
    with job.stage("compare", len(job.heights)), ExitStack() as opened:
        comparison = compared_layers(
            {n: opened.enter_context(LayerFile(job.folder.layers_file(n), edges=False)) for n in done},
            job.part,
            bounds_of(done),
            job.config,
            progress=job.observer.advance,
            borders=borders,
        )
        write_comparison(job, comparison)
    return comparison


def write_comparison(job: Job, comparison: Comparison) -> None:
    """Write the tables of a comparison into the run, and tell which slicers prove nothing."""
    pairs = job.folder.path / "compare.parquet"
    table = numbered(comparison.pairs)
    table.to_parquet(pairs, index=False, compression=COMPRESSION)
    table.to_csv(job.folder.path / "compare.csv", index=False)
    numbered(layer_table(comparison)).to_csv(job.folder.path / "layers.csv", index=False)
    job.add_finding(*no_evidence(comparison))


def layer_table(comparison: Comparison) -> pd.DataFrame:
    """One row a layer: class, verdict, and area, rings and open paths of every backend."""
    table = comparison.layers.copy()
    for name, figures in comparison.stacks.items():
        table[f"area_mm2_{name}"] = figures["area_mm2"]
        table[f"rings_{name}"] = figures["rings"]
        table[f"open_paths_{name}"] = figures["open_paths"]
    return table


def primary_of(job: Job, checked: CrossCheck) -> str:
    """Backend whose contours go on; none where it has found no contour."""
    name = primary_backend(job.config, checked.done)
    return name if name and checked.comparison.stacks[name]["rings"].any() else ""
