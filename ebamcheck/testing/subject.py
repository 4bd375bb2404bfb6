"""What is under test, one slicer under one choice of settings, and what a check of it finds: one figure against one limit."""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.backend import BackendSettings, Slicer
from ebamcheck.comparison import compare
from ebamcheck.comparison.measure import FINEST_DEPTH_MM
from ebamcheck.errors import BackendFailed
from ebamcheck.geometry.rings import EPSILON
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.plugins.registry import Model
from ebamcheck.testing.solids import HOUSE_RULE, house_rule, sections, winding_rule

ROUNDING_STEPS = (
    64.0  # units in the last place of the largest coordinate by which the kit's own maps and sections may be off
)
LEVEL_SLOPE = 1e-9  # facets whose normal has less than this share in the plane count as level


class Subject:
    """A slicer, its settings, and the parts that it has cut already.

    Parameters
    ----------
    slicer, settings, models
        The slicer, or its class; its settings, by default its own; reference models that it is to cut, by name.

    Examples
    --------
    >>> from ebamcheck_models import CUBE
    >>> from ebamcheck_planecut import PlaneCut
    >>> subject = Subject(PlaneCut, {"overlaps": "keep"})
    >>> print(subject, subject.cut(CUBE.tessellate(0.1), [1.0, 3.0]).areas().tolist())
    planecut (overlaps=keep) [400.0, 400.0]
    """

    def __init__(
        self,
        slicer: Slicer | type[Slicer],
        settings: Mapping[str, Any] | None = None,
        models: Mapping[str, Model] | None = None,
    ) -> None:
        self.slicer: Slicer = slicer() if isinstance(slicer, type) else slicer
        self.given = dict(settings or {})
        self.models = dict(models or {})
        self._layers: dict[tuple[str, bytes], Layers] = {}
        self._differences: dict[tuple[str, bytes], Differences] = {}

    def __str__(self) -> str:
        chosen = ", ".join(f"{key}={value}" for key, value in self.given.items())
        return f"{self.slicer.name} ({chosen})" if chosen else self.slicer.name

    @property
    def settings(self) -> BackendSettings:
        """The settings, checked."""
        return self.slicer.Settings(**self.given)

    @property
    def half_open(self) -> bool:
        """Whether planes through vertices and faces are promised to follow z = h + 0."""
        return self.slicer.coplanar_rule == "half-open"

    def cut(self, part: Part, heights: ArrayLike) -> Layers:
        """Layers of a part at strictly increasing heights; the same question is asked once."""
        planes = np.asarray(heights, dtype=np.float64).reshape(-1)
        key = (part.sha256, planes.tobytes())
        if key not in self._layers:
            self._layers[key] = self._cut(part, planes)
        return self._layers[key]

    def cut_unless_refused(self, check: str, part: Part, heights: ArrayLike, found: list[Figure]) -> Layers | None:
        """Layers of a part that may be refused, which is then told among the figures `found`: it is no violation."""
        try:
            return self.cut(part, heights)
        except BackendFailed as refusal:
            found.append(truth(check, part.name, True, f"refused: {refusal}"))
            return None

    def _cut(self, part: Part, planes: NDArray[np.float64]) -> Layers:
        """Cut a part; what the slicer raises tells part, settings, height and place."""
        try:
            with self.slicer.prepare(part, self.settings) as prepared:
                return prepared.slice(planes)
        except BackendFailed:
            raise
        except Exception as error:
            raise Raised(self, part, planes, error) from error

    def failing_height(self, part: Part, planes: NDArray[np.float64]) -> float | None:
        """The lowest of some heights at which the slicer raises by itself; None where it takes several."""
        for height in planes.tolist():
            try:
                with self.slicer.prepare(part, self.settings) as prepared:
                    prepared.slice(np.array([height]))
            except Exception:
                return float(height)
        return None

    def bound_mm(self, part: Part) -> float:
        """The declared bound for a part."""
        return float(self.slicer.error_bound_mm(part, self.settings))

    def promise_mm(self, part: Part) -> float:
        """What a section may be off: the bound, the height bound over the flattest slope, and our rounding."""
        height_mm = float(self.slicer.height_bound_mm(part, self.settings))
        return self.bound_mm(part) + height_mm * flattest_reach(part) + rounding_mm(part)

    def limit_mm(self, part: Part) -> float:
        """The promise, and how finely depths are measured."""
        return self.promise_mm(part) + FINEST_DEPTH_MM

    def differences(self, part: Part, heights: ArrayLike) -> Differences:
        """Differences of a part's layers from its exact sections; each is measured once."""
        planes = np.asarray(heights, dtype=np.float64).reshape(-1)
        key = (part.sha256, planes.tobytes())
        if key not in self._differences:
            found = self.cut(part, planes)
            rule = winding_rule(self.inside_rule(found)) or house_rule
            self._differences[key] = differences(sections(part, planes, rule), found, self.promise_mm(part))
        return self._differences[key]

    def inside_rule(self, layers: Layers) -> str:
        """The rule in force: settings may change what the class declares, and then say so in their layers."""
        return str(layers.settings.get("inside_rule", self.slicer.inside_rule or HOUSE_RULE))


