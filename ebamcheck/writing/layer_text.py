"""Blocks of one layer, alike for every control: travel, beam and wire, and the motions of each track."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ebamcheck.nc.conventions import comment, plain
from ebamcheck.nc.inputs import Interpass
from ebamcheck.nc.recorder import Templates
from ebamcheck.nc.templates import ProcessValues, process_values
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.feed_along import feed_shares, wire_at
from ebamcheck.writing.bead_power import layer_power
from ebamcheck.writing.blocks import BlockFormat
from ebamcheck.writing.events import NEAR_SPACINGS
from ebamcheck.writing.safe_states import entry_blocks
from ebamcheck.writing.segments import CIRCULAR, CUBIC, STRAIGHT
from ebamcheck.writing.tracks import Toolpath


def motion_text(path: Toolpath, form: BlockFormat, cubics: Sequence[str]) -> list[str]:
    """Text of every segment (N,): G1, G2, G3, and what `cubics` holds for the cubic ones, in their order.

    An entry of `cubics` may be several lines, or empty where another carries its motion.
    """
    text = np.empty(path.kind.size, dtype=object)
    straight, round_ = path.kind == STRAIGHT, path.kind == CIRCULAR
    text[straight] = form.lines(path.end[straight])
    text[round_] = form.arcs(path.segment_start[round_], path.end[round_], path.circles)
    text[path.kind == CUBIC] = cubics
    text[path.turn] += " ; TURN"
    text[path.goes_on] += " ; GOES ON"
    result: list[str] = text.tolist()
    return result


def layer_blocks(
    path: Toolpath,
    k: int,
    motions: Sequence[str],
    config: Config,
    form: BlockFormat,
    templates: Templates,
    heat: Interpass,
    entry: Sequence[str],
    around: tuple[Sequence[str], Sequence[str]] = ((), ()),
) -> list[str]:
    """Blocks of layer `k`: contour rings and islands, each track between beam on and beam off, and the waits.

    `entry` are the modes that hold in it. It begins with them and with its own power, so that the control can enter the
    program there. The blocks of `around` come before its first way and after its last.
    """
    values = process_values(config, k + 1, float(path.z[k]), float(path.thickness[k]))
    share = float(heat.power_share[k])
    layer = _Layer(config, form, float(path.z[k]), values, templates, share)
    layer.rise()
    if config.machine.optional_stop:
        layer.lines.append("M1")
    wire = path.width / config.process.bead_metal_mm
    feed = feed_shares(wire * values.wire_mm_s, config, share)
    wire = wire_at(wire * values.wire_mm_s, feed, config) / values.wire_mm_s if (feed != 1.0).any() else wire
    first, last = path.track_starts[path.layer_starts[k : k + 2]].tolist()
    power = layer_power(path, k, slice(first, last), share, config)
    island, entered = -1, False
    for t in range(int(path.layer_starts[k]), int(path.layer_starts[k + 1])):
        if path.ring[t] >= 0:
            layer.wait(float(heat.ring_wait_s[k]) if t > path.layer_starts[k] else 0.0)
            layer.lines.append(f"; RING {path.ring[t]}")
        elif path.island[t] != island:
            island = int(path.island[t])
            layer.wait(float(heat.island_wait_s[island]))
            layer.lines.append(f"; ISLAND {island}")
            entered = False
        a, b = int(path.track_starts[t]), int(path.track_starts[t + 1])
        if b > a:
            if path.island[t] >= 0:
                layer.wait(float(heat.inner_wait_s[island]) if entered else 0.0)
                entered = True
            layer.deposit(
                path.start[t],
                path.end[b - 1],
                motions[a:b],
                power[a - first : b - first],
                wire[a:b],
                feed[a:b],
            )
    layer.rise()
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
    """Blocks that wait for a time; none for no time."""
    if wait_s <= 0.0:
        return []
    return replace(values, layer_pause_s=wait_s).fill("layer_pause", templates["layer_pause"])


class _Layer:
    """Blocks of one layer, and where the tool is while they are written."""

    def __init__(
        self,
        config: Config,
        form: BlockFormat,
        z_mm: float,
        values: ProcessValues,
        templates: Templates,
        power: float,
    ) -> None:
        self.lines: list[str] = []
        self._near_mm = NEAR_SPACINGS * config.process.hatch_spacing_mm
        self._form = form
        self._z, self._safe_z = form.value(z_mm), form.value(z_mm + config.machine.safe_height_mm)
        ends = ("wire_stop", "wire_retract", "beam_off")
        self._names = (
            ("set_power",),
            ("set_wire",),
            ("beam_on", "wire_start"),
            ends if values.wire_retract_mm > 0.0 else (ends[0], ends[2]),
        )
        self._values, self._templates = values, templates
        self._values_at: dict[tuple[float, float], ProcessValues] = {}
        self._blocks: dict[tuple[int, float, float], list[str]] = {}
        self._feeds: dict[float, str] = {}
        self._power, self._wire = power, 1.0
        self._position: Floats | None = None

    def _switches(self, group: int) -> list[str]:
        """Blocks of the moment: those that set power (0) or wire speed (1), or those before (2) and after a bead (3)."""
        now = (self._power, self._wire)
        found = self._blocks.get((group, *now))
        if found is None:
            if now not in self._values_at:
                self._values_at[now] = self._values.at(*now)
            values = self._values_at[now]
            found = [line for name in self._names[group] for line in values.fill(name, self._templates[name])]
            self._blocks[group, *now] = found
        return found

    def _feed(self, share: float) -> str:
        """Word of the feed at a share of that of the process."""
        if share not in self._feeds:
            values = replace(self._values, feed_mm_min=self._values.feed_mm_min * share)
            self._feeds[share] = f" F{plain(values.printed('feed_mm_min'))}"
        return self._feeds[share]

    def rise(self) -> None:
        """Go to the safe height, with the beam off."""
        self.lines.append(f"G0 Z{self._safe_z}")

    def wait(self, wait_s: float) -> None:
        """Wait above the layer; the next travel comes down from there."""
        pause = pause_blocks(self._values, self._templates, wait_s)
        if pause:
            self.rise()
            self.lines += pause
            self._position = None

    def set_power(self, share: float) -> None:
        """Set the beam to a share of its power."""
        if share != self._power:
            before = self._switches(0)
            self._power = share
            self.lines += _changed(before, self._switches(0))

    def set_wire(self, share: float) -> None:
        """Set the running wire to a share of the speed of the layer."""
        if share != self._wire:
            before = self._switches(1)
            self._wire = share
            self.lines += _changed(before, self._switches(1))

    def deposit(
        self, start: Floats, end: Floats, motions: Sequence[str], power: Floats, wire: Floats, feed: Floats
    ) -> None:
        """Travel to `start`, beam and wire on, `motions` each at its power, wire and feed, wire and beam off at `end`."""
        if not any(motions):
            return  # all of it lies within a rounding: the beam would stand
        self._travel(start)
        self._wire = float(wire[0])
        self.set_power(float(power[0]))
        self.lines += self._switches(2)
        steps = (np.diff(power) != 0.0) | (np.diff(wire) != 0.0) | (np.diff(feed) != 0.0)
        changes = [0, *(np.flatnonzero(steps) + 1).tolist(), len(motions)]
        said = ""
        for a, b in itertools.pairwise(changes):
            self.set_power(float(power[a]))
            self.set_wire(float(wire[a]))
            blocks = [line for text in motions[a:b] if text for line in text.split("\n")]
            own = self._feed(float(feed[a]))
            self.lines += [_with_feed(blocks[0], own if own != said else ""), *blocks[1:]] if blocks else []
            said = own if blocks else said
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


def _changed(before: list[str], now: list[str]) -> list[str]:
    """Blocks of values that are to be set; none where the control has no smaller step than what they differ by."""
    return [] if now == before else now


def _with_feed(block: str, feed: str) -> str:
    """Put the feed into a block, before the comment that it may end with."""
    code, mark, note = block.partition(" ;")
    return code + feed + mark + note
