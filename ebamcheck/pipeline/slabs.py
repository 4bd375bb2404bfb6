"""The cross-check of a part that does not fit into memory: read, cut and compared in slabs of z, one after the other.

Every slab is a closed mesh that has the sections and the box of the whole one (:mod:`ebamcheck.mesh.slabs`), so that every slicer
cuts it alike. Of a slab the tables and the figures of the inspection are kept; its layers are dropped."""

from __future__ import annotations

import math
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
from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.files import LayerFile
from ebamcheck.layers.heights import cut_heights, layer_blocks
from ebamcheck.mesh.inspection import Inspection
from ebamcheck.mesh.slabs import Division, FacetFile, Slab, SlabInspection, divided, facet_count, read_once
from ebamcheck.pipeline.cross_check import CrossCheck, chosen_backends, compared_layers
from ebamcheck.pipeline.finishing import finish
from ebamcheck.pipeline.job import Job, Observer, RunResult, Silent, carried_out
from ebamcheck.preflight.report import Preflight
from ebamcheck.preflight.workload import slab_workload, work_checks
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Limits, Outcome, WorkerPool, bounds_of, declared_bounds, slice_all

LEAST_REACH = 1e-6  # how far beyond its borders a slab has all facets at least, over the largest coordinate: far above any rounding
DOUBT = "doubtful_regions"  # what a slicer declares of a part among the settings of its layers


def check_in_slabs(
    part_path: str | Path,
    target: str | Path,
    config: Config,
    slabs: int,
    resume: bool = False,
    observer: Observer | None = None,
    yes: bool = False,
    force: bool = False,
) -> RunResult:
    """Slice a binary STL file with every backend and compare them, slab by slab; errors as of
    :func:`~ebamcheck.pipeline.run.check_job`.

    Verdicts, areas, counts of rings and points, inspection and gates are those of the whole part; the file is read as it stands,
    and the layers are not kept. A backend that is lost in one slab is lost from there on; what a killed run left is begun anew."""
    observer = observer or Silent()
    _as_it_stands(config)
    backends = chosen_backends(config)
    observer.stage("read", facet_count(Path(part_path)))
    file = read_once(part_path, config.part.units or "", observer.advance)
    heights = cut_heights(file.outline, config)
    division = divided(file, heights, slabs, _reach_mm(file, backends, config))
    most, crossings = division.most_facets, division.crossings
    load = slab_workload(len(division.file), most, heights.size, crossings, len(division), config)
    Preflight(tuple(work_checks(load, config, yes)), load).stop("check")
    # The mesh as a whole is never there, and so has no hash.
    file.outline.__dict__["sha256"] = ""
    found = SlabInspection(file.outline, len(file)).found()
    job = Job("check", config, observer, file.outline, found, heights)

    def work(job: Job) -> RunResult:
        checked, job.found, settings = cut_slabs(job, division, backends)
        borders_mm = division.borders_mm[1:-1].tolist()
        figures = {"count": len(division), "most_facets": most, "borders_mm": borders_mm}
        return finish(job, checked, slabs=figures, settings=settings)

    what, sha256 = "check in slabs", file.outline.source_sha256
    options = {"resume": resume, "force": force, "keep_layers": False}
    return carried_out(job, what, sha256, backends, [len(division)], target, work, **options)


def _as_it_stands(config: Config) -> None:
    plain = {"direction": (0.0, 0.0, 1.0), "rotate_deg": 0.0, "place_at_mm": None, "fix_orientation": False}
    for name, value in plain.items():
        if getattr(config.part, name) != value:
            raise SettingsError(
                f"part.{name}: a check in slabs takes the part as it stands in its file: leave the setting out, or check the "
                "part whole (--slabs 1)"
            )


def _reach_mm(file: FacetFile, backends: Mapping[str, BackendSettings], config: Config) -> float:
    """How far around its heights the facets of a slab count, for slicers and for the classes of layers."""
    bounds = declared_bounds(file.outline, backends)
    margin = max([config.comparison.plane_margin_mm or 0.0, *(height for _, height in bounds.values())])
    if not math.isfinite(margin):
        raise SettingsError("a backend declares no finite height bound, which a check in slabs needs")
    return 2.0 * margin + LEAST_REACH * float(abs(file.outline.vertices).max())


# -- slab after slab ---------------------------------------------------------------------------------


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


def cut_slabs(
    job: Job, division: Division, backends: Mapping[str, BackendSettings]
) -> tuple[CrossCheck, Inspection, Mapping[str, Mapping[str, Any]]]:
    """Take a part slab by slab; two are in memory at most: one that is cut, and the one before, which is compared.

    What they came to, the inspection of all, and the settings that each backend has filled in, with all that it declared.
    """
    inspection, tally, last = SlabInspection(job.part, len(division.file)), _Tally(), len(division) - 1
    chosen = job.config.slicing
    limits = Limits(chosen.time_limit_s, chosen.memory_limit_mb, chosen.processes)
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
            heights = job.heights[first:past]
            borders = layer_blocks(slab.part, heights, chosen.block_points)
            cut = _Cut(slab, heights, first, borders, job.folder.layers_folder / f"slab-{k}")
            cut.folder.mkdir()
            with tally.timed("slice"):
                asked = slab.part, heights, tally.alive(backends), cut.folder, limits
                outcomes = slice_all(*asked, borders=borders, pool=pool)
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
    return checked, inspection.found(), tally.settings


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


def _take(job: Job, tally: _Tally, outcomes: Mapping[str, Outcome], where: str) -> None:
    """Add up what the backends came to in a slab; one that is lost here is lost."""
    for name, outcome in outcomes.items():
        before = tally.outcomes.get(name)
        tally.outcomes[name] = outcome if before is None else _added(before, outcome)
        if outcome.failure:
            tally.outcomes[name] = replace(tally.outcomes[name], why=f"{where}: {outcome.why}")


def _added(before: Outcome, after: Outcome) -> Outcome:
    sums = ("rings", "open_paths", "points", "prepare_s", "slice_s")
    greatest = ("error_bound_mm", "height_bound_mm", "peak_mb")
    figures = {name: getattr(before, name) + getattr(after, name) for name in sums}
    figures |= {name: max(getattr(before, name), getattr(after, name)) for name in greatest}
    return replace(after, **figures)


def _compared(job: Job, tally: _Tally, cut: _Cut, outcomes: Mapping[str, Outcome]) -> Comparison:
    """Compare a slab; kept are the settings of the first one, and of each the doubts that slicers declare of themselves."""
    done = {name: outcome for name, outcome in outcomes.items() if not outcome.failure}
    with ExitStack() as opened:
        stacks = {n: opened.enter_context(LayerFile(o.made(), edges=False)) for n, o in done.items()}
        for name, stack in stacks.items():
            of_first = {key: value for key, value in stack.settings.items() if key != DOUBT}
            of_all = tally.settings.setdefault(name, of_first)
            for region in stack.settings.get(DOUBT, []):
                box = np.asarray(region["box_mm"], np.float64)
                # Others are of the cones that close the mesh, or told by the slab that they are in.
                if box[2] < cut.slab.upper_mm and box[5] >= cut.slab.lower_mm:
                    of_all.setdefault(DOUBT, []).append(region)
        return compared_layers(stacks, cut.slab.part, bounds_of(done), job.config, borders=cut.borders)
