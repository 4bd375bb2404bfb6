"""Heights of the layers that are still to come: uniform, listed, or by cusp height, from what stands to the part's top.

A plan is made anew from every measured height. Every level face of the part is a border of layers, where the limits of the
bead allow it; what they do not allow is said in words before it happens. The cusp of a layer is its height times the cosine
of the surface's slope (Dolenc and Makela 1994), so that steep walls take thick layers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.heat.melting import least_power_share
from ebamcheck.live.layer_feed import farthest_mm
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import nominal_wire_speed_mm_s

Mode = Literal["uniform", "listed", "adaptive"]

LEVEL = 1e-9
"""One less the cosine of the slope of a facet that is level: the rounding of its normal."""

LEVEL_MM = 1e-6
"""Faces nearer than this lie at one height."""

LEAST_FACE_MM2 = 1.0
"""Level faces smaller than this, in all, are tips and chamfers of the mesh: no layer is bent to them."""

MET = 0.5
"""Share of the least layer by which a height may lie off a face and count as it: no layer can mend less."""

STEPS_A_LAYER = 16
"""Steps in the least layer at which slopes are known."""

ROUNDING = 1e-9


@dataclass(frozen=True)
class Limits:
    """Least and greatest height of a layer, and the usual one, mm; and what sets the first two."""

    least_mm: float
    most_mm: float
    usual_mm: float
    why: tuple[str, str] = ("", "")


def bead_limits(config: Config) -> Limits:
    """Limits of the bead: the process window, the wire feed, and the power that melts the wire."""
    process = config.process
    per_mm = nominal_wire_speed_mm_s(config, 1.0)
    bead = process.bead_height_mm
    low = [
        (process.layer_over_bead[0] * bead, "process.layer_over_bead"),
        (process.wire_speed_min_mm_s / per_mm, "process.wire_speed_min_mm_s"),
    ]
    high = [
        (process.layer_over_bead[1] * bead, "process.layer_over_bead"),
        (process.wire_speed_max_mm_s / per_mm, "process.wire_speed_max_mm_s"),
        (_melted_mm(config, process.layer_over_bead[1] * bead), "the power of the beam"),
    ]
    least, most = max(low), min(high)
    if least[0] > most[0]:
        raise SettingsError(
            f"no layer height is within the process: at least {least[0]:.3g} mm by {least[1]}, at most {most[0]:.3g} mm by {most[1]}"
        )
    usual = min(max(config.layer_height_mm, least[0]), most[0])
    return Limits(least[0], most[0], usual, (least[1], most[1]))


def feed_limits(config: Config, limits: Limits) -> Limits:
    """Limits where the feed follows, too: those of the bead alone, as far as a feed is there for them."""
    process = config.process
    low, high = (share * process.bead_height_mm for share in process.layer_over_bead)
    least = min(farthest_mm(config, limits.usual_mm, low), limits.least_mm)
    most = max(farthest_mm(config, limits.usual_mm, high), limits.most_mm)
    bead, feed = "process.layer_over_bead", "wire, beam and every feed"
    why = (
        bead if least <= low * (1.0 + ROUNDING) else feed,
        bead if most >= high * (1.0 - ROUNDING) else feed,
    )
    return Limits(least, most, limits.usual_mm, why)


def _melted_mm(config: Config, most_mm: float) -> float:
    """Greatest height up to `most_mm` of which the full power melts the wire."""
    if least_power_share(config, most_mm) <= 1.0:
        return most_mm
    low, high = 0.0, most_mm
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if least_power_share(config, middle) <= 1.0 else (low, middle)
    return low


@dataclass(frozen=True, eq=False)
class Slopes:
    """Level faces and slopes of a part.

    Parameters
    ----------
    faces_mm
        (F,) Z over the part's lowest point of its level faces, rising; the bottom is none, the top is the last.
    step_mm
        Height of the cells.
    level
        (n,) greatest cosine of the slope in each cell from below, 0 for a vertical wall; level faces do not count.
    """

    faces_mm: Floats
    step_mm: float
    level: Floats

    @classmethod
    def of(cls, part: Part, step_mm: float) -> Slopes:
        """Find them in a mesh."""
        corners = part.vertices[part.faces]
        z = corners[:, :, 2] - part.bounds[0, 2]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        twice = np.linalg.norm(normal, axis=1)
        cosine = np.abs(normal[:, 2]) / np.where(twice > 0.0, twice, 1.0)
        height = float(part.size[2])
        flat = (cosine >= 1.0 - LEVEL) & (np.ptp(z, axis=1) <= LEVEL_MM)
        found = _grouped(z[flat].mean(axis=1), 0.5 * twice[flat]) if flat.any() else np.zeros(0)
        faces = found[(found > LEVEL_MM) & (found < height - LEVEL_MM)]
        count = max(1, math.ceil(height / step_mm - ROUNDING))
        level = np.zeros(count)
        low, high = z[~flat].min(axis=1), z[~flat].max(axis=1)
        first = np.clip((low / step_mm).astype(np.int64), 0, count - 1)
        last = np.clip(np.ceil(high / step_mm).astype(np.int64) - 1, first, count - 1)
        of_cell = _greatest(first, last, cosine[~flat], count)
        np.maximum(level, of_cell, out=level)
        return cls(np.append(faces, height), step_mm, level)

    @property
    def top_mm(self) -> float:
        """Z of the part's top."""
        return float(self.faces_mm[-1])

    def steepest(self, low_mm: float, high_mm: float) -> float:
        """Greatest cosine of the slope between two heights."""
        a = min(max(int(low_mm / self.step_mm + ROUNDING), 0), len(self.level) - 1)
        b = min(max(math.ceil(high_mm / self.step_mm - ROUNDING), a + 1), len(self.level))
        return float(self.level[a:b].max())


