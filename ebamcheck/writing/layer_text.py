"""Writes the blocks of one layer, which all controls share: travel, beam, wire, waits, motions of each track, and preheating."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ebamcheck.heat.preheating import pass_lines, scanned
from ebamcheck.kernels import Floats, Ints
from ebamcheck.nc.control import Control
from ebamcheck.nc.conventions import comment, header_lines, plain, safe_end_mm
from ebamcheck.nc.inputs import CurveColumns, Interpass, ScanColumns, interpass_of
from ebamcheck.nc.templates import ProcessValues, process_values, usable_templates
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import feed_shares, wire_at
from ebamcheck.writing.bead_ends import driven_path
from ebamcheck.writing.bead_parts import layer_power
from ebamcheck.writing.blocks import BlockFormat, Templates, end_blocks, entry_blocks, start_blocks
from ebamcheck.writing.events import NEAR_SPACINGS
from ebamcheck.writing.segments import CIRCULAR, CUBIC, STRAIGHT, Form
from ebamcheck.writing.tracks import Toolpath


def motion_text(path: Toolpath, form: BlockFormat, cubics: Sequence[str]) -> list[str]:
    """Return the text of every segment (N,): G1, G2 or G3; a cubic segment takes its entry of `cubics`, which has several lines, or
    none where another entry carries it."""
    text = np.empty(path.kind.size, dtype=object)
    straight, round_ = path.kind == STRAIGHT, path.kind == CIRCULAR
    text[straight] = form.lines(path.end[straight])
    text[round_] = form.arcs(path.segment_start[round_], path.end[round_], path.circles)
    text[path.kind == CUBIC] = cubics
    text[path.turn] += " ; TURN"
    text[path.goes_on] += " ; GOES ON"
    result: list[str] = text.tolist()
    return result


@dataclass(frozen=True, eq=False)
class Post:
    """Plan, settings, toolpath and templates from which the blocks of one program are written."""

    plan: ScanColumns
    config: Config
    control: Control
    path: Toolpath
    form: BlockFormat
    templates: Templates
    heat: Interpass

    @classmethod
    def of(
        cls, curves: CurveColumns, plan: ScanColumns, config: Config, control: Control, splines: Form,
        path: Toolpath | None,
    ) -> Post:  # fmt: skip
        """Take templates and tracks as the control gets them; `path` holds the tracks if they are laid out already."""
        machine = config.machine
        templates, form = usable_templates(config, control.name), BlockFormat(machine.printed_decimals)
        path = path or driven_path(curves, plan, config, form.decimals, splines, machine.line_tolerance_mm)
        return cls(plan, config, control, path, form, templates, interpass_of(plan, config))

    def values(self, k: int) -> ProcessValues:
        """Values of layer `k`."""
        return process_values(self.config, k + 1, float(self.path.z[k]), float(self.path.thickness[k]))

    def begin(self, modes: Sequence[str], header: Mapping[str, str] | None) -> list[str]:
        """Header and blocks that begin the program."""
        known = header_lines(self.config, self.control, len(self.path.z)) | dict(header or {})
        comments = [comment(f"{key}: {value}") for key, value in known.items()]
        return [*comments, *start_blocks(modes, self._first_values, self.templates)]

    def end(self, top_mm: float | None = None) -> list[str]:
        """Blocks that end the program, over the last layer or another height."""
        top = float(self.path.z[-1]) if len(self.path.z) else 0.0
        top = top if top_mm is None else top_mm
        return end_blocks(top, self._first_values, self.config, self.form, self.templates)

    @property
    def _first_values(self) -> ProcessValues:
        first = float(self.path.z[0]) if len(self.path.z) else 0.0
        return process_values(self.config, 1, first, first)


def layer_blocks(
    post: Post, k: int, motions: Sequence[str], entry: Sequence[str],
    around: tuple[Sequence[str], Sequence[str]] = ((), ()),
) -> list[str]:  # fmt: skip
    """Blocks of layer `k`: contour rings and islands, each track between beam on and beam off, and the waits.

    The layer begins with the modes `entry` and its own power, so that the control can enter the program there; the blocks of
    `around` come before its first travel and after its last."""
    path, heat, templates = post.path, post.heat, post.templates
    values, share = post.values(k), float(post.heat.power_share[k])
    layer = _Layer(post, k)
    layer.deposit_tracks(motions)
    above = path.layer_starts[k + 1 : k + 3]
    wait_s = heat.before_layer_s(k + 1) if above.size == 2 and above[1] > above[0] else 0.0
    return [
        comment(f"LAYER: {k + 1} OF {len(path.z)}, CUT AT {path.cut[k]:.6f}, Z {path.z[k]:.6f}"),
        *entry_blocks(entry, values.at(share, 1.0), templates),
        *values.fill("layer_begin", templates["layer_begin"]),
        *around[0],
        *layer.lines,
        *around[1],
        *values.fill("layer_end", templates["layer_end"]),
        *pause_blocks(values, templates, wait_s),
    ]


def pause_blocks(values: ProcessValues, templates: Templates, wait_s: float) -> list[str]:
    """Return the blocks that wait for `wait_s`; none if it is not positive."""
    if wait_s <= 0.0:
        return []
    return replace(values, layer_pause_s=wait_s).fill("layer_pause", templates["layer_pause"])


class _Layer:
    """Blocks of one layer, and where the tool is while they are written."""

    def __init__(self, post: Post, k: int) -> None:
        config, form, z_mm = post.config, post.form, float(post.path.z[k])
        self.lines: list[str] = []
        self._post, self._k = post, k
        self._near_mm = NEAR_SPACINGS * config.process.hatch_spacing_mm
        self._form = form
        self._z, self._safe_z = form.value(z_mm), form.value(z_mm + config.machine.safe_height_mm)
        self._values, self._templates = post.values(k), post.templates
        ends = ("wire_stop", "wire_retract", "beam_off")
        off = ends if self._values.wire_retract_mm > 0.0 else (ends[0], ends[2])
        self._names = (("set_power",), ("set_wire",), ("beam_on", "wire_start"), off)
        texts = ["".join(line for n in names for line in self._templates[n]) for names in self._names]
        # Whether the blocks of a group depend on the power, and on the wire.
        self._asked = [("{power_w" in text or "{current_ma" in text, "{wire_mm_s" in text) for text in texts]
        self._blocks: dict[tuple[int, float, float], list[str]] = {}
        self._feeds: dict[float, str] = {}
        self._power, self._wire = float(post.heat.power_share[k]), 1.0
        self._position: Floats | None = None

    def deposit_tracks(self, motions: Sequence[str]) -> None:
        """Write all tracks of the layer and the waits between them, from the safe height back to it."""
        path, heat, config, k = self._post.path, self._post.heat, self._post.config, self._k
        speed, share = self._values.wire_mm_s, float(heat.power_share[k])
        rise = f"G0 Z{self._safe_z}"
        self.lines.append(rise)
        if config.machine.optional_stop:
            self.lines.append("M1")
        first, last = path.track_starts[path.layer_starts[k : k + 2]].tolist()
        wire = path.width[first:last] / config.process.bead_metal_mm
        feed = feed_shares(wire * speed, config, share)
        wire = wire_at(wire * speed, feed, config) / speed if (feed != 1.0).any() else wire
        power = layer_power(path, k, slice(first, last), share, config)
        island, entered = -1, False
        for t in range(int(path.layer_starts[k]), int(path.layer_starts[k + 1])):
            if path.ring[t] >= 0:
                self._wait(float(heat.ring_wait_s[k]) if t > path.layer_starts[k] else 0.0)
                self.lines.append(f"; RING {path.ring[t]}")
            elif path.island[t] != island:
                island = int(path.island[t])
                self._wait(float(heat.island_wait_s[island]))
                self.lines.append(f"; ISLAND {island}")
                entered = False
            a, b = int(path.track_starts[t]), int(path.track_starts[t + 1])
            if b > a:
                if path.island[t] >= 0:
                    self._wait(float(heat.inner_wait_s[island]) if entered else 0.0)
                    entered = True
                own = slice(a - first, b - first)
                self._deposit(path.start[t], path.end[b - 1], motions[a:b], power[own], wire[own], feed[own])
        self.lines.append(rise)

    def _switches(self, group: int) -> list[str]:
        """Blocks at the current power and wire: group 0 sets power, 1 sets wire speed, 2 starts a bead, 3 ends it."""
        power, wire = self._asked[group]
        key = (group, self._power if power else 0.0, self._wire if wire else 0.0)
        if key not in self._blocks:
            values = self._values.at(self._power, self._wire)
            texts = (values.fill(name, self._templates[name]) for name in self._names[group])
            self._blocks[key] = [line for text in texts for line in text]
        return self._blocks[key]

    def _feed(self, share: float) -> str:
        """Feed word at a share of the process feed."""
        if share not in self._feeds:
            values = replace(self._values, feed_mm_min=self._values.feed_mm_min * share)
            self._feeds[share] = f" F{plain(values.printed('feed_mm_min'))}"
        return self._feeds[share]

    def _wait(self, wait_s: float) -> None:
        """Wait above the layer; the next travel comes down from there."""
        if pause := pause_blocks(self._values, self._templates, wait_s):
            self.lines += [f"G0 Z{self._safe_z}", *pause]
            self._position = None

    def _set(self, power: float, wire: float) -> None:
        """Set beam and running wire to shares of the layer's; write no block where the difference is under the control's
        step."""
        if power != self._power:
            before, self._power = self._switches(0), power
            self.lines += [] if before == (now := self._switches(0)) else now
        if wire != self._wire:
            before, self._wire = self._switches(1), wire
            self.lines += [] if before == (now := self._switches(1)) else now

    def _deposit(
        self, start: Floats, end: Floats, motions: Sequence[str], power: Floats, wire: Floats, feed: Floats
    ) -> None:
        """Travel to `start`, beam and wire on, `motions` each at its power, wire and feed, wire and beam off at `end`."""
        if not any(motions):
            return  # all motions lie within one rounding: the beam would stand still
        self._travel(start)
        self._wire = float(wire[0])
        self._set(float(power[0]), self._wire)
        self.lines += self._switches(2)
        steps = (np.diff(power) != 0.0) | (np.diff(wire) != 0.0) | (np.diff(feed) != 0.0)
        changes = [0, *(np.flatnonzero(steps) + 1).tolist(), len(motions)]
        said = ""
        for a, b in itertools.pairwise(changes):
            self._set(float(power[a]), float(wire[a]))
            blocks = [line for text in motions[a:b] if text for line in text.split("\n")]
            own = self._feed(float(feed[a]))
            if blocks and own != said:
                # The feed goes before the comment that may end a block.
                code, mark, note = blocks[0].partition(" ;")
                blocks[0], said = code + own + mark + note, own
            self.lines += blocks
        self.lines += self._switches(3)
        self._position = end

    def _travel(self, to: Floats) -> None:
        x_y = f"G0 X{self._form.value(to[0])} Y{self._form.value(to[1])}"
        if self._position is None:
            self.lines += [x_y, f"G0 Z{self._z}"]
        elif float(np.hypot(*(to - self._position))) > self._near_mm:
            self.lines += [f"G0 Z{self._safe_z}", x_y, f"G0 Z{self._z}"]
        elif (to != self._position).any():
            self.lines.append(x_y)


def preheat_passes(plan: ScanColumns) -> Ints:
    """Return the preheating passes (L,) before each layer of a plan; zeros for a plan without preheating."""
    none = np.zeros(len(plan.heights), np.int64)
    return np.asarray(getattr(plan, "metrics", {}).get("preheat_passes", none), np.int64)


def preheat_blocks(
    post: Post, k: int, passes: int, values: ProcessValues, after: ProcessValues, entry: Sequence[str]
) -> list[str]:
    """Return the blocks of the scan before layer `k`: `entry` are its modes, `values` have full power, `after` follow it.

    Inside the layer's subprogram the scan takes the focus back last, because that block tells where the scan ends.
    """
    plan, config, form, templates = post.plan, post.config, post.form, post.templates
    bottom_mm = values.height_mm
    settings = config.preheat
    assert plan.sections is not None
    region = scanned(list(plan.sections), k, bottom_mm, config, getattr(plan, "under", None)).region
    share = settings.current_ma / config.process.current_ma
    low = values.at(share, 1.0)
    wide, sharp = replace(low, defocus=settings.defocus), replace(values, defocus=0.0)

    def filled(name: str, given: ProcessValues) -> list[str]:
        return given.fill(name, templates[name])

    on, off = filled("beam_on", low), filled("beam_off", low)
    lines = [
        comment(f"PREHEATING BEFORE LAYER {k + 1}, {passes} PASSES"),
        *entry,
        *filled("wire_stop", low), *off, *filled("set_focus", wide), *filled("set_beam", low),
        f"G0 Z{form.value(safe_end_mm(bottom_mm, config))}",
    ]  # fmt: skip
    feed = f" F{plain(60.0 * settings.speed_mm_s)}"
    for number in range(passes):
        lines.append(comment(f"PASS {number + 1}"))
        ways, joined = pass_lines(region, config, number)
        for n, way in enumerate(form.rounded(ways)):
            if joined[n]:
                lines.append(f"G1 X{form.value(way[0])} Y{form.value(way[1])}")
            else:
                lines += off if n else []
                lines += [f"G0 X{form.value(way[0])} Y{form.value(way[1])}", *on]
            lines.append(f"G1 X{form.value(way[2])} Y{form.value(way[3])}{'' if joined[n] else feed}")
        lines += off if len(ways) else []
    ends = [*filled("set_beam", after), *filled("set_focus", sharp)]
    soak = pause_blocks(values, templates, settings.soak_s)
    return [*lines, *ends, *soak] if settings.scan_in == "own" else [*lines, *soak, *ends]
