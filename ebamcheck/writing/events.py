"""The events of a program before any control writes it, from the path that all translate: beads, turns, moves and waits, in
order."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ebamcheck.kernels import Floats, Ints
from ebamcheck.nc.inputs import Interpass, ScanColumns, interpass_of
from ebamcheck.scan.islands.clipping import GAP, THIN_WALL
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import wire_area_mm2, wire_speed_mm_s
from ebamcheck.writing.bead_parts import power_shares
from ebamcheck.writing.tracks import Toolpath

# Roles of events: beads of contours, islands, thin walls and gaps, turns between their lines; moves and waits.
CONTOUR, HATCH, WALL, FILLING, TURN, MOVE, WAIT = ["contour", "hatch", "wall", "gap", "turn", "move", "wait"]
# A beam-off move of at most this many bead spacings stays at the layer's height; a longer one rises.
NEAR_SPACINGS = 2.0
# Columns of process_events and what they are.
COLUMNS = {
    "layer": "index of the layer",
    "role": "contour, hatch, wall, gap or turn: metal; move: beam off; wait: at rest",
    "ring": "number of the contour ring, -1 for none",
    "island": "number of the island, -1 for none",
    **dict.fromkeys(("x_mm", "y_mm", "z_mm"), "where it ends"),
    "length_mm": "along the path",
    "time_s": "at the feed, or at rapid speed",
    "power_w": "beam power, 0 where it is off",
    "wire_mm_s": "wire speed, 0 where it is off",
    "starts": "1 where beam and wire are switched on",
}


def process_events(path: Toolpath, plan: ScanColumns, config: Config) -> pd.DataFrame:
    """List the events of a stack, one row each, with the columns of :data:`COLUMNS`; ends of moves are those of the tool.

    The path has the starts, ends and wire of its beads; the plan knows kinds of islands, waits and power.
    """
    heat = interpass_of(plan, config)
    beads = _beads(path, plan, config, heat)
    moves = _moves(path, config, heat)
    table = pd.concat([beads, moves], ignore_index=True)
    order = np.lexsort((table["step"], table["track"], table["layer"]))
    return table.iloc[order].drop(columns=["track", "step"])[list(COLUMNS)].reset_index(drop=True)


def _beads(path: Toolpath, plan: ScanColumns, config: Config, heat: Interpass) -> pd.DataFrame:
    """Segments of tracks: each is metal."""
    length = path.lengths
    sizes = np.diff(path.track_starts)
    track = np.repeat(np.arange(sizes.size), sizes)
    layer = np.repeat(np.arange(len(path.z)), np.diff(path.layer_starts))[track]
    island, ring = path.island[track], path.ring[track]
    kind = np.append(np.asarray(plan.island_kind), "")[island]
    marks = [ring >= 0, path.turn, kind == THIN_WALL, kind == GAP]
    role = np.select(marks, [CONTOUR, TURN, WALL, FILLING], HATCH)
    per_mm = np.array([wire_speed_mm_s(config, 1.0, float(h)) for h in path.thickness])
    first = np.zeros(track.size, np.int64)
    first[path.track_starts[:-1][sizes > 0]] = 1
    return pd.DataFrame(
        {
            # Moves and waits before a track, fewer than eight, come before its segments.
            "layer": layer, "track": track, "step": np.arange(track.size) + 8, "role": role, "ring": ring, "island": island,
            "x_mm": path.end[:, 0], "y_mm": path.end[:, 1], "z_mm": path.z[layer], "length_mm": length,
            "time_s": length / config.process.travel_speed_mm_s,
            "power_w": power_shares(path, heat, config) * config.process.power_w,
            "wire_mm_s": path.width * per_mm[layer], "starts": first,
        }
    )  # fmt: skip


def _moves(path: Toolpath, config: Config, heat: Interpass) -> pd.DataFrame:
    """Moves with the beam off, and waits, as every control has them."""
    safe_mm, rapid = config.machine.safe_height_mm, config.machine.rapid_mm_s
    track = np.flatnonzero(np.diff(path.track_starts) > 0)
    layer = np.repeat(np.arange(len(path.z)), np.diff(path.layer_starts))[track]
    start, z, end = path.start[track], path.z[layer], path.end[path.track_starts[track + 1] - 1]
    begins = np.diff(layer, prepend=-1) != 0
    layer_wait_s, wait_s = track_waits_s(layer, path.ring[track], path.island[track], heat)
    across = np.zeros(track.size)
    across[1:] = np.hypot(*(start[1:] - end[:-1]).T)
    # The tool rises before a far track.
    far = begins | (across > NEAR_SPACINGS * config.process.hatch_spacing_mm) | (wait_s > 0.0)
    # The rise at the end of each layer, and on to the safe height of the next one, whether these have metal or not.
    every, last = np.arange(len(path.z)), np.zeros((len(path.z), 2))
    last[layer] = end
    up, beyond = np.diff(path.z, prepend=path.z[:1]), np.full(every.size, path.track_starts.size)
    rise = np.where(np.isin(every, layer), safe_mm, 0.0)
    none, high = np.zeros(track.size), z + safe_mm
    rows = [
        _rows(layer, track, 0, WAIT, start, high, none, layer_wait_s),
        _rows(layer, track, 1, MOVE, start, high, np.where(far & ~begins, safe_mm, 0.0), None),
        _rows(layer, track, 2, WAIT, start, high, none, wait_s),
        _rows(layer, track, 3, MOVE, start, np.where(far, high, z), across, None),
        _rows(layer, track, 4, MOVE, start, z, np.where(far, safe_mm, 0.0), None),
        _rows(every, np.full(every.size, -1), 0, MOVE, last, path.z + safe_mm, up, None),
        _rows(every, beyond, 0, MOVE, last, path.z + safe_mm, rise, None),
    ]
    table = pd.concat(rows, ignore_index=True)
    table["time_s"] = np.where(table["role"] == MOVE, table["length_mm"] / rapid, table["time_s"])
    return table[(table["length_mm"] > 0.0) | (table["time_s"] > 0.0)]


def track_waits_s(layer: Ints, ring: Ints, island: Ints, heat: Interpass) -> tuple[Floats, Floats]:
    """Waits before tracks that lay metal (T,): those before each layer but the first, and those within it."""
    begins, entered = (np.diff(column, prepend=-1) != 0 for column in (layer, island))
    before = np.where(begins, heat.wait_s[layer], 0.0)
    before[:1] = 0.0
    within = np.where((ring >= 0) & ~begins, heat.ring_wait_s[layer], 0.0)
    first, inner = (island >= 0) & entered, (island >= 0) & ~entered
    within[first] = heat.island_wait_s[island[first]]
    within[inner] = heat.inner_wait_s[island[inner]]
    return before, within


def _rows(
    layer: Ints, track: Ints, step: int, role: str, place: Floats, z: Floats, length: Floats, time_s: Floats | None,
) -> pd.DataFrame:  # fmt: skip
    return pd.DataFrame(
        {
            "layer": layer, "track": track, "step": step, "role": role, "ring": -1, "island": -1, "x_mm": place[:, 0],
            "y_mm": place[:, 1], "z_mm": z, "length_mm": length, "time_s": 0.0 if time_s is None else time_s,
            "power_w": 0.0, "wire_mm_s": 0.0, "starts": 0,
        }
    )  # fmt: skip


def event_totals(events: pd.DataFrame, layers: int, config: Config) -> pd.DataFrame:
    """One row a layer: lengths of beads by role, moves, starts, times (waits before it and within it), wire and mass."""
    layer, role = events["layer"].to_numpy(), events["role"].to_numpy()
    metal = ~np.isin(role, (MOVE, WAIT))

    def total(column: str | Floats, which: np.typing.NDArray[np.bool_]) -> Floats:
        values = events[column].to_numpy(np.float64) if isinstance(column, str) else column
        return np.bincount(layer[which], values[which], minlength=layers).astype(np.float64)

    lengths = {f"{name}_mm": total("length_mm", role == name) for name in (CONTOUR, HATCH, TURN, WALL, FILLING)}
    wire_mm = total(events["time_s"].to_numpy() * events["wire_mm_s"].to_numpy(), metal)
    kg_mm = wire_area_mm2(config) * 1e-9 * config.material.density_kg_m3
    columns = {
        "layer": np.arange(layers),
        **lengths,
        "travel_mm": total("length_mm", role == MOVE),
        "starts": total("starts", metal).astype(np.int64),
        "deposit_s": total("time_s", metal),
        "travel_s": total("time_s", role == MOVE),
        "wait_s": total("time_s", role == WAIT),
        "wire_mm": wire_mm,
        "wire_kg": wire_mm * kg_mm,
    }
    return pd.DataFrame(columns)