def _grouped(z: Floats, area: Floats) -> Floats:
    """Heights, rising, at which level facets have an area worth a layer."""
    order = np.argsort(z)
    z, area = z[order], area[order]
    first = np.flatnonzero(np.diff(z, prepend=-np.inf) > LEVEL_MM)
    return np.asarray(z[first][np.add.reduceat(area, first) >= LEAST_FACE_MM2], np.float64)


def _greatest(first: np.ndarray, last: np.ndarray, value: Floats, count: int) -> Floats:
    """Greatest value over the ranges first .. last (n,) that hold each of some cells: largest values are written last."""
    result = np.zeros(count)
    order = np.argsort(value, kind="stable")
    first, last, value = first[order], last[order], value[order]
    # Ranges of one cell are the most, and done at once; longer ones are few in a mesh that is finer than its layers.
    np.maximum.at(result, first, value)
    np.maximum.at(result, last, value)
    long = np.flatnonzero(last - first > 1)
    keys, at = np.unique(np.stack([first[long], last[long]], axis=1), axis=0, return_inverse=True)
    greatest = np.zeros(len(keys))
    np.maximum.at(greatest, at.reshape(-1), value[long])
    for (a, b), v in zip(keys.tolist(), greatest.tolist(), strict=True):
        np.maximum(result[a : b + 1], v, out=result[a : b + 1])
    return result


