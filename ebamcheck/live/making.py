"""One layer, end to end: cut by two exact methods, compared, fitted, filled, put in order, written, read back, judged.

It is a program of its own, whose lowest layer lies on what stands: the text that the control gets is the one that was verified.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.bead_checks import form_checks
from ebamcheck.checks.interpass_checks import scans_of
from ebamcheck.checks.matching import matched
from ebamcheck.checks.mesh_checks import layer_check, sections_check
from ebamcheck.checks.part_file import file_check
from ebamcheck.checks.table import Stands, turned_checks
from ebamcheck.checks.text_checks import marked_validated
from ebamcheck.errors import BackendMissing, EbamcheckError, SettingsError
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.heat.preheating import asked_for, preheated
from ebamcheck.layers.stack import Layers
from ebamcheck.live.before import Before, metal_checks
from ebamcheck.live.heights import at_layer_feed
from ebamcheck.mesh.inspection import inspect
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import PlatePart
from ebamcheck.nc.control import control
from ebamcheck.pipeline import gates, stages
from ebamcheck.pipeline.cross_check import compared_layers, witness_backend
from ebamcheck.pipeline.fit import fitted
from ebamcheck.plugins import registry
from ebamcheck.program import ProgramFiles, verify_program
from ebamcheck.result import Check
from ebamcheck.scan.islands.regions import contour_region
from ebamcheck.scan.order.orders import needs_heat
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.scan.plan.stacking import stack_plans
from ebamcheck.scan.plan.whole_part import Stack, laid_layer, ordered_on
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Outcome, declared_bounds
from ebamcheck.slicers.slicing import Slicing
from ebamcheck.surface.part_surface import keep_surface_of

ROOM_K = 10.0  # room under the limit beside what was found over it: with other waits and power beads are entered at other moments


@dataclass(frozen=True)
class Wanted:
    """A layer that is to be made."""

    layer: int  # its index in the build, from 0
    base_mm: float  # Z of what it lies on
    thickness_mm: float
    name: str
    shifted: int = 0  # islands and hatch lie as on the layer so many higher

    @property
    def top_mm(self) -> float:
        """Z of its top."""
        return self.base_mm + self.thickness_mm


@dataclass(frozen=True, eq=False)
class MadeLayer:
    """A layer that was made, whether it may be published or not."""

    wanted: Wanted
    config: Config
    files: ProgramFiles
    gates: tuple[Check, ...]
    checks: tuple[Check, ...]
    after: Before  # what stands when it is done
    wait_s: float  # least time between the last bead below and its first one
    islands: int
    deposit_s: float  # its time with the waits within it
    seconds: dict[str, float]  # that the making took, by stage

    @property
    def cut_mm(self) -> float:
        """Absolute height of the cut."""
        return self.config.layers.heights_mm[0]

    @property
    def passed(self) -> bool:
        """Whether every gate is open."""
        return self.files.validated and all(gate.passed for gate in self.gates)

    @property
    def why(self) -> str:
        """What the shut gates say; empty where all are open."""
        return "; ".join(f"gate {gate.name}: {gate.text}" for gate in self.gates if not gate.passed)


class LayerMaker(AbstractContextManager["LayerMaker"]):
    """A part as placed and two slicers, ready to make any layer of it; the contours of `primary`, or of the default one, become the
    program."""

    def __init__(self, part: Part, config: Config, primary: str = "", annealing_steps: int = 0) -> None:
        name = config.machine.control
        if config.preheat.when != "off":
            # Layers are released one by one: a scan that preheats is part of its layer's file.
            preheat = config.preheat.model_copy(update={"scan_in": "layer"})
            config = config.model_copy(update={"preheat": preheat})
        if not control(name).is_read:
            said = "what is written for it is not read back, so that no layer of it can be proved"
            raise SettingsError(f"machine.control {name!r}: {said}")
        self.part, self.config, self.annealing_steps = part, config, annealing_steps
        self.primary = primary or config.slicing.primary or registry.default_backend()
        self.witness = witness_backend(self.primary)
        if self.witness == self.primary:
            said = f"no exact slicer beside {self.primary!r} is there: two methods have to agree"
            raise BackendMissing(said)
        self.sound = gates.input_gate(inspect(part))
        self.height_mm = float(part.size[2])  # Z of its top
        keep_surface_of(part)
        # What every layer has alike is made once, and written out once.
        # The direction that a part has been turned by; settings of a plate are of the parts which name none.
        turned = {} if isinstance(part, PlatePart) else {"direction": part.direction}
        self._of_part = config.part.model_copy(update=turned)
        self._of_scan = config.scan.model_copy(update={"annealing_steps": annealing_steps})
        self._of_file = file_check(part, config.model_copy(update={"part": self._of_part}))
        self.stands: Stands | None = None  # of a part that is turned between layers
        self._open = ExitStack()
        self._aside = self._open.enter_context(ThreadPoolExecutor(1))
        given = {name: config.slicing.settings.get(name, {}) for name in (self.primary, self.witness)}
        settings = {name: registry.slicer_settings(name, values) for name, values in given.items()}
        self._bounds = declared_bounds(part, settings)
        self._slicings = {
            name: self._open.enter_context(Slicing(part, name, **values.model_dump()))
            for name, values in settings.items()
        }

    def __exit__(self, *_: object) -> None:
        """Free what the slicers hold."""
        self._open.close()

    @property
    def bottom_mm(self) -> float:
        """Absolute height of the part's lowest point."""
        return float(self.part.bounds[0, 2])

    def section_at(self, height_mm: float, backend: str = "") -> BaseGeometry:
        """Section of the part at a height over its lowest point."""
        return self._slicings[backend or self.primary].at(self.bottom_mm + height_mm).section(0)

    def config_of(self, wanted: Wanted, mapped: bool = False, along: bool = True) -> Config:
        """Settings of the program of one layer: those of the run, with its height and name, and the feed for that height."""
        cut_mm = self.bottom_mm + wanted.base_mm + 0.5 * wanted.thickness_mm
        sections = at_layer_feed(self.config, wanted.thickness_mm, mapped, along)
        # Values that were worked out here need no check of all others, which takes a while with many plugins.
        heights = {"heights_mm": (cut_mm,), "layer_height_mm": wanted.thickness_mm}
        layers = sections.layers.model_copy(update=heights | {"base_mm": wanted.base_mm})
        machine = sections.machine.model_copy(update={"program_name": wanted.name})
        update = {"part": self._of_part, "layers": layers, "scan": self._of_scan, "machine": machine}
        return sections.model_copy(update=update)

    def make(self, wanted: Wanted, before: Before, folder: Path) -> MadeLayer:
        """Make one layer on what stands; its program goes to `folder`, and is stamped as validated where every gate is open.

        Where the feed follows along the path and a gate shuts, the plan aims cooler if the heat alone is over, and then the wire
        follows alone."""
        mapped = before.surface is not None and before.surface.mapped
        config = self.config_of(wanted, mapped)
        made = self._made(wanted, before, folder, config)
        if made.passed or not config.process.feed_along_path:
            return made
        shut = [gate for gate in made.gates if not gate.passed]
        if len(shut) == 1 and shut[0].name == "heat" and 0.0 < shut[0].value - shut[0].limit <= 150.0:
            made = self._made(wanted, before, folder, config, shut[0].value - shut[0].limit)
        if made.passed:
            return made
        return self._made(wanted, before, folder, self.config_of(wanted, mapped, False))

    def _made(self, wanted: Wanted, before: Before, folder: Path, config: Config, cooler_k: float = 0.0) -> MadeLayer:
        """Make one layer by its settings, on a plan that aims under the limit of the heat by some kelvins."""
        seconds: dict[str, float] = {}
        stands, aimed = before.measured(), config
        if cooler_k > 0.0:
            limit = {"interpass_limit_k": entry_limit_k(config) - cooler_k - ROOM_K}
            aimed = config.model_copy(update={"process": config.process.model_copy(update=limit)})
        with timed(seconds, "slice"):
            cuts = self._cut(wanted, config)
        contours, witness = cuts[self.primary], cuts[self.witness]
        # What only judges goes on beside what makes the program.
        comparing = self._aside.submit(self._agreement, cuts, seconds)
        with timed(seconds, "fit"):
            verdict, _ = fitted(contours, self.part, config, self._bounds[self.primary][0])
            smooth = stages.smooth_layers(verdict.curves)
        with timed(seconds, "plan"):
            plan, after, wait_s = self._planned(smooth, wanted, stands, aimed)
        agreement = comparing.result()
        with timed(seconds, "write"):
            laid = stages.laid_out(smooth, plan, config, wanted.layer)
            files = stages.written(laid, self.part, config, folder)
        with timed(seconds, "verify"):
            read = control(config.machine.control).load("reader")
            program, match = matched(read(files.main, config), laid.path)
            weighing = self._aside.submit(metal_checks, program, witness, after, config)
            # The program of the layer below ended with a rise, which the plan counts: it is not in the text of this one.
            rise_s = config.machine.safe_height_mm / config.machine.rapid_mm_s
            under, smooth_by = (
                self._under(config, self.witness),
                stages.smooth_sections(verdict.curves, config),
            )
            checks = verify_program(
                program, config=config, curves=laid.beads, plan=plan, match=match, layers=witness, heat=True,
                before=before.rested(wait_s + rise_s).part.column, under=under, sha256=files.sha256, smooth=smooth_by,
            )  # fmt: skip
            cut_mm = float(witness.heights[0])
            by_mesh = layer_check(self.part, cut_mm, config.base_mm, config.layer_height_mm)
            sections = sections_check(self.part, witness, config)
            beside, after = weighing.result()
            checks += [*beside, by_mesh, sections, *form_checks(program, config), self._of_file]
            if self.stands is not None:
                section = witness.section(0)
                checks += turned_checks(program, section, config.layers.heights_mm[0], self.stands, config)
            made = [self.sound, agreement, *stages.judged_program(verdict, checks, plan.metrics, config)]
            files = marked_validated(files) if all(gate.passed for gate in made) else files
        scan_s = sum(float(way.time_s.sum()) for way in scans_of(program, config).values())
        return MadeLayer(
            wanted, config, files, tuple(made), tuple(checks), after, wait_s, len(plan.islands),
            scan_s + (after.last.time_s if after.last else 0.0), seconds,
        )  # fmt: skip

    def _cut(self, wanted: Wanted, config: Config) -> dict[str, Layers]:
        cut_mm = config.layers.heights_mm[0]
        cuts = {name: slicing.at(cut_mm) for name, slicing in self._slicings.items()}
        if not any(len(cut.points) for cut in cuts.values()):
            raise SettingsError(f"layer {wanted.layer + 1}: the part has no section at {cut_mm:g} mm")
        return cuts

    def _agreement(self, cuts: dict[str, Layers], seconds: dict[str, float]) -> Check:
        with timed(seconds, "compare"):
            found = compared_layers(cuts, self.part, self._bounds, self.config, count_evidence=False)
            # Nothing is written here: an outcome is done when it has a file.
            done = {name: Outcome(name, file=Path(name)) for name in cuts}
            return gates.agreement_gate(found, done, 1)

    def _under(self, config: Config, backend: str) -> BaseGeometry | None:
        """Section of what the layer lies on, half a layer under its bottom, where that is preheated."""
        if config.base_mm == 0.0 or not asked_for(0, config):
            return None
        return self.section_at(max(config.base_mm - 0.5 * config.layer_height_mm, 0.0), backend)

    def _planned(
        self, smooth: Layers, wanted: Wanted, before: Before, config: Config
    ) -> tuple[ScanPlan, Before, float]:
        """Plan of the layer on what stands; the same with the heat when it is done; and the wait before it, s."""
        order, seed = config.scan.order, config.scan.seed
        section = smooth.section(0)
        contours = [contour_region(section, config)]
        beads = stages.contour_curves(smooth, contours, config, wanted.layer)
        numbers = [wanted.layer + wanted.shifted]
        stack = Stack([section], np.array([smooth.heights[0]]), numbers, self.bottom_mm, contours)
        ready = laid_layer(stack, 0, config, seed)
        carry = config.scan.carry_heat and needs_heat(order)
        under = self._under(config, self.primary)
        warm, passes = preheated(before.part, [section], 0, wanted.base_mm, config, under)
        power_of = stages.power_by_wire([section], beads, config, before.surface)
        how = wanted.thickness_mm, config, order, carry, not before.laid, power_of
        done, part, last = ordered_on(warm, before.last, ready, *how)
        if done.heat is not None:
            done = replace(done, heat=replace(done.heat, preheat_passes=passes))
        if config.process.interpass == "off" and not carry and not passes:
            done = replace(done, heat=None)
        plan = stack_plans([done], config, order, seed)
        plan = replace(plan, under=under, stands=before.surface, beads=beads)
        wait_s = 0.0 if last is None or last is before.last else last.wait_s
        return plan, replace(before, part=part, last=last), wait_s


def failure_of(error: Exception) -> str:
    """One line for what ended the making of a layer."""
    text = " ".join(str(error).split())
    return text if isinstance(error, EbamcheckError) else f"internal error: {type(error).__name__}: {text}"


@contextmanager
def timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    """Keep the time of a block."""
    begin = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - begin
