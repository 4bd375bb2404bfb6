"""What the viewer shows of a run: an index of all layers, and for each layer its outlines, islands, motions and text."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
import shapely

from ebamcheck.checks.interpass_checks import motion_seconds
from ebamcheck.checks.metal import zone_limit, zone_off
from ebamcheck.checks.subject import Subject
from ebamcheck.curves import Curves
from ebamcheck.errors import InputError
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.motions import ARC, POLYNOMIAL, SPLINE_SPAN, NCProgram
from ebamcheck.nc.timeline import PAUSE
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.runs import Run
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config
from ebamcheck_reports.run_data import RunData
from ebamcheck_viewer.columns import STEP_MM, packed, packed_text, quantised

SHARE = 1e-4  # step of the shares of limits in the strip beside the layers
MOST_SHARES = 1000.0  # what is farther over its limit, or has a limit of 0, is told as this
SECOND = 1e-3
WATT = 0.1


@dataclass
class Contents:
    """Index of a page, and its blobs by the names of the elements that hold them."""

    index: dict[str, Any]
    blobs: dict[str, str] = field(default_factory=dict)


def of_run(folder: RunFolder) -> Contents:
    """Contents of a finished run; what the run did not come to is left out."""
    run = RunData(folder)
    made = not run.is_check and bool(run.part_of("program").get("files"))
    program = with_roles(Run(folder.path).program, run) if made else None
    stacks = {name: folder.read_layers(name) for name in run.kept_methods}
    index = {
        "name": str(run.part_of("part").get("name", "")), "verdict": verdict(run), "primary": str(run.manifest.get("primary", "")),
        "strips": strips(run), "notes": notes(run),
    }  # fmt: skip
    return _contents(index, run.config, stacks, program, run.curves, run.plan)


def of_files(stacks: Mapping[str, Layers], program: NCProgram | None, config: Config) -> Contents:
    """Contents of layer files, a program, or both, layer by layer in their order.

    Raises
    ------
    InputError
        Where they have different numbers of layers: they are not those of one build.
    """
    counts = {name: len(stack) for name, stack in stacks.items()}
    counts |= {program.files[0].name: len(program.layer_files)} if program is not None else {}
    if len(set(counts.values())) != 1:
        told = ", ".join(f"{name} has {count}" for name, count in counts.items()) or "nothing to show"
        raise InputError(f"layers of one build are as many in every file: {told}")
    name = ", ".join(counts)
    primary = next(iter(stacks), "")
    return _contents(
        {"name": name, "verdict": "", "primary": primary, "strips": [], "notes": []}, config, stacks, program
    )


def _contents(
    index: dict[str, Any], config: Config, stacks: Mapping[str, Layers], program: NCProgram | None,
    curves: Curves | None = None, plan: ScanPlan | None = None,
) -> Contents:  # fmt: skip
    z = program.layer_heights if program is not None else np.zeros(0)
    heights = next((stack.heights for stack in stacks.values()), z)
    count = len(heights)
    index |= {
        "step_mm": STEP_MM, "layers": count, "cut_mm": _rounded(heights), "slicers": list(stacks),
        "box": box(stacks, program), "bead_mm": config.process.bead_width_mm,
    }  # fmt: skip
    found = Contents(index)
    every: list[dict[str, Ints]] = [{} for _ in range(count)]
    for name, stack in stacks.items():
        _add(every, (outlines(f"c.{name}", stack, k) for k in range(count)))
    if curves is not None:
        _add(every, (spans(curves, k) for k in range(count)))
    if plan is not None:
        _add(every, (islands(plan, k) for k in range(count)))
    if program is not None:
        index |= {"files": list(program.layer_files), "z_mm": _rounded(z)}
        _add(every, motions(program, config, plan, count))
        index["lines"] = [int(columns["m.line"][0]) if columns["m.line"].size else 0 for columns in every]
        found.blobs |= {f"T{file.name}": packed_text(file.data) for file in program.files}
    found.blobs |= {f"L{k + 1}": packed(columns) for k, columns in enumerate(every)}
    return found


def box(stacks: Mapping[str, Layers], program: NCProgram | None) -> list[float]:
    """Bounds of all outlines, or of the beads where there are none, mm; a unit square where there are neither."""
    places = [stack.points for stack in stacks.values() if len(stack.points)]
    if not places and program is not None and program.deposit.any():
        places = [program.end[program.deposit, :2]]
    if not places:
        return [0.0, 0.0, 1.0, 1.0]
    every = np.concatenate([np.stack([points.min(axis=0), points.max(axis=0)]) for points in places])
    return [*every.min(axis=0).tolist(), *every.max(axis=0).tolist()]


def with_roles(program: NCProgram, run: RunData) -> NCProgram:
    """The program with contours and islands told apart by the sections of the part."""
    roles = Subject(program, run.config, layers=run.primary).nc
    return replace(program, ring=roles.ring, island=roles.island)


def verdict(run: RunData) -> str:
    """Verdict of the run in the words of its report."""
    word = "AGREED" if run.is_check else "VALIDATED"
    return word if run.passed else f"NOT {word}"


def _add(every: Sequence[dict[str, Ints]], columns: Iterator[Mapping[str, Ints]]) -> None:
    for own, more in zip(every, columns, strict=False):
        own |= more


def _rounded(values: Floats) -> list[float | None]:
    return [None if np.isnan(value) else round(float(value), 6) for value in values]


def outlines(name: str, stack: Layers, k: int) -> dict[str, Ints]:
    """Rings of one layer: points of each, whether it is closed, and coordinates; points that no eye can tell from a line go."""
    block = stack.block(k, k + 1)
    ring = np.repeat(np.arange(block.closed.size), np.diff(block.ring_starts))
    lines = shapely.linestrings(block.points, indices=ring) if ring.size else np.empty(0, object)
    kept = shapely.simplify(lines, 0.5 * STEP_MM)
    points, of = shapely.get_coordinates(kept, return_index=True)
    return {
        f"{name}.size": np.bincount(of, minlength=block.closed.size), f"{name}.closed": block.closed.astype(np.int64),
        f"{name}.x": quantised(points[:, 0]), f"{name}.y": quantised(points[:, 1]),
    }  # fmt: skip


def spans(curves: Curves, k: int) -> dict[str, Ints]:
    """Fitted rings of one layer as Bezier points: the start of each, then three points a span."""
    block = curves.block(k, k + 1)
    bezier = block.bezier_spans()
    sizes: Ints = np.bincount(bezier.ring, minlength=block.closed.size)
    first = (np.cumsum(sizes) - sizes)[sizes > 0]
    points = np.insert(bezier.points[:, 1:].reshape(-1, 2), 3 * first, bezier.points[first, 0], axis=0)
    return {"f.size": sizes, "f.x": quantised(points[:, 0]), "f.y": quantised(points[:, 1])}


def islands(plan: ScanPlan, k: int) -> dict[str, Ints]:
    """Islands of one layer in the order of the beam: number, outline and wait."""
    numbers = plan.islands_of(k)
    rings, owner = shapely.get_rings(plan.islands[numbers], return_index=True)
    points = shapely.get_coordinates(rings)
    waits = plan.island_wait_s[numbers] if plan.island_wait_s.size else np.zeros(numbers.size)
    return {
        "i.number": numbers, "i.wait": quantised(waits, SECOND), "i.owner": owner, "i.size": shapely.get_num_coordinates(rings).astype(np.int64),
        "i.x": quantised(points[:, 0]), "i.y": quantised(points[:, 1]),
        "i.cx": quantised(plan.island_centroid[numbers, 0]), "i.cy": quantised(plan.island_centroid[numbers, 1]),
    }  # fmt: skip


def motions(nc: NCProgram, config: Config, plan: ScanPlan | None, count: int) -> Iterator[dict[str, Ints]]:
    """Motions of each layer: where each ends and how it bends, how long it takes, what the beam does and in which island; waits stand
    before the motion that follows them."""
    seconds = np.nan_to_num(motion_seconds(nc, config))
    waits = np.zeros(len(nc) + 1)
    paused = np.flatnonzero(nc.events.named(PAUSE))
    np.add.at(waits, nc.events.row[paused], nc.events.value[paused])
    curved = (nc.kind == POLYNOMIAL) | (nc.kind == SPLINE_SPAN)
    for k in range(count):
        rows = np.flatnonzero(nc.layer == k)
        start, end = nc.start[rows, :2], nc.end[rows, :2]
        if rows.size and np.isnan(start[0]).any():
            start = np.where(np.isnan(start), end, start)
        bent, round_ = rows[curved[rows]], rows[nc.kind[rows] == ARC]
        c = nc.coefficients[bent]
        inner = np.concatenate(
            [c[:, :, 0] + c[:, :, 1] / 3.0, c[:, :, 0] + (2.0 * c[:, :, 1] + c[:, :, 2]) / 3.0], axis=1
        )
        away = inner - np.tile(nc.end[bent, :2], 2)
        centre = nc.arc[round_]
        kind = np.where(
            nc.kind[rows] == ARC,
            np.where(nc.arc[rows, 2] > 0.0, 4, 5),
            np.where(curved[rows], 3, np.minimum(nc.kind[rows], 1)),
        )
        yield {
            "m.kind": kind, "m.line": nc.line[rows], "m.x0": quantised(start[:1, 0]), "m.y0": quantised(start[:1, 1]),
            "m.x": quantised(end[:, 0]), "m.y": quantised(end[:, 1]), "m.z": quantised(nc.end[rows, 2]),
            **{f"m.b{n}": quantised(away[:, n]) for n in range(4)},
            "m.ax": quantised(centre[:, 0]), "m.ay": quantised(centre[:, 1]),
            "m.on": nc.beam[rows] + 2 * nc.wire[rows], "m.ms": quantised(seconds[rows], SECOND), "m.wait": quantised(waits[rows], SECOND),
            "m.feed": quantised(nc.feed_mm_min[rows], 0.01), "m.power": quantised(nc.power_w[rows], WATT), "m.wire": quantised(nc.wire_mm_s[rows], 0.001),
            "m.ring": nc.ring[rows], "m.island": _island_of(nc, rows, plan, k),
        }  # fmt: skip


def _island_of(nc: NCProgram, rows: Ints, plan: ScanPlan | None, k: int) -> Ints:
    """Island that each motion fills, by the number of it in the plan; -1 for contours, and where there is no plan."""
    result = np.full(rows.size, -1, np.int64)
    fills = np.flatnonzero(nc.deposit[rows] & (nc.ring[rows] < 0))
    if plan is not None and fills.size and (numbers := plan.islands_of(k)).size:
        middles = nc.evaluate(rows[fills], np.full(fills.size, 0.5))
        result[fills] = numbers[shapely.STRtree(plan.islands[numbers]).nearest(shapely.points(middles))]
    return result


# -- how near each layer is to its limits -----------------------------------------------------------


def strips(run: RunData) -> list[dict[str, Any]]:
    """For each gate that has a figure of each layer: the share of its limit that every layer takes, and the place where it does."""
    found = [strip for strip in (_agreement(run), _coverage(run), _deposit(run), _heat(run)) if strip is not None]
    return [strip | {"share": quantised(strip["share"], SHARE).tolist(), "step": SHARE} for strip in found]


def _agreement(run: RunData) -> dict[str, Any] | None:
    if not run.pairs:
        return None
    pairs = run.pair_table[run.pair_table["gated"]]
    pairs = pairs.assign(share=(pairs["depth_mm"] / pairs["limit_mm"]).fillna(0.0))
    worst = pairs.loc[pairs.groupby("layer")["share"].idxmax()].set_index("layer").reindex(run.layer_table["layer"])
    of = (worst["a"] + ", " + worst["b"]).fillna("").tolist()
    places = worst[["depth_x_mm", "depth_y_mm"]]
    return _strip("agreement", worst["share"], worst["depth_mm"], worst["limit_mm"], "mm", places, of)


def _coverage(run: RunData) -> dict[str, Any] | None:
    limit = run.gate_limit("coverage")
    if limit is None or run.plan is None or limit >= 1.0:
        return None
    covered = run.plan.metrics["covered_fraction"]
    return _strip("coverage", (1.0 - covered) / (1.0 - limit), covered, limit, "of the area")


def _deposit(run: RunData) -> dict[str, Any] | None:
    if run.gate_limit("deposit") is None:
        return None
    table = run.table("deposit.csv")
    off = zone_off(table["zone_settled"], table["zone_owed"])
    limit = zone_limit(table["zone_tolerance"].to_numpy(), table["zone_mm2"], run.config.process)
    return _strip("deposit", off / limit, off, limit, "layers off", table[["zone_x_mm", "zone_y_mm"]])


def _heat(run: RunData) -> dict[str, Any] | None:
    limit_k = run.gate_limit("heat")
    if not limit_k or run.plan is None:
        return None
    ambient_k = run.setting("process", "ambient_temperature_k", 293.15)
    entry_k = run.plan.metrics["entry_max_k"] + ambient_k
    return _strip("heat", (entry_k - ambient_k) / (limit_k - ambient_k), entry_k, limit_k, "K")


def _strip(
    gate: str,
    share: Any,
    figure: Any,
    limit: Any,
    unit: str,
    place: pd.DataFrame | None = None,
    of: Sequence[str] = (),
) -> dict[str, Any]:
    share = np.minimum(np.nan_to_num(np.asarray(share, np.float64), posinf=MOST_SHARES), MOST_SHARES)
    figure = np.asarray(figure, np.float64)
    at = (
        []
        if place is None
        else [[round(float(v), 3) if np.isfinite(v) else None for v in row] for row in place.to_numpy()]
    )
    limits = np.broadcast_to(np.asarray(limit, np.float64), figure.shape)
    return {"gate": gate, "unit": unit, "share": share, "figure": [float(f"{v:.6g}") if np.isfinite(v) else None for v in figure],
            "limit": [float(f"{v:.6g}") if np.isfinite(v) else None for v in limits], "at": at, "of": list(of)}  # fmt: skip


# -- what the run says ------------------------------------------------------------------------------

_LAYER = re.compile(r"\blayer (\d+)")
_POINT = re.compile(r"\((-?\d+(?:\.\d+)?), (-?\d+(?:\.\d+)?)[,)]")
_BLOCK = re.compile(r"\b([\w.-]+\.\w{2,4}):(\d+)\b")


def notes(run: RunData) -> list[dict[str, Any]]:
    """Gates, findings and checks of the run, each with the layer, place and block that it speaks of."""
    found = [_note("gate", gate["name"], gate["passed"], gate["text"], gate["text"]) for gate in run.gates]
    found += [
        _note(
            "finding",
            one["code"],
            one["severity"] == "note",
            one["text"],
            one["place"],
            one.get("remedy", ""),
        )
        for one in run.findings
    ]
    for check in run.checks:
        note = _note(
            "check",
            check["name"],
            check["passed"],
            check["text"],
            f"{check['place']} {check['where']}",
            check["remedy"],
        )
        if check["layer"] is not None:
            note["layer"] = int(check["layer"])
        if check["x_mm"] is not None and check["y_mm"] is not None:
            note["at"] = [check["x_mm"], check["y_mm"]]
        found.append(note)
    return found


def _note(kind: str, name: str, good: bool, text: str, place: str, remedy: str = "") -> dict[str, Any]:
    note: dict[str, Any] = {"kind": kind, "name": name, "good": bool(good), "text": text, "remedy": remedy}
    if layer := _LAYER.search(place):
        note["layer"] = int(layer[1])
    if point := _POINT.search(place):
        note["at"] = [float(point[1]), float(point[2])]
    if block := _BLOCK.search(place):
        note["line"] = f"{block[1]}:{block[2]}"
    return note