@dataclass(frozen=True, eq=False)
class HeightPlan:
    """Layers from what stands to the part's top.

    Parameters
    ----------
    base_mm
        Z of what stands.
    tops_mm, cusp_mm
        (L,) Z of each layer's top, and its cusp.
    said
        What cannot be met, one line each; empty: everything is met.
    """

    base_mm: float
    tops_mm: Floats
    cusp_mm: Floats
    said: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of layers."""
        return len(self.tops_mm)

    @property
    def thickness_mm(self) -> Floats:
        """(L,) height of each layer."""
        return np.diff(self.tops_mm, prepend=self.base_mm)


@dataclass(frozen=True, eq=False)
class HeightRule:
    """How heights are chosen.

    Parameters
    ----------
    mode
        ``uniform``: the usual height, changed as little as the faces ask for; ``listed``: given tops; ``adaptive``: as thick
        as the cusp allows.
    cusp_mm
        Greatest cusp of ``adaptive``.
    listed_mm
        Tops of ``listed``, rising.
    by_feed
        Limits where the feed follows, too, which is used where nothing within `limits` fits; None: the feed stays.
    """

    slopes: Slopes
    limits: Limits
    mode: Mode = "uniform"
    cusp_mm: float = 0.5
    listed_mm: tuple[float, ...] = ()
    by_feed: Limits | None = None

    @property
    def outer(self) -> Limits:
        """Limits beyond which no layer can be laid."""
        return self.by_feed or self.limits

    @property
    def met_mm(self) -> float:
        """Distance within which a height counts as met."""
        return MET * self.limits.least_mm

    def plan(self, base_mm: float) -> HeightPlan:
        """Plan the layers on what stands.

        Examples
        --------
        >>> slopes = Slopes(np.array([4.0, 10.0]), 0.1, np.zeros(100))
        >>> HeightRule(slopes, Limits(1.0, 2.0, 1.5)).plan(0.0).tops_mm.tolist()
        [1.3333333333333333, 2.6666666666666665, 4.0, 5.5, 7.0, 8.5, 10.0]
        """
        stations, said = self._stations(base_mm)
        thickness: list[float] = []
        low = base_mm
        for high in stations:
            made, problem = self._between(low, high)
            thickness += made
            said += [problem] if problem else []
            low += sum(made)
            low = high if abs(low - high) <= LEVEL_MM else low
        tops = base_mm + np.cumsum(thickness) if thickness else np.zeros(0)
        # Sums round; faces that are met are met exactly.
        for high in stations:
            near = np.argmin(np.abs(tops - high))
            if abs(tops[near] - high) <= LEVEL_MM:
                tops[near] = high
        steps = np.diff(tops, prepend=base_mm)
        cusp = np.array([t * self.slopes.steepest(top - t, top) for t, top in zip(steps, tops, strict=True)])
        return HeightPlan(base_mm, tops, cusp, tuple(said))

    def _stations(self, base_mm: float) -> tuple[list[float], list[str]]:
        """Heights that are to be met exactly, rising up to the top, and which cannot."""
        slopes, limits = self.slopes, self.outer
        top = slopes.top_mm
        if top - base_mm <= self.met_mm:
            over = base_mm - top
            late = over > self.met_mm
            return [], [
                f"what stands is {over:.3f} mm over the part's top: it is to be machined off"
            ] if late else []
        wanted = sorted({*self.listed_mm, top} if self.mode == "listed" else slopes.faces_mm.tolist())
        said: list[str] = []
        kept: list[float] = []
        low = base_mm
        for z in wanted:
            if z <= base_mm + (LEVEL_MM if z < base_mm else self.met_mm):
                continue
            if z - low < limits.least_mm * (1.0 - ROUNDING):
                if z != top:
                    said.append(
                        f"the face at Z {z:.3f} is not met: {z - low:.3f} mm over {low:.3f} is less than the least layer, "
                        f"{limits.least_mm:.3f} mm by {limits.why[0]}"
                    )
                    continue
                while kept and z - (kept[-2] if len(kept) > 1 else base_mm) < limits.least_mm:
                    kept.pop()
                if kept:
                    said.append(
                        f"the face at Z {kept[-1]:.3f} is not met: the top lies {z - kept[-1]:.3f} mm over it"
                    )
                    kept.pop()
            kept.append(z)
            low = z
        return kept, said

    def _between(self, low_mm: float, high_mm: float) -> tuple[list[float], str]:
        """Layers that fill the way from one height to the next, and what cannot be met."""
        gap, limits, outer = high_mm - low_mm, self.limits, self.outer
        if self.mode == "adaptive":
            wanted = self._by_cusp(low_mm, high_mm)
        elif self.mode == "listed":
            wanted = [gap]
        else:
            wanted = [limits.usual_mm] * max(1, round(gap / limits.usual_mm))
        scaled = np.array(wanted) * (gap / sum(wanted))
        if self._within(scaled, outer if self.mode != "uniform" else limits):
            return scaled.tolist(), self._said_of_cusp(scaled, low_mm)
        counts = sorted(range(1, math.ceil(gap / outer.least_mm) + 1), key=lambda n: abs(n - len(wanted)))
        # The feed stays where it can.
        for within in (limits, outer):
            for count in counts:
                even = np.full(count, gap / count)
                if self._within(even, within):
                    said = ""
                    if self.mode == "listed" and count > 1:
                        said = f"the step of {gap:.3f} mm to Z {high_mm:.3f} is laid in {count} layers: the greatest is {within.most_mm:.3f} mm"
                    return even.tolist(), said or self._said_of_cusp(even, low_mm)
        # What cannot be laid is not planned: the nearest that can misses the height by half the least layer at most.
        fewest = max(1, math.floor(gap / outer.most_mm))
        count, thick = min(
            ((n, min(max(gap / n, outer.least_mm), outer.most_mm)) for n in (fewest, fewest + 1)),
            key=lambda planned: abs(planned[0] * planned[1] - gap),
        )
        off_mm = count * thick - gap
        said = (
            f"from Z {low_mm:.3f} to {high_mm:.3f} mm no number of layers is within {outer.least_mm:.3f} mm "
            f"({outer.why[0]}) .. {outer.most_mm:.3f} mm ({outer.why[1]}): it is planned {abs(off_mm):.3f} mm too "
            f"{'high' if off_mm > 0.0 else 'low'}"
        )
        return [thick] * count, said

    def _within(self, thickness: Floats, limits: Limits) -> bool:
        low, high = limits.least_mm * (1.0 - ROUNDING), limits.most_mm * (1.0 + ROUNDING)
        return bool(((thickness >= low) & (thickness <= high)).all())

    def _by_cusp(self, low_mm: float, high_mm: float) -> list[float]:
        """Layers from below, each as thick as the cusp allows; together at least the way."""
        made, z, least_mm = [], low_mm, self.outer.least_mm
        while z < high_mm - ROUNDING:
            thick = self.limits.most_mm
            while thick > least_mm:
                steep = self.slopes.steepest(z, min(z + thick, high_mm))
                if thick * steep <= self.cusp_mm * (1.0 + ROUNDING):
                    break
                thick = max(least_mm, min(self.cusp_mm / steep, thick - self.slopes.step_mm))
            made.append(thick)
            z += thick
        return made

    def _said_of_cusp(self, thickness: Floats, low_mm: float) -> str:
        if self.mode != "adaptive":
            return ""
        tops = low_mm + np.cumsum(thickness)
        cusp = [t * self.slopes.steepest(top - t, top) for t, top in zip(thickness, tops, strict=True)]
        k = int(np.argmax(cusp))
        if cusp[k] <= self.cusp_mm * (1.0 + 1e-6):
            return ""
        return (
            f"the cusp of the layer up to Z {tops[k]:.3f} is {cusp[k]:.3f} mm, over {self.cusp_mm:g} mm: thinner layers than "
            f"{self.outer.least_mm:.3f} mm ({self.outer.why[0]}) would be needed"
        )


def height_rule(
    part: Part, config: Config, mode: Mode = "uniform", cusp_mm: float = 0.5, listed_mm: Sequence[float] = ()
) -> HeightRule:
    """Rule of a part and its process.

    Raises
    ------
    SettingsError
        If the process leaves no height, the cusp is not positive, or listed heights do not rise.
    """
    if not (math.isfinite(cusp_mm) and cusp_mm > 0.0):
        raise SettingsError(f"cusp {cusp_mm} mm: give a positive number of millimetres")
    listed = tuple(float(z) for z in listed_mm)
    if mode == "listed" and (
        not listed or not all(a < b for a, b in zip((0.0, *listed), listed, strict=False))
    ):
        raise SettingsError("listed heights must be positive and rise from layer to layer")
    limits = bead_limits(config)
    slopes = Slopes.of(part, limits.least_mm / STEPS_A_LAYER)
    return HeightRule(slopes, limits, mode, cusp_mm, listed, feed_limits(config, limits))
