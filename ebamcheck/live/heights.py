"""Heights of the layers that are still to come, from what stands to the part's top, and the feed at which one of a height is laid.

Level faces are borders of layers where the bead allows it; the cusp of a layer is its height times the cosine of the surface's
slope (Dolenc and Makela 1994). Wire goes with feed times height, v_wire A = v b h: within the limits of the wire the feed stays,
beyond them both change."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.heat.medium import least_power_share, melted_mm3_s
from ebamcheck.kernels import Floats
from ebamcheck.mesh.part import Part
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import nominal_wire_speed_mm_s, speed_window, wire_area_mm2
from ebamcheck.writing.wire import MOST_MENDED

Mode = Literal["uniform", "listed", "adaptive"]
LEVEL_MM = 1e-6  # faces nearer than this lie at one height
ROUNDING = 1e-9
# Least and greatest local height of a layer over its height, on a surface that was measured: a wire feed has several times that room
LOCAL = (1.0 - MOST_MENDED, 1.0 + MOST_MENDED)
CONTOURS = 1.25  # wire of a bead along a contour over that of the layer: it lays the rim, too


def speed_share(config: Config, thickness_mm: float, room: tuple[float, float] = (1.0, 1.0)) -> float | None:
    """Return the feed of a layer over that of the process: the nearest to 1 within every limit; None: there is none.

    The wire is to have `room` for the least and greatest metal along the beads over that of the layer's height.

    >>> speed_share(Config(), 1.7)
    1.0
    >>> speed_share(Config().changed(process={"wire_speed_max_mm_s": 30.0}), 1.7)
    0.8213
    """
    process = config.process
    wire = nominal_wire_speed_mm_s(config, thickness_mm)
    low, high = speed_window(config)
    low = max(low, process.wire_speed_min_mm_s / (wire * room[0]))
    high = min(high, process.wire_speed_max_mm_s / (wire * room[1]))
    metal_mm3_s = wire * wire_area_mm2(config)
    high = min(high, process.power_w / (metal_mm3_s * process.metal_energy_j_mm3[0]))
    low = max(low, process.power_w / (metal_mm3_s * process.metal_energy_j_mm3[1]))
    high = min(high, melted_mm3_s(config) / metal_mm3_s)
    if low > high:
        return None
    if low <= 1.0 <= high:
        return 1.0
    share = math.ceil(low * 1e4) / 1e4 if low > 1.0 else math.floor(high * 1e4) / 1e4
    return share if low <= share <= high else min(max(1.0, low), high)


def at_speed(config: Config, share: float) -> Config:
    """Return the settings of a layer that is laid at a share of the feed of the process."""
    process, names = config.process, ("travel_speed_mm_s", "wire_speed_mm_s")
    changes = {name: getattr(process, name) * share for name in names}
    return config if share == 1.0 else config.model_copy(update={"process": process.model_copy(update=changes)})


def at_layer_feed(config: Config, thickness_mm: float, mapped: bool = False, along: bool = True) -> Config:
    """Return the settings of a layer with its feed; that of the process where no feed is within every limit: the gates tell of it.

    The wire is left room for contours, and on a `mapped` surface for the local height: as much of it as a feed leaves, and where
    that is not all, the feed follows `along` the path, too."""
    least, most = LOCAL if mapped else (1.0, 1.0)
    parts = (1.0, 0.75, 0.5, 0.25, 0.0)
    found = (speed_share(config, thickness_mm, (least**part, (most * CONTOURS) ** part)) for part in parts)
    laid = at_speed(config, next((share for share in found if share is not None), 1.0))
    if not (mapped and along) or has_room(laid, thickness_mm):
        return laid
    return laid.model_copy(update={"process": laid.process.model_copy(update={"feed_along_path": True})})


def has_room(config: Config, thickness_mm: float) -> bool:
    """Whether the wire can follow the local height of a measured surface at the feed of the settings, along contours, too."""
    wire, process = nominal_wire_speed_mm_s(config, thickness_mm), config.process
    low, high = wire * LOCAL[0], wire * LOCAL[1] * CONTOURS
    return low >= process.wire_speed_min_mm_s and high <= process.wire_speed_max_mm_s


@dataclass(frozen=True)
class Limits:
    """Least and greatest height of a layer, and the usual one, mm; and what sets the first two."""

    least_mm: float
    most_mm: float
    usual_mm: float
    why: tuple[str, str] = ("", "")

    def hold(self, thickness_mm: Floats) -> bool:
        """Whether all of some heights are within them."""
        low, high = self.least_mm * (1.0 - ROUNDING), self.most_mm * (1.0 + ROUNDING)
        return bool(((thickness_mm >= low) & (thickness_mm <= high)).all())


def bead_limits(config: Config) -> Limits:
    """Limits of the bead: the process window, the wire feed, and the power that melts the wire."""
    process = config.process
    per_mm = nominal_wire_speed_mm_s(config, 1.0)
    lowest, highest = ((share * process.bead_height_mm, "process.layer_over_bead") for share in process.layer_over_bead)
    melted = _farthest(lambda mm: least_power_share(config, mm) <= 1.0, 0.0, highest[0], 60)
    slowest, fastest = (
        (getattr(process, name) / per_mm, f"process.{name}") for name in ("wire_speed_min_mm_s", "wire_speed_max_mm_s")
    )
    least, most = max(lowest, slowest), min(highest, fastest, (melted, "the power of the beam"))
    if least[0] > most[0]:
        bounds = f"at least {least[0]:.3g} mm by {least[1]}, at most {most[0]:.3g} mm by {most[1]}"
        raise SettingsError(f"no layer height is within the process: {bounds}")
    usual = min(max(config.layer_height_mm, least[0]), most[0])
    return Limits(least[0], most[0], usual, (least[1], most[1]))


def feed_limits(config: Config, limits: Limits) -> Limits:
    """Limits where the feed follows, too: those of the bead alone, as far as a feed is there for them."""
    process = config.process
    low, high = (share * process.bead_height_mm for share in process.layer_over_bead)
    least, most = (
        _farthest(lambda mm: speed_share(config, mm) is not None, limits.usual_mm, to_mm, 50) for to_mm in (low, high)
    )
    least, most = min(least, limits.least_mm), max(most, limits.most_mm)
    bead, feed = "process.layer_over_bead", "wire, beam and every feed"
    by_bead = least <= low * (1.0 + ROUNDING), most >= high * (1.0 - ROUNDING)
    return Limits(least, most, limits.usual_mm, (bead if by_bead[0] else feed, bead if by_bead[1] else feed))


def _farthest(holds: Callable[[float], bool], good_mm: float, to_mm: float, halvings: int) -> float:
    """Height nearest to `to_mm` that holds, on the way from one that does."""
    if holds(to_mm):
        return to_mm
    bad_mm = to_mm
    for _ in range(halvings):
        middle = 0.5 * (good_mm + bad_mm)
        good_mm, bad_mm = (middle, bad_mm) if holds(middle) else (good_mm, middle)
    return good_mm


@dataclass(frozen=True, eq=False)
class Slopes:
    """Level faces and slopes of a part."""

    faces_mm: Floats  # (F,) Z of its level faces over its lowest point, rising, the top the last
    step_mm: float
    level: (
        Floats  # (n,) greatest cosine of the slope in each step from below, 0 for a vertical wall, without level faces
    )

    @classmethod
    def of(cls, part: Part, step_mm: float) -> Slopes:
        """Find them in a mesh."""
        corners = part.vertices[part.faces]
        z = corners[:, :, 2] - part.bounds[0, 2]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        twice = np.linalg.norm(normal, axis=1)
        cosine = np.abs(normal[:, 2]) / np.where(twice > 0.0, twice, 1.0)
        height = float(part.size[2])
        flat = (cosine >= 1.0 - 1e-9) & (np.ptp(z, axis=1) <= LEVEL_MM)
        at = z[flat].mean(axis=1)
        order = np.argsort(at)
        begins = np.flatnonzero(np.diff(at[order], prepend=-np.inf) > LEVEL_MM)
        area_mm2 = np.add.reduceat(0.5 * twice[flat][order], begins) if begins.size else np.zeros(0)
        # Smaller level faces, in all, are tips and chamfers: no layer is bent to them.
        found = at[order][begins][area_mm2 >= 1.0]
        faces = found[(found > LEVEL_MM) & (found < height - LEVEL_MM)]
        count = max(1, math.ceil(height / step_mm - ROUNDING))
        low, high = z[~flat].min(axis=1), z[~flat].max(axis=1)
        first = np.clip((low / step_mm).astype(np.int64), 0, count - 1)
        last = np.clip(np.ceil(high / step_mm).astype(np.int64) - 1, first, count - 1)
        return cls(np.append(faces, height), step_mm, _greatest(first, last, cosine[~flat], count))

    @property
    def top_mm(self) -> float:
        """Z of the part's top."""
        return float(self.faces_mm[-1])

    def steepest(self, low_mm: float, high_mm: float) -> float:
        """Greatest cosine of the slope between two heights."""
        a = min(max(int(low_mm / self.step_mm + ROUNDING), 0), len(self.level) - 1)
        b = min(max(math.ceil(high_mm / self.step_mm - ROUNDING), a + 1), len(self.level))
        return float(self.level[a:b].max())

    def cusps(self, thickness_mm: Floats, tops_mm: Floats) -> Floats:
        """(L,) cusp of layers."""
        steps = zip(thickness_mm.tolist(), tops_mm.tolist(), strict=True)
        return np.array([step * self.steepest(top - step, top) for step, top in steps])


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
    """Layers from what stands to the part's top."""

    base_mm: float
    tops_mm: Floats  # (L,) Z of each layer's top
    cusp_mm: Floats
    said: tuple[str, ...] = ()  # what cannot be met, one line each

    def __len__(self) -> int:
        """Return the number of layers."""
        return len(self.tops_mm)

    @property
    def thickness_mm(self) -> Floats:
        """(L,) height of each layer."""
        return np.diff(self.tops_mm, prepend=self.base_mm)


