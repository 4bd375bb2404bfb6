"""Checks of the protocol: what a slicer says of itself, and the form of what it returns."""

from __future__ import annotations

import inspect
import json
import logging
import math
from typing import Any, Self, get_args

import numpy as np
from pydantic import BaseModel, ValidationError

from ebamcheck.backend import BackendSettings, CoplanarRule, Probe
from ebamcheck.layers.stack import Layers, canonical, concatenate
from ebamcheck.plugins.registry import SLICER_ATTRIBUTES
from ebamcheck.testing.solids import box, joined, mapped, named, simple, winding_rule
from ebamcheck.testing.subject import Figure, Subject, generic_heights, truth

SIGNATURES = {
    "probe": (),
    "error_bound_mm": ("part", "settings"),
    "height_bound_mm": ("part", "settings"),
    "prepare": ("part", "settings"),
}

EXACT_BOUND = (
    1e-6  # largest bound of a slicer that calls itself exact, over the part's largest coordinate: it is rounding
)
COLUMNS = ("heights", "points", "ring_starts", "layer_starts", "closed")
FORM_SOLIDS = ("plate with holes", "tilted plate", "upright torus", "cavity", "comb", "pillars")


def attributes(subject: Subject) -> list[Figure]:
    """Everything that the protocol asks for is there and of the right kind."""
    slicer = subject.slicer
    missing = [name for name in SLICER_ATTRIBUTES if not hasattr(slicer, name)]
    found = [truth("attributes", "class", not missing, f"it lacks {', '.join(missing)}")]
    if missing:
        return found

    def holds(what: str, good: bool) -> None:
        found.append(truth("attributes", what, good, f"it is {getattr(slicer, what)!r}"))

    holds("name", isinstance(slicer.name, str) and bool(slicer.name) and slicer.name == slicer.name.strip())
    told = isinstance(slicer.summary, str) and slicer.summary.count("\n") == 0 < len(slicer.summary)
    holds("summary", told)
    holds("exact", isinstance(slicer.exact, bool))
    holds("priority", isinstance(slicer.priority, int))
    holds("coplanar_rule", slicer.coplanar_rule in get_args(CoplanarRule))
    holds("inside_rule", winding_rule(slicer.inside_rule) is not None)
    holds("Settings", isinstance(slicer.Settings, type) and issubclass(slicer.Settings, BackendSettings))
    return found


def signatures(subject: Subject) -> list[Figure]:
    """Methods name their arguments as the protocol does; nothing hides behind ``*args`` or ``**kwargs``."""
    found = []
    for method, wanted in SIGNATURES.items():
        names = tuple(inspect.signature(getattr(subject.slicer, method)).parameters)
        found.append(truth("signatures", method, names == wanted, f"it takes {names}, not {wanted}"))
    with subject.slicer.prepare(simple("box"), subject.settings) as prepared:
        names = tuple(inspect.signature(prepared.slice).parameters)
    wanted = ("heights", "progress")
    found.append(truth("signatures", "slice", names == wanted, f"it takes {names}, not {wanted}"))
    return found


def settings(subject: Subject) -> list[Figure]:
    """Settings have defaults, refuse keys they do not know, and do not change."""
    kind: type[BaseModel] = subject.slicer.Settings
    chosen = kind()
    try:
        kind(no_such_setting=1)
        refused = False
    except ValidationError:
        refused = True
    frozen = chosen.model_config.get("frozen") is True
    return [
        truth("settings", "unknown key", refused, "Settings(no_such_setting=1) was taken: forbid extra keys"),
        truth("settings", "frozen", frozen, "settings can be changed after they were checked"),
    ]


def probe(subject: Subject) -> list[Figure]:
    """Asking whether this machine can run it never raises, and an answer of no says why."""
    try:
        answer: Any = subject.slicer.probe()
    except Exception as error:
        return [truth("probe", "probe", False, f"it raised {type(error).__name__}: {error}")]
    kind = isinstance(answer, Probe)
    found = [truth("probe", "answer", kind, f"it returned {type(answer).__name__}, not Probe")]
    if kind:
        reason = answer.available or bool(answer.why)
        found.append(truth("probe", "reason", reason, "it is not available and does not say why"))
    return found