class Raised(Exception):
    """Something that a slicer raised, with what it was doing; `model` names the part that it was cutting."""

    def __init__(self, subject: Subject, part: Part, planes: NDArray[np.float64], error: Exception) -> None:
        self.model = part.name
        height, where = subject.failing_height(part, planes), "no heights"
        if height is not None:
            where = f"z = {height:.9g} mm"
        elif len(planes):
            where = f"one of {len(planes)} heights from {planes.min():.9g} to {planes.max():.9g} mm"
        last = [*traceback.extract_tb(error.__traceback__)][-1:]
        code = "".join(f", raised in {f.name} ({Path(f.filename).name}:{f.lineno})" for f in last)
        chosen = subject.settings.model_dump()
        settings = ", ".join(f"{key}={value}" for key, value in chosen.items()) or "none"
        low, high = part.bounds.round(3).tolist()
        text = " ".join(str(error).split())
        super().__init__(
            f"it raised {type(error).__name__}: {text} at {where} of {part.name!r} (box {low} to {high} mm, settings: "
            f"{settings}){code}"
        )


def rounding_mm(part: Part) -> float:
    """What our own arithmetic may be off at the part's coordinates, mm."""
    return ROUNDING_STEPS * EPSILON * float(np.abs(part.bounds).max())


def flattest_reach(part: Part) -> float:
    """Farthest that a contour moves where a plane moves by one: cotangent of the flattest slope that is cut."""
    a, b, c = np.moveaxis(part.triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    flat = np.hypot(normal[:, 0], normal[:, 1])
    sloped = flat > LEVEL_SLOPE * np.linalg.norm(normal, axis=1)
    return float((np.abs(normal[sloped, 2]) / flat[sloped]).max(initial=0.0))


def generic_heights(part: Part, count: int) -> NDArray[np.float64]:
    """Spread heights over a part, each well between two levels at which it has vertices."""
    levels = np.unique(part.vertices[:, 2])
    low, high = levels[0], levels[-1]
    wanted = low + (high - low) * (np.arange(count) + 0.381966) / count
    at = np.clip(np.searchsorted(levels, wanted, side="right"), 1, len(levels) - 1)
    below, above = levels[at - 1], levels[at]
    margin = 0.15 * (above - below)
    return np.unique(np.clip(wanted, below + margin, above - margin))


class Differences(NamedTuple):
    """How layers differ from exact sections; one entry a layer."""

    # Deepest point of the symmetric difference, measured from the exact contours
    depth_mm: NDArray[np.float64]
    # Whether rings and holes agree once features thinner than twice the limit are set aside
    topology_agrees: NDArray[np.bool_]
    places: list[str]  # height of the layer, and where its deepest point lies

    def depth_figures(self, check: str, model: str, limit_mm: float) -> list[Figure]:
        """How deep they differ, one figure a layer."""
        rows = enumerate(zip(self.depth_mm.tolist(), self.places, strict=True))
        return [Figure(check, model, k, deep, limit_mm, f"depth, mm, at {at}") for k, (deep, at) in rows]

    def topology_figures(self, check: str, model: str) -> list[Figure]:
        """Whether rings and holes agree, one figure a layer."""
        rows = enumerate(zip(self.topology_agrees.tolist(), self.places, strict=True))
        return [truth(check, model, same, f"other rings or holes at {at}", k) for k, (same, at) in rows]


def differences(
    reference: Layers, found: Layers, limit_mm: float, reference_exact: bool = True, found_exact: bool = False
) -> Differences:
    """Differences of layers from others at the same heights, whichever part they are of."""
    a, b = reference_exact, found_exact
    table = compare(reference, found, tolerance_mm=limit_mm, exact_a=a, exact_b=b, check_part=False)
    depth = table["depth_mm"].to_numpy(dtype=np.float64)
    rows = table[["height_mm", "depth_x_mm", "depth_y_mm", "depth_mm"]].to_numpy(np.float64).tolist()
    places = [f"z = {z:.9g} mm" + (f", x = {x:.6g}, y = {y:.6g}" if deep > 0.0 else "") for z, x, y, deep in rows]
    return Differences(depth, table["topology_agrees"].to_numpy(dtype=np.bool_), places)


# -- figures ---------------------------------------------------------------------------------------

NO_LAYER = -1  # layer of a figure that is about no layer in particular


@dataclass(frozen=True)
class Figure:
    """One figure of one check; it is a violation where the value is over the limit (or no number).

    Parameters
    ----------
    check, model, layer
        Name of the check, what was cut or looked at, and index of the layer, :data:`NO_LAYER` for none in particular.
    value, limit, text
        Figure and limit in the unit that the text names, which says what the value is.

    Examples
    --------
    >>> print(Figure("bound", "cube", 3, 0.02, 0.01, "mm off the exact section"))
    bound: cube, layer 4: 0.02 over 0.01: mm off the exact section
    """

    check: str
    model: str
    layer: int
    value: float
    limit: float
    text: str = ""

    @property
    def violated(self) -> bool:
        """Whether the value is over the limit."""
        return not self.value <= self.limit

    def __str__(self) -> str:
        where = f", layer {self.layer + 1}" if self.layer != NO_LAYER else ""
        return f"{self.check}: {self.model}{where}: {self.value:.6g} over {self.limit:.6g}: {self.text}"


def truth(check: str, model: str, holds: bool, text: str, layer: int = NO_LAYER) -> Figure:
    """Figure of something that holds or does not: 0 or 1 against 0."""
    return Figure(check, model, layer, 0.0 if holds else 1.0, 0.0, text)


def violations(figures: Iterable[Figure]) -> list[Figure]:
    """Those that are over their limit.

    Parameters
    ----------
    figures
        What checks found.

    Returns
    -------
    list of Figure
        In the same order.

    Examples
    --------
    >>> found = [Figure("bound", "cube", 0, 0.5, 1.0), Figure("bound", "cube", 1, float("nan"), 1.0)]
    >>> [figure.layer for figure in violations(found)]
    [1]
    """
    return [figure for figure in figures if figure.violated]
