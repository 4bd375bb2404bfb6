"""Slabs of a part one after the other: read, cut by every backend, compared while the next one is cut, and dropped."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.backend import BackendSettings
from ebamcheck.comparison import Comparison
from ebamcheck.comparison.consensus import joined, shifted
from ebamcheck.layers.files import LayerFile
from ebamcheck.layers.heights import layer_blocks
from ebamcheck.mesh.inspection import Inspection
from ebamcheck.mesh.slabs import Division, Slab, SlabInspection
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.pipeline.cross_check import CrossCheck, compared_layers
from ebamcheck.pipeline.noticed import lost
from ebamcheck.pipeline.work import Job
from ebamcheck.slicers.isolation import Limits, Outcome, bounds_of, slice_all
from ebamcheck.slicers.worker_pool import WorkerPool

DOUBT = "doubtful_regions"
"""What a slicer declares of a part among the settings of its layers."""


@dataclass(frozen=True)
class SlabRun:
    """What all slabs came to."""

    checked: CrossCheck
    inspection: Inspection
    settings: Mapping[str, Mapping[str, Any]]
    """Settings that each backend has filled in, with all that it declared."""


@dataclass(frozen=True, eq=False)
class _Cut:
    """A slab with its heights (L,), the first of these among all layers, their blocks, and where its layers go."""

    slab: Slab
    heights: Floats
    first: int
    borders: Ints
    folder: Path


@dataclass
class _Tally:
    """What the slabs so far came to."""

    outcomes: dict[str, Outcome] = field(default_factory=dict)
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)
    comparisons: list[Comparison] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, what: str) -> Iterator[None]:
        """Add the time of a block up."""
        start = time.perf_counter()
        yield
        self.seconds[what] = self.seconds.get(what, 0.0) + time.perf_counter() - start

    def alive(self, backends: Mapping[str, BackendSettings]) -> dict[str, BackendSettings]:
        """Backends that no slab has lost."""
        return {n: s for n, s in backends.items() if n not in self.outcomes or not self.outcomes[n].failure}


def cut_slabs(job: Job, division: Division, backends: Mapping[str, BackendSettings]) -> SlabRun:
    """Take a part slab by slab; two are in memory at most: one that is cut, and the one before, which is compared."""
    inspection = SlabInspection(job.part, len(division.file))
    tally = _Tally()
    last = len(division) - 1
    with (
        job.stage("slabs", job.heights.size),
        ExitStack() as workers,
        ThreadPoolExecutor(1) as inspecting,
        ThreadPoolExecutor(1) as comparing,
    ):
        # Workers come up while the slab is read.
        pool = workers.enter_context(WorkerPool(backends))
        behind: Future[int] | None = None
        for k in range(len(division)):
            first, past = division.layers[k : k + 2].tolist()
            with tally.timed("read"):
                slab = division.slab(k)
            inspected = inspecting.submit(inspection.add, slab)
            cut = _Cut(
                slab,
                job.heights[first:past],
                first,
                layer_blocks(slab.part, job.heights[first:past], job.config.slicing.block_points),
                job.folder.layers_folder / f"slab-{k}",
            )
            with tally.timed("slice"):
                outcomes = _sliced(job, cut, tally.alive(backends), pool)
            workers.close()
            _take(job, tally, outcomes, f"slab {k + 1} of {len(division)}")
            with tally.timed("wait"):
                inspected.result()
                _told(job, behind)
            if k < last:
                pool = workers.enter_context(WorkerPool(tally.alive(backends)))
            behind = comparing.submit(_compare, job, tally, cut, outcomes)
            del slab, cut  # so that there are never three in memory
        with tally.timed("wait"):
            _told(job, behind)
    job.folder.layers_folder.rmdir()
    job.timings.update(tally.seconds)
    checked = CrossCheck({name: tally.outcomes[name] for name in backends}, joined(tally.comparisons))
    return SlabRun(checked, inspection.found(), tally.settings)


def _told(job: Job, compared: Future[int] | None) -> None:
    """Wait for a slab that is compared, and tell that its layers are done."""
    if compared is not None:
        job.observer.advance(compared.result())


def _compare(job: Job, tally: _Tally, cut: _Cut, outcomes: Mapping[str, Outcome]) -> int:
    """Compare a slab and drop its layers; returns how many they were."""
    with tally.timed("compare"):
        tally.comparisons.append(shifted(_compared(job, tally, cut, outcomes), cut.first))
    shutil.rmtree(cut.folder)
    return cut.heights.size


def _sliced(
    job: Job, cut: _Cut, backends: Mapping[str, BackendSettings], pool: WorkerPool
) -> dict[str, Outcome]:
    chosen = job.config.slicing
    limits = Limits(chosen.time_limit_s, chosen.memory_limit_mb, chosen.processes)
    cut.folder.mkdir()
    return slice_all(cut.slab.part, cut.heights, backends, cut.folder, limits, borders=cut.borders, pool=pool)


def _take(job: Job, tally: _Tally, outcomes: Mapping[str, Outcome], where: str) -> None:
    """Add up what the backends came to in a slab; one that is lost here is lost."""
    for name, outcome in outcomes.items():
        before = tally.outcomes.get(name)
        tally.outcomes[name] = outcome if before is None else _added(before, outcome)
        if outcome.failure:
            tally.outcomes[name] = replace(tally.outcomes[name], why=f"{where}: {outcome.why}")
            job.add_finding(lost(tally.outcomes[name]))


def _added(before: Outcome, after: Outcome) -> Outcome:
    sums = ("rings", "open_paths", "points", "prepare_s", "slice_s", "compile_s")
    greatest = ("error_bound_mm", "height_bound_mm", "peak_mb")
    return replace(
        after,
        **{name: getattr(before, name) + getattr(after, name) for name in sums},
        **{name: max(getattr(before, name), getattr(after, name)) for name in greatest},
    )


def _compared(job: Job, tally: _Tally, cut: _Cut, outcomes: Mapping[str, Outcome]) -> Comparison:
    done = {name: outcome for name, outcome in outcomes.items() if not outcome.failure}
    with ExitStack() as opened:
        stacks = {n: opened.enter_context(LayerFile(o.made(), edges=False)) for n, o in done.items()}
        for name, stack in stacks.items():
            _keep_settings(tally.settings, name, stack.settings, cut.slab)
        return compared_layers(stacks, cut.slab.part, bounds_of(done), job.config, borders=cut.borders)


def _keep_settings(
    kept: dict[str, dict[str, Any]], name: str, settings: Mapping[str, Any], slab: Slab
) -> None:
    """Keep the settings of the first slab, and of each one the doubts that it declares of itself."""
    of_all = kept.setdefault(name, {key: value for key, value in settings.items() if key != DOUBT})
    for region in settings.get(DOUBT, []):
        box = np.asarray(region["box_mm"], np.float64)
        # Others are of the cones that close the mesh, or told by the slab that they are in.
        if box[2] < slab.upper_mm and box[5] >= slab.lower_mm:
            of_all.setdefault(DOUBT, []).append(region)