@dataclass(frozen=True, eq=False)
class HeightRule:
    """How heights are chosen: the usual one, changed as little as faces ask for; ``listed`` tops; or ``adaptive``, as the cusp
    allows.

    `by_feed` are limits where the feed follows, too, which it does where nothing within `limits` fits; None: it stays.
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
        """Distance within which a height counts as met: no layer can mend less than half the least one."""
        return 0.5 * self.limits.least_mm

    def plan(self, base_mm: float) -> HeightPlan:
        """Plan the layers on what stands.

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
        return HeightPlan(base_mm, tops, self.slopes.cusps(np.diff(tops, prepend=base_mm), tops), tuple(said))

    def _stations(self, base_mm: float) -> tuple[list[float], list[str]]:
        """Heights that are to be met exactly, rising up to the top, and which cannot."""
        slopes, limits = self.slopes, self.outer
        top = slopes.top_mm
        if top - base_mm <= self.met_mm:
            said = [f"what stands is {base_mm - top:.3f} mm over the part's top: it is to be machined off"]
            return [], said if base_mm - top > self.met_mm else []
        wanted = sorted({*self.listed_mm, top} if self.mode == "listed" else slopes.faces_mm.tolist())
        said, kept, low = [], list[float](), base_mm
        for z in wanted:
            if z <= base_mm + (LEVEL_MM if z < base_mm else self.met_mm):
                continue
            if z - low < limits.least_mm * (1.0 - ROUNDING):
                if z != top:
                    least = f"less than the least layer, {limits.least_mm:.3f} mm by {limits.why[0]}"
                    said.append(f"the face at Z {z:.3f} is not met: {z - low:.3f} mm over {low:.3f} is {least}")
                    continue
                while kept and z - (kept[-2] if len(kept) > 1 else base_mm) < limits.least_mm:
                    kept.pop()
                if kept:
                    over = f"the top lies {z - kept[-1]:.3f} mm over it"
                    said.append(f"the face at Z {kept.pop():.3f} is not met: {over}")
            kept.append(z)
            low = z
        return kept, said

    def _between(self, low_mm: float, high_mm: float) -> tuple[list[float], str]:
        """Layers that fill the way from one height to the next, and what cannot be met."""
        gap, limits, outer = high_mm - low_mm, self.limits, self.outer
        wanted = [limits.usual_mm] * max(1, round(gap / limits.usual_mm))
        if self.mode != "uniform":
            wanted = [gap] if self.mode == "listed" else self._by_cusp(low_mm, high_mm)
        scaled = np.array(wanted) * (gap / sum(wanted))
        if (outer if self.mode != "uniform" else limits).hold(scaled):
            return scaled.tolist(), self._said_of_cusp(scaled, low_mm)
        counts = sorted(range(1, math.ceil(gap / outer.least_mm) + 1), key=lambda n: abs(n - len(wanted)))
        # The feed stays where it can.
        for within in (limits, outer):
            for count in counts:
                even = np.full(count, gap / count)
                if within.hold(even):
                    said = ""
                    if self.mode == "listed" and count > 1:
                        said = f"the step of {gap:.3f} mm to Z {high_mm:.3f} is laid in {count} layers: the greatest is {within.most_mm:.3f} mm"
                    return even.tolist(), said or self._said_of_cusp(even, low_mm)
        # What cannot be laid is not planned: the nearest that can misses the height by half the least layer at most.
        fewest = max(1, math.floor(gap / outer.most_mm))
        near = [(n, min(max(gap / n, outer.least_mm), outer.most_mm)) for n in (fewest, fewest + 1)]
        count, thick = min(near, key=lambda planned: abs(planned[0] * planned[1] - gap))
        off_mm = count * thick - gap
        bounds = f"{outer.least_mm:.3f} mm ({outer.why[0]}) .. {outer.most_mm:.3f} mm ({outer.why[1]})"
        said = f"from Z {low_mm:.3f} to {high_mm:.3f} mm no number of layers is within {bounds}"
        side = "high" if off_mm > 0.0 else "low"
        return [thick] * count, f"{said}: it is planned {abs(off_mm):.3f} mm too {side}"

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
        cusp = self.slopes.cusps(thickness, tops)
        k = int(np.argmax(cusp))
        if cusp[k] <= self.cusp_mm * (1.0 + 1e-6):
            return ""
        cusps = f"the cusp of the layer up to Z {tops[k]:.3f} is {cusp[k]:.3f} mm, over {self.cusp_mm:g} mm"
        least = f"{self.outer.least_mm:.3f} mm ({self.outer.why[0]})"
        return f"{cusps}: thinner layers than {least} would be needed"


def height_rule(
    part: Part, config: Config, mode: Mode = "uniform", cusp_mm: float = 0.5, listed_mm: Sequence[float] = ()
) -> HeightRule:
    """Rule of a part and its process; refused is a process that leaves no height, a cusp that is none, and heights that do not
    rise."""
    if not (math.isfinite(cusp_mm) and cusp_mm > 0.0):
        raise SettingsError(f"cusp {cusp_mm} mm: give a positive number of millimetres")
    listed = tuple(float(z) for z in listed_mm)
    rises = all(a < b for a, b in zip((0.0, *listed), listed, strict=False))
    if mode == "listed" and not (listed and rises):
        raise SettingsError("listed heights must be positive and rise from layer to layer")
    limits = bead_limits(config)
    slopes = Slopes.of(part, limits.least_mm / 16)
    return HeightRule(slopes, limits, mode, cusp_mm, listed, feed_limits(config, limits))