def context(subject: Subject) -> list[Figure]:
    """What `prepare` returns is a context manager that enters as itself and may be made again."""
    found = []
    for time in ("first", "second"):
        prepared = subject.slicer.prepare(simple("box"), subject.settings)
        with prepared as entered:
            same = entered is prepared
            layers = entered.slice(np.array([2.9]))
        found.append(truth("context", f"{time} time", same, "__enter__ returned something else"))
        text = f"it gave {len(layers)} layers for one"
        found.append(truth("context", f"{time} cut", len(layers) == 1, text))
    return found


def blocks(subject: Subject) -> list[Figure]:
    """A layer does not depend on which others are asked for, nor on what was cut before."""
    part = simple("tilted plate")
    heights = generic_heights(part, 7)
    with subject.slicer.prepare(part, subject.settings) as prepared:
        whole = prepared.slice(heights)
        later = prepared.slice(heights[4:])
        earlier = prepared.slice(heights[:4])
        again = prepared.slice(heights)
        single = prepared.slice(heights[3:4])
    return [
        _same("blocks", "two blocks, the later one first", concatenate([earlier, later]), whole),
        _same("blocks", "the same again", again, whole),
        _same("blocks", "one layer", single, whole.block(3, 4)),
    ]


def canonical_form(subject: Subject) -> list[Figure]:
    """Layers are in canonical form: where rings start, how they are sorted, no repeated points."""
    found = []
    for name in FORM_SOLIDS:
        part = simple(name)
        layers = subject.cut(part, generic_heights(part, 3))
        again = canonical(*(getattr(layers, column) for column in COLUMNS))
        found.append(_same("canonical form", name, again, layers))
    return found


def orientation(subject: Subject) -> list[Figure]:
    """Outer rings run counter-clockwise, rings inside them clockwise, and so on inwards."""
    found = []
    for name in FORM_SOLIDS:
        part = simple(name)
        layers = subject.cut(part, generic_heights(part, 3))
        level = np.zeros(layers.closed.size, dtype=np.int64)
        parents = layers.parents
        above = parents.copy()
        while (above >= 0).any():
            level += above >= 0
            above = np.where(above >= 0, parents[above], -1)
        wrong = layers.closed & ((layers.ring_areas > 0.0) != (level % 2 == 0))
        text = f"{np.count_nonzero(wrong)} of {wrong.size} rings run the wrong way round"
        found.append(Figure("orientation", name, -1, float(np.count_nonzero(wrong)), 0.0, text))
    return found


def out_of_range(subject: Subject) -> list[Figure]:
    """Heights below and above the part give empty layers, and no height gives no layer."""
    part = simple("sphere")
    low, high = part.bounds[:, 2].tolist()
    planes = np.array([low - 5.0, low - 0.1, 0.5 * (low + high) + 0.01, high + 0.1, high + 1e4])
    layers = subject.cut(part, planes)
    counts = layers.ring_counts() + layers.open_counts()
    right = len(layers) == planes.size and (counts > 0).tolist() == [False, False, True, False, False]
    kept = len(layers) == planes.size and np.array_equal(layers.heights, planes)
    none, text = subject.cut(part, []), f"rings on five layers, of which two lie on each side: {counts}"
    return [
        truth("out of range", "outside", right, text),
        truth("out of range", "heights", kept, "the layers do not carry the heights that were asked for"),
        truth("out of range", "no heights", len(none) == 0, f"it gave {len(none)} layers for no heights"),
    ]


