"""The cross-check of a part that does not fit into memory: read, cut and compared in slabs of z, one after the other.

Every slab becomes a closed mesh that has the sections of the whole one at its heights and the box of the whole one
(:mod:`ebamcheck.mesh.slabs`), so that every slicer cuts it as it would cut the whole. Of a slab the tables are kept, and
the figures of the inspection; its layers are dropped.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from ebamcheck.backend import BackendSettings
from ebamcheck.errors import SettingsError
from ebamcheck.json_values import sha256_of_json
from ebamcheck.layers.heights import cut_heights
from ebamcheck.mesh.slabs import Division, FacetFile, SlabInspection, divided, facet_count, read_once
from ebamcheck.numeric.rings import Floats
from ebamcheck.pipeline import noticed
from ebamcheck.pipeline.choice import chosen_backends
from ebamcheck.pipeline.cross_check import write_comparison
from ebamcheck.pipeline.finishing import RunResult, SlabRecord, finish, finished_result
from ebamcheck.pipeline.loose_limits import loose_limits
from ebamcheck.pipeline.slab_slicing import SlabRun, cut_slabs
from ebamcheck.pipeline.work import Job, Observer, Silent
from ebamcheck.preflight.report import Preflight
from ebamcheck.preflight.slab_work import slab_workload
from ebamcheck.preflight.workload import work_checks
from ebamcheck.record.run_folder import finished_run, start_run
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import outside_window, unusual_layers
from ebamcheck.slicers.isolation import declared_bounds
from ebamcheck.version import __version__

LEAST_REACH = 1e-6
"""How far beyond its borders a slab has all facets at least, over the largest coordinate: far above any rounding."""


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
    """Slice a binary STL file with every backend and compare them, slab by slab.

    Verdicts, areas, counts of rings and points, inspection and gates are those of
    :func:`~ebamcheck.pipeline.job.check_job` of the whole part; the layers are not kept. A backend that is lost in one
    slab is lost from there on.

    Parameters
    ----------
    part_path
        Binary STL file, read as it stands: no turn, no place, no mended facets.
    target
        Run folder to make; it appears when it is whole.
    config, yes, force
        As in :func:`~ebamcheck.pipeline.job.run_job`.
    slabs
        How many; no more than there are layers.
    resume
        Return a finished run of the same part and settings. What a killed one has left is begun anew.
    observer
        Told of stages and progress.

    Raises
    ------
    InputError, SettingsError
        If the file cannot be read in slabs, settings make no sense, ask for another place of the part or for more work
        than is allowed, or a finished run stands at `target`.
    BackendMissing
        If a required or named backend is unknown, or a required one is not available.
    """
    observer = observer or Silent()
    _as_it_stands(config)
    backends = chosen_backends(config)
    observer.stage("read", facet_count(Path(part_path)))
    file = read_once(part_path, config.part.units or "", observer.advance)
    heights = cut_heights(file.outline, config)
    division = divided(file, heights, slabs, _reach_mm(file, backends, config))
    _within_work(division, heights, config, yes)
    fingerprint = sha256_of_json(
        [
            "check in slabs",
            file.outline.source_sha256,
            config.model_dump(),
            heights,
            list(backends),
            __version__,
            len(division),
        ]
    )
    if resume and not force and (done := finished_run(Path(target), fingerprint)) is not None:
        observer.note(f"{target}: is finished already")
        return finished_result(done)
    folder = start_run(Path(target), fingerprint, False, force)
    if folder.former is not None:
        observer.note(f"{target}: the former run will be kept as {folder.former.name}")
    # The mesh as a whole is never there, and so has no hash.
    file.outline.__dict__["sha256"] = ""
    nothing_yet = SlabInspection(file.outline, len(file)).found()
    job = Job("check", config, observer, file.outline, nothing_yet, heights, folder, fingerprint)
    try:
        return _finished(job, division, cut_slabs(job, division, backends))
    except OSError as error:
        raise SettingsError(f"{folder.path}: cannot be written: {error.strerror or error}") from error
    finally:
        folder.release()


def _finished(job: Job, division: Division, made: SlabRun) -> RunResult:
    """Judge what all slabs came to and write the run."""
    checked, config = made.checked, job.config
    job.found = made.inspection
    job.add_finding(*noticed.of_part(job.found, config), *loose_limits(config))
    job.add_finding(*outside_window(config, "warning"), *unusual_layers(config))
    write_comparison(job, checked.comparison)
    figures = {
        "count": len(division),
        "most_facets": division.most_facets,
        "borders_mm": division.borders_mm[1:-1].tolist(),
    }
    return finish(job, checked, None, SlabRecord(made.settings, figures))


def _as_it_stands(config: Config) -> None:
    """Refuse settings that would move or mend the part."""
    part = config.part
    asked = {
        "part.direction": part.direction != (0.0, 0.0, 1.0),
        "part.rotate_deg": part.rotate_deg != 0.0,
        "part.place_at_mm": part.place_at_mm is not None,
        "part.fix_orientation": part.fix_orientation,
    }
    for name, is_asked in asked.items():
        if is_asked:
            raise SettingsError(
                f"{name}: a check in slabs takes the part as it stands in its file: leave the setting out, or check the "
                "part whole (--slabs 1)"
            )


def _reach_mm(file: FacetFile, backends: Mapping[str, BackendSettings], config: Config) -> float:
    """How far around its heights the facets of a slab count, for slicers and for the classes of layers."""
    bounds = declared_bounds(file.outline, backends)
    margin = max([config.comparison.plane_margin_mm or 0.0, *(height for _, height in bounds.values())])
    if not math.isfinite(margin):
        raise SettingsError("a backend declares no finite height bound, which a check in slabs needs")
    return 2.0 * margin + LEAST_REACH * float(abs(file.outline.vertices).max())


def _within_work(division: Division, heights: Floats, config: Config, yes: bool) -> None:
    """Refuse more work than the settings allow."""
    work = slab_workload(
        len(division.file), division.most_facets, heights.size, division.crossings, len(division), config
    )
    Preflight(tuple(work_checks(work, config, yes)), work).stop("check")
