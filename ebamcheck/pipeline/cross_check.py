"""Choose slicers, slice with every one and compare all of them, block of layers by block of layers; which agreements are
evidence."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import BackendSettings
from ebamcheck.comparison import Comparison, compare_all
from ebamcheck.comparison.consensus import EVERY_AGREEMENT, EvidenceRule
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.errors import BackendMissing, SettingsError
from ebamcheck.layers.files import LayerFile, count_kept, kept_blocks
from ebamcheck.layers.heights import layer_blocks
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline.job import Job
from ebamcheck.plugins import registry
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Limits, Outcome, bounds_of, declared_bounds, slice_all
from ebamcheck.slicers.outcome import file_fault


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
    meanwhile: Callable[[], object] | None = None,
) -> CrossCheck:
    """Slice and compare; the layers are on disk afterwards. `meanwhile` is called once the first slicers are at work.

    No more than one block of layers of every backend (``slicing.block_points``) is in memory at a time, two while they are
    compared."""
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
    """Compare what slicers made of a part, by what the registry says of each; `bounds` are error and height bound, mm, that each
    declares.

    An agreement is evidence as ``comparison.evidence_share`` has it, unless `count_evidence` is off; `borders` are the edges of the
    blocks of layers."""
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
    meanwhile: Callable[[], object] | None,
) -> dict[str, Outcome]:
    chosen = job.config.slicing
    limits = Limits(chosen.time_limit_s, chosen.memory_limit_mb, chosen.processes)
    kept = _kept(job, backends) if resume else {}

    waiting = {n: s for n, s in backends.items() if n not in kept}
    for name in waiting:
        if blocks := count_kept(job.folder.layers_file(name)):
            count = borders.size - 1
            job.observer.note(f"{name}: {blocks} of {count} blocks of layers of the former run are kept")
    with job.stage("slice", len(waiting) * len(job.heights)):
        made = slice_all(
            job.part,
            job.heights,
            waiting,
            job.folder.layers_folder,
            limits,
            lambda _, done: job.observer.advance(done),
            borders=borders,
            pool=job.workers,
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
        probe = registry.probe(name)
        kept[name] = Outcome(name, file=file, probe=probe, error_bound_mm=error_mm, height_bound_mm=height_mm)
        job.observer.note(f"{name}: layers of the former run are kept")
    return kept


def _compare(job: Job, outcomes: Mapping[str, Outcome], borders: NDArray[np.int64]) -> Comparison:
    done = {name: outcome for name, outcome in outcomes.items() if outcome.file is not None}
    with job.stage("compare", len(job.heights)), ExitStack() as opened:
        return compared_layers(
            {n: opened.enter_context(LayerFile(job.folder.layers_file(n), edges=False)) for n in done},
            job.part,
            bounds_of(done),
            job.config,
            progress=job.observer.advance,
            borders=borders,
        )


def primary_of(checked: CrossCheck, config: Config) -> str:
    """Backend whose contours go on, of those that came to an end: the one set, else the best exact one; none where it has found no
    contour."""
    done = checked.done
    name = config.slicing.primary if config.slicing.primary in done else max(done, key=_rank, default="")
    return name if name and checked.comparison.stacks[name]["rings"].any() else ""


# -- evidence ----------------------------------------------------------------------------------------


def evidence_rule(config: Config, names: Iterable[str]) -> EvidenceRule:
    """Which agreements of these slicers count: see ``comparison.evidence_share``."""
    share = config.comparison.evidence_share
    kin = frozenset(frozenset(pair) for pair in combinations(names, 2) if registry.one_method(*pair))
    return EvidenceRule(share * config.process.bead_width_mm, share * config.layer_height_mm, kin)


def not_counted(comparison: Comparison) -> list[str]:
    """Slicers and pairs whose agreement counts for nothing, and why, in short."""
    said = [f"{name} is no evidence: {why}" for name, why in comparison.without_weight.items()]
    if len(comparison.pairs):
        one = comparison.pairs[~comparison.pairs["evidence"]][["a", "b"]].drop_duplicates()
        pairs = [pair for pair in one.to_numpy().tolist() if not {*pair} & set(comparison.without_weight)]
        said += [f"{a} and {b} are one method" for a, b in pairs]
    return said


def evidence_records(comparison: Comparison) -> list[dict[str, Any]]:
    """Runs of layers that rest on the same two slicers: their names, first and last layer; none where there are none."""
    found: list[dict[str, Any]] = []
    for layer, names in enumerate(comparison.layers["rests_on"]):
        methods = names.split(",") if names else []
        if found and found[-1]["methods"] == methods:
            found[-1]["last_layer"] = layer
        else:
            found.append({"methods": methods, "first_layer": layer, "last_layer": layer})
    return found


def resting(comparison: Comparison) -> str:
    """On which two slicers the layers rest, in short."""
    counts = Counter(" and ".join(names.split(",")) for names in comparison.layers["rests_on"] if names)
    if len(counts) == 1 and counts.total() == len(comparison.layers):
        return f"every one rests on {next(iter(counts))}"
    parts = [f"{names} ({count})" for names, count in counts.most_common()]
    return f"evidence of {', '.join(parts)}" if parts else ""


# -- choice of slicers -----------------------------------------------------------------------------

ALL = "all"  # word for every installed witness


def chosen_backends(config: Config) -> dict[str, BackendSettings]:
    """Settings of the backends to run, by name: those asked for or all that are available, and the witnesses.

    Raises SettingsError for a choice that contradicts itself, BackendMissing for a name that is unknown or not available.
    """
    chosen = config.slicing
    for name in chosen.required:
        registry.available_slicer(name)
    for name in chosen.settings:
        registry.slicer(name)
    if chosen.primary:
        registry.available_slicer(chosen.primary)
    usable = [name for name in registry.house_slicers() if registry.probe(name).available]
    if not (chosen.backends or usable):
        raise BackendMissing("no backend is available: see `ebamcheck backends` for the reasons")
    witnesses = [registry.slicer(name).name for name in chosen.witnesses if name != ALL]
    if ALL in chosen.witnesses:
        witnesses = [name for name in registry.witnesses() if registry.probe(name).available]
    names = dict.fromkeys([*(_asked_for(config) if chosen.backends else usable), *witnesses])
    return {name: registry.slicer_settings(name, chosen.settings.get(name, {})) for name in names}


def unavailable_backends(config: Config) -> dict[str, Outcome]:
    """Outcomes of the backends that would have run if this machine had what they need."""
    asked = [] if config.slicing.backends else registry.house_slicers()
    if ALL in config.slicing.witnesses:
        asked += registry.witnesses()
    probes = {name: registry.probe(name) for name in asked}
    why = {name: f"{probe.why}; {probe.hint}" if probe.hint else probe.why for name, probe in probes.items()}
    lacking = ((name, probe) for name, probe in probes.items() if not probe.available)
    return {name: Outcome(name, "unavailable", why[name], probe=probe) for name, probe in lacking}


def _rank(name: str) -> tuple[bool, bool, int, str]:
    slicer = registry.slicer(name)
    return slicer.priority >= 0, slicer.exact, slicer.priority, name


def _asked_for(config: Config) -> list[str]:
    """Backends that the settings name, once they hold what else the settings ask for."""
    chosen = config.slicing
    for name in (chosen.primary, *chosen.required):
        if name and name not in chosen.backends:
            raise SettingsError(
                f"slicing.backends {', '.join(chosen.backends)} leaves out {name!r}, "
                "which slicing.primary or slicing.required names"
            )
    return [registry.slicer(name).name for name in chosen.backends]


def witness_backend(maker: str, among: Sequence[str] | None = None) -> str:
    """Exact backend of the highest priority that did not make a program, among some, else those of the house that are available;
    else `maker`."""
    maker = maker or registry.default_backend()
    known = registry.house_slicers() if among is None else among
    others = [name for name in known if name != maker and registry.slicer(name).exact]
    first = sorted(others, key=lambda name: -registry.slicer(name).priority)
    # A probe of some asks drivers and other programs: none is asked whose answer does not matter.
    return next((name for name in first if among is not None or registry.probe(name).available), maker)