def labels(subject: Subject) -> list[Figure]:
    """Layers carry the part's hash and direction, the slicer's name and its settings."""
    part = named("turned", simple("tilted plate")).along((0.0, 1.0, 1.0))
    layers = subject.cut(part, generic_heights(part, 1))
    chosen = set(type(subject.settings).model_fields)
    try:
        written = json.loads(layers.labels_json())["settings"]
    except (TypeError, ValueError) as error:
        written = {}
        text = f"settings cannot be written as JSON: {error}"
    else:
        text = f"settings {sorted(chosen - set(written))} are not recorded"
    return [
        truth("labels", "part", layers.part == part.sha256, f"part is {layers.part!r}"),
        truth("labels", "direction", layers.direction == part.direction, f"direction is {layers.direction}"),
        truth("labels", "backend", layers.backend == subject.slicer.name, f"backend is {layers.backend!r}"),
        truth("labels", "settings", chosen <= set(written), text),
    ]


def progress(subject: Subject) -> list[Figure]:
    """Progress adds up to the number of layers, in steps of one or more."""
    part = simple("sphere")
    heights = np.concatenate([[part.bounds[0, 2] - 1.0], generic_heights(part, 40)])
    steps: list[int] = []
    with subject.slicer.prepare(part, subject.settings) as prepared:
        prepared.slice(heights, steps.append)
    good = sum(steps) == heights.size and all(step > 0 for step in steps)
    text = f"{len(steps)} calls add up to {sum(steps)} of {heights.size} layers"
    return [truth("progress", "sphere", good, text)]


def declared_bound(subject: Subject) -> list[Figure]:
    """The bound is positive, as small as rounding if the slicer is exact, and grows with the part at most as it."""
    found = []
    for name in ("box", "torus", "comb"):
        part = simple(name)
        bound, double = subject.bound_mm(part), subject.bound_mm(mapped(part, 2.0 * np.eye(3)))
        height = float(subject.slicer.height_bound_mm(part, subject.settings))
        good = math.isfinite(bound) and bound > 0.0 and math.isfinite(height) and height >= 0.0
        found.append(truth("declared bound", name, good, f"bound {bound} mm, of heights {height} mm"))
        ratio = double / bound if bound > 0.0 else math.inf
        text = f"a part twice as large has {ratio:.6g} times the bound"
        found.append(truth("declared bound", f"{name}, doubled", 1.0 - 1e-9 <= ratio <= 2.0 + 1e-9, text))
        if subject.slicer.exact:
            limit, text = EXACT_BOUND * float(np.abs(part.bounds).max()), "more than rounding, mm"
            found.append(Figure("declared bound", f"{name}, exact", -1, bound, limit, text))
    return found


def open_surfaces(subject: Subject) -> list[Figure]:
    """An open box is refused, leaves a contour or is warned of; it never vanishes in silence."""
    closed = joined(box((0, 0, 0), (8, 8, 8)), box((12, 0, 0), (20, 8, 8)))
    level = (closed.triangles[:, :, 2] == 8.0).all(axis=1)
    side = (closed.triangles[:, :, 0] == 20.0).all(axis=1)
    found: list[Figure] = []
    for name, gone in {"no lid": level, "no side": side}.items():
        part = named(name, type(closed)(closed.vertices, closed.faces[~gone]))
        with _Heard() as heard:
            layers = subject.cut_unless_refused("open surfaces", part, [4.1], found)
        if layers is None:
            continue
        paths = int((layers.ring_counts() + layers.open_counts())[0])
        text = f"{paths} contours of two bodies, and no warning"
        found.append(truth("open surfaces", name, paths >= 2 or heard.count > 0, text, 0))
    return found


class _Heard(logging.Handler):
    """Counts warnings in the log, whoever writes them, and keeps them from the terminal."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1

    def __enter__(self) -> Self:
        logging.getLogger().addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        logging.getLogger().removeHandler(self)


def _same(check: str, name: str, found: Layers, wanted: Layers) -> Figure:
    unlike = [c for c in COLUMNS if not np.array_equal(getattr(found, c), getattr(wanted, c))]
    return truth(check, name, not unlike, f"other {', '.join(unlike)}")


# In the order in which they are run
CHECKS = (
    attributes, signatures, settings, probe, context, blocks, canonical_form, orientation, out_of_range, labels, progress,
    declared_bound, open_surfaces,
)  # fmt: skip
