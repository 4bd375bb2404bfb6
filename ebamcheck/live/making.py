"""One layer, end to end: cut by two exact methods, compared, fitted, filled, put in order, written, read back, judged.

A layer is a program of its own, whose lowest layer lies on what stands (``layers.base_mm``): the whole text that the
control gets is the text that was verified, and anybody can verify it again from part and settings.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.backend import BackendSettings
from ebamcheck.checks.hatch_form import form_checks
from ebamcheck.checks.marked import marked_validated
from ebamcheck.checks.matching import matched
from ebamcheck.checks.table import Stands, turned_checks
from ebamcheck.checks.text_heat import scans_of
from ebamcheck.curves import fit_for_program
from ebamcheck.curves.per_part import keep_surface_of
from ebamcheck.errors import BackendMissing, EbamcheckError, SettingsError
from ebamcheck.json_values import sha256_of_json
from ebamcheck.layers.stack import Layers
from ebamcheck.live.heat_so_far import HeatSoFar
from ebamcheck.live.layer_feed import aimed_lower, at_layer_feed, with_feed_along
from ebamcheck.live.metal_so_far import MetalSoFar, mesh_and_metal
from ebamcheck.mesh.inspection import inspect
from ebamcheck.mesh.part import Part
from ebamcheck.metal import Surface
from ebamcheck.nc.control import control
from ebamcheck.nc.motions import NCProgram
from ebamcheck.pipeline import gates
from ebamcheck.pipeline.choice import witness_backend
from ebamcheck.pipeline.cross_check import compared_layers
from ebamcheck.pipeline.fit_evidence import FitVerdict, judged
from ebamcheck.pipeline.gates import Gate
from ebamcheck.pipeline.part_file import file_check
from ebamcheck.pipeline.placement import as_placed
from ebamcheck.pipeline.planned_power import power_by_wire
from ebamcheck.pipeline.stages import (
    judged_program,
    laid_out,
    smooth_layers,
    smooth_sections,
    written,
)
from ebamcheck.plugins import registry
from ebamcheck.program import Check, ProgramFiles, verify_program
from ebamcheck.scan.order.orders import needs_heat
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.scan.plan.preheated import asked_for, preheated
from ebamcheck.scan.plan.stacking import in_order, stack_plans
from ebamcheck.scan.plan.whole_part import Stack, laid_layer, ordered_on
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Outcome, declared_bounds
from ebamcheck.slicers.slicing import Slicing


@dataclass(frozen=True)
class Wanted:
    """A layer that is to be made: its index in the build, from 0; Z of what it lies on; its height; and its name.

    Islands and hatch lie as on the layer of index `layer + shifted`.
    """

    layer: int
    base_mm: float
    thickness_mm: float
    name: str
    shifted: int = 0

    @property
    def top_mm(self) -> float:
        """Z of its top."""
        return self.base_mm + self.thickness_mm


@dataclass(frozen=True, eq=False)
class MadeLayer:
    """A layer that was made, whether it may be published or not.

    Parameters
    ----------
    wanted, config, cut_mm
        What was asked for, the settings of its program, and the absolute height of the cut.
    files
        Its program; None where a gate shut before one was written.
    gates, checks
        What was judged.
    heat, metal
        The part's heat and metal when it is done; those before it where no program was written.
    wait_s
        Least time between the last bead below and the first of this layer.
    islands, deposit_s
        Islands, and the time with the waits within the layer.
    seconds
        Time that each stage took.
    """

    wanted: Wanted
    config: Config
    cut_mm: float
    files: ProgramFiles | None
    gates: tuple[Gate, ...]
    checks: tuple[Check, ...]
    heat: HeatSoFar
    metal: MetalSoFar
    wait_s: float
    islands: int
    deposit_s: float
    seconds: dict[str, float]

    @property
    def passed(self) -> bool:
        """Whether every gate is open and there is a program."""
        return self.files is not None and self.files.validated and all(gate.passed for gate in self.gates)

    @property
    def why(self) -> str:
        """What the shut gates say; empty where all are open."""
        return "; ".join(f"gate {gate.name}: {gate.text}" for gate in self.gates if not gate.passed)


class LayerMaker:
    """A part and two slicers, ready to make any layer of it.

    Parameters
    ----------
    part
        The part as placed.
    config
        Settings of the run.
    primary
        Slicer whose contours become the program; empty: the one of the settings, else the default one.
    annealing_steps
        Moves by which an order of islands is improved: the greedy plans alone are a matter of a tenth of a second.

    Raises
    ------
    BackendMissing
        If there are no two exact slicers on this machine.
    SettingsError
        If programs of the control are not read back.
    """

    def __init__(self, part: Part, config: Config, primary: str = "", annealing_steps: int = 0) -> None:
        name = config.machine.control
        config = preheated_in_layers(config)
        if not control(name).is_read:
            raise SettingsError(
                f"machine.control {name!r}: what is written for it is not read back, so that no layer of it can be proved"
            )
        self.part, self.config, self.annealing_steps = part, config, annealing_steps
        self.primary = primary or config.slicing.primary or registry.default_backend()
        self.witness = witness_backend(self.primary)
        if self.witness == self.primary:
            raise BackendMissing(
                f"no exact slicer beside {self.primary!r} is there: two methods have to agree"
            )
        self.sound = gates.input_gate(inspect(part))
        keep_surface_of(part)
        # What every layer has alike is made once, and written out once.
        self._of_part = as_placed(part, config.part)
        self._of_scan = config.scan.model_copy(update={"annealing_steps": annealing_steps})
        self._of_file = file_check(part, config.model_copy(update={"part": self._of_part}))
        self.stands: Stands | None = None
        """What stands of a part that is turned between layers; None: it is not."""
        self._open = ExitStack()
        self._aside = self._open.enter_context(ThreadPoolExecutor(1))
        settings = {name: self._settings(name) for name in (self.primary, self.witness)}
        self._bounds = declared_bounds(part, settings)
        self._slicings = {
            name: self._open.enter_context(Slicing(part, name, **values.model_dump()))
            for name, values in settings.items()
        }

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Free what the slicers hold."""
        self._open.close()

    def _settings(self, backend: str) -> BackendSettings:
        return registry.slicer_settings(backend, self.config.slicing.settings.get(backend, {}))

    @property
    def bottom_mm(self) -> float:
        """Absolute height of the part's lowest point."""
        return float(self.part.bounds[0, 2])

    @property
    def height_mm(self) -> float:
        """Height of the part: Z of its top."""
        return float(self.part.size[2])

    def section_at(self, height_mm: float, backend: str = "") -> BaseGeometry:
        """Section of the part at a height over its lowest point."""
        cut = self._slicings[backend or self.primary].at(self.bottom_mm + height_mm)
        return cut.section(0)

    def config_of(self, wanted: Wanted, mapped: bool = False, along: bool = True) -> Config:
        """Settings of the program of one layer: those of the run, with its height and name, and the feed for that height."""
        cut_mm = self.bottom_mm + wanted.base_mm + 0.5 * wanted.thickness_mm
        sections = at_layer_feed(self.config, wanted.thickness_mm, mapped, along)
        # Values that were worked out here need no check of all others, which takes a while with many plugins.
        return sections.model_copy(
            update={
                "part": self._of_part,
                "layers": sections.layers.model_copy(
                    update={
                        "heights_mm": (cut_mm,),
                        "layer_height_mm": wanted.thickness_mm,
                        "base_mm": wanted.base_mm,
                    }
                ),
                "scan": self._of_scan,
                "machine": sections.machine.model_copy(update={"program_name": wanted.name}),
            }
        )

    def make(
        self, wanted: Wanted, heat: HeatSoFar, folder: Path, metal: MetalSoFar | None = None
    ) -> MadeLayer:
        """Make one layer; its program goes to `folder`, and is stamped as validated where every gate is open.

        Parameters
        ----------
        heat
            The part's heat when the layer under it is done.
        metal
            The metal that stands; None: nothing is known of it, and the layer is judged by itself, on a level surface.

        Raises
        ------
        EbamcheckError
            If a stage cannot do its work at all: the layer has no section, a slicer fails, a setting is wrong.
        """
        mapped = metal is not None and metal.mapped_surface
        make = partial(self._made, wanted, heat, folder, metal)
        return with_feed_along(
            make, self.config_of(wanted, mapped), partial(self.config_of, wanted, mapped, False)
        )

    def _made(
        self,
        wanted: Wanted,
        heat: HeatSoFar,
        folder: Path,
        metal: MetalSoFar | None,
        config: Config,
        cooler_k: float = 0.0,
    ) -> MadeLayer:
        """Make one layer by its settings, on a plan that aims under the limit of the heat by some kelvins."""
        clock = Clock()
        with clock.stage("slice"):
            cuts = self._cut(wanted, config)
        contours, witness = cuts[self.primary], cuts[self.witness]
        # What only judges goes on beside what makes the program.
        comparing = self._aside.submit(self._agreement, cuts, clock)
        with clock.stage("fit"):
            verdict = self._fitted(contours, config)
            smooth = smooth_layers(verdict.curves)
        stands = None if metal is None else metal.measured()
        surface = None if stands is None else stands.surface
        with clock.stage("plan"):
            plan, after, wait_s = self._planned(smooth, wanted, heat, aimed_lower(config, cooler_k), surface)
        agreement = comparing.result()
        with clock.stage("write"):
            laid = laid_out(smooth, plan, config, wanted.layer)
            files = written(laid, self.part, config, folder)
        with clock.stage("verify"):
            read = control(config.machine.control).load("reader")
            program, _ = matched(read(files.main, config), laid.path)
            weighing = self._aside.submit(mesh_and_metal, program, self.part, witness, stands, config)
            # The program of the layer below ended with a rise, which the plan counts: it is not in the text of this one.
            rise_s = config.machine.safe_height_mm / config.machine.rapid_mm_s
            checks = verify_program(
                program,
                config=config,
                curves=laid.beads,
                plan=plan,
                path=laid.path,
                layers=witness,
                heat=True,
                before=heat.rested(wait_s + rise_s).part.column,
                under=self._under(config, self.witness),
                sha256=files.sha256,
                smooth=smooth_sections(verdict.curves, config),
            )
            beside, stands = weighing.result()
            checks += [*beside, *form_checks(program, config), self._of_file]
            if self.stands is not None:
                section = witness.section(0)
                checks += turned_checks(program, section, config.layers.heights_mm[0], self.stands, config)
            made = [self.sound, agreement, *judged_program(verdict, checks, plan.metrics, config)]
            files = marked_validated(files) if all(gate.passed for gate in made) else files
        return MadeLayer(
            wanted, config, config.layers.heights_mm[0], files, tuple(made), tuple(checks), after, stands, wait_s,
            len(plan.islands), after.layer_s + scan_seconds(program, config), clock.seconds,
        )  # fmt: skip

    def _cut(self, wanted: Wanted, config: Config) -> dict[str, Layers]:
        """Section of the layer by both slicers."""
        cut_mm = config.layers.heights_mm[0]
        cuts = {name: slicing.at(cut_mm) for name, slicing in self._slicings.items()}
        if not any(len(cut.points) for cut in cuts.values()):
            raise SettingsError(f"layer {wanted.layer + 1}: the part has no section at {cut_mm:g} mm")
        return cuts

    def _fitted(self, contours: Layers, config: Config) -> FitVerdict:
        """Curves of the contours, and what the mesh says of them."""
        bound_mm, _ = self._bounds[self.primary]
        curves = fit_for_program(contours, config.curves, self.part, error_bound_mm=bound_mm)
        return judged(curves, contours, self.part, config)[0]

    def _agreement(self, cuts: dict[str, Layers], clock: Clock) -> Gate:
        """Whether both methods agree on the layer."""
        with clock.stage("compare"):
            found = compared_layers(cuts, self.part, self._bounds, self.config, count_evidence=False)
            # Nothing is written here: an outcome is done when it has a file.
            done = {name: Outcome(name, file=Path(name)) for name in cuts}
            return gates.agreement_gate(found, done, 1)

    def _under(self, config: Config, backend: str) -> BaseGeometry | None:
        """Section of what the layer lies on, where that is preheated."""
        at_mm = height_under_mm(config)
        return None if at_mm is None else self.section_at(at_mm, backend)

    def _planned(
        self, smooth: Layers, wanted: Wanted, heat: HeatSoFar, config: Config, surface: Surface | None
    ) -> tuple[ScanPlan, HeatSoFar, float]:
        """Plan of the layer on the heat so far; the heat when it is done; and the wait before it, s."""
        order, seed = config.scan.order, config.scan.seed
        section = smooth.section(0)
        stack = Stack(
            [section], np.array([smooth.heights[0]]), [wanted.layer + wanted.shifted], self.bottom_mm
        )
        laid, islands = laid_layer(stack, 0, config, seed)
        carry = config.scan.carry_heat and needs_heat(order)
        under = self._under(config, self.primary)
        warm, passes = preheated(heat.part, [section], 0, wanted.base_mm, config, under)
        power_of = power_by_wire([section], config, surface, wanted.layer)
        done, part, last = ordered_on(
            warm, heat.last, laid, islands, wanted.thickness_mm, config, order, carry, not heat.laid, power_of
        )
        if done.heat is not None:
            done = replace(done, heat=replace(done.heat, preheat_passes=passes))
        if config.process.interpass == "off" and not carry and not passes:
            done = replace(done, heat=None)
        plan = replace(stack_plans([in_order(done)], config, order, seed), under=under, stands=surface)
        wait_s = 0.0 if last is None or last is heat.last else last.wait_s
        return plan, replace(heat, part=part, last=last), wait_s


def program_settings_sha256(config: Config) -> str:
    """Hash of the settings of a layer's program, as its header says it."""
    return sha256_of_json(config.model_dump())


def failure_of(error: Exception) -> str:
    """One line for what ended the making of a layer."""
    text = " ".join(str(error).split())
    return text if isinstance(error, EbamcheckError) else f"internal error: {type(error).__name__}: {text}"


class Clock:
    """Times of named stages, s."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a block."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin


def preheated_in_layers(config: Config) -> Config:
    """Settings of layers that are released one by one: a scan that preheats is part of its layer's file."""
    if config.preheat.when == "off":
        return config
    return config.model_copy(update={"preheat": config.preheat.model_copy(update={"scan_in": "layer"})})


def height_under_mm(config: Config) -> float | None:
    """Height over the plate at which the section of what a layer lies on is taken, half a layer under its bottom.

    None where nothing is preheated there.
    """
    if config.base_mm == 0.0 or not asked_for(0, config):
        return None
    return max(config.base_mm - 0.5 * config.layer_height_mm, 0.0)


def scan_seconds(program: NCProgram, config: Config) -> float:
    """Time of the scan of a layer's program, with its wait."""
    return sum(float(way.time_s.sum()) for way in scans_of(program, config).values())
