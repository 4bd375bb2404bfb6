"""Post-processor for the heat simulator 3DThesis: the analytic heat of a moving Gaussian beam on a half space of constant material
data.

A row of its table is a mode, a position in mm, a share of the power, and a parameter: mode 1 stays for so many seconds, mode 0
moves there at so many m/s. Keywords as its ``Init.cpp`` reads them: groups in braces, lengths in metres; paths and points in
millimetres."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.heat.medium import BEAM_SHARE
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.control import Control
from ebamcheck.nc.control import control as control_named
from ebamcheck.nc.files import NOT_VALIDATED, VALIDATED, ProgramFiles, write_files
from ebamcheck.nc.inputs import CurveColumns, ScanColumns, interpass_of
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import driven_path
from ebamcheck.writing.bead_parts import power_shares
from ebamcheck.writing.events import track_waits_s

SCRIPT = "run.sh"  # What runs a case
STATUS = "@status@"  # Stands in the texts of a case where its status will be
LINE_MODE, SPOT_MODE = 0, 1
LEAST_SPOT_S = 1e-6  # Shortest time of a spot: simulators divide by the time of a row
DECIMALS = 6  # Of a millimetre
METRES = 1e-3  # Metres in a millimetre; and m/s in a mm/s
# The simulator as a control, whose cases no reader proves.
THESIS = Control("3dthesis", f"{__name__}:write_3dthesis")


@dataclass(frozen=True, eq=False)
class HeatPath:
    """The path of a stack as simulators take it."""

    rows: Floats  # (n, 6) mode, X, Y, Z in mm, share of the power, and s for a spot or m/s for a line
    layer: Ints  # (n,) of each row; -1 for the island of a contour
    island: Ints

    @property
    def is_line(self) -> Bools:
        """(n,) rows that move."""
        return np.asarray(self.rows[:, 0] == LINE_MODE)

    @property
    def end_s(self) -> Floats:
        """(n,) time at which each row is done, from the beginning of the path, as simulators add it up."""
        way = np.zeros(len(self.rows))
        way[1:] = np.linalg.norm(np.diff(self.rows[:, 1:4], axis=0), axis=1)
        line = self.is_line
        moved = np.divide(way * METRES, self.rows[:, 5], out=np.zeros(len(way)), where=line)
        return np.asarray(np.cumsum(np.where(line, moved, self.rows[:, 5])), np.float64)

    def of_layer(self, layer: int | None) -> HeatPath:
        """Path of one layer, which begins where its first bead does, the whole one for None; SettingsError where it has no such
        layer."""
        if layer is None:
            return self
        if not (self.layer == layer).any():
            found = f"{self.layer.min() + 1} to {self.layer.max() + 1}" if len(self.layer) else "none"
            raise SettingsError(f"--layer {layer + 1}: the path has no bead there; its layers are {found}")
        mine = self.layer == layer
        rows = self.rows[mine]
        rows[0, 5] = LEAST_SPOT_S
        return HeatPath(rows, self.layer[mine], self.island[mine])


def case_post(control: str) -> Callable[..., ProgramFiles]:
    """Writer of a simulator, which takes a `layer`, too; raises :class:`SettingsError` for a control, which takes a whole
    program."""
    found = control_named(control)
    if found.is_read:
        raise SettingsError(f"--layer: {control} takes a whole program; one layer is for heat simulators")
    post: Callable[..., ProgramFiles] = found.load("writer")
    return post


def write_3dthesis(
    curves: CurveColumns, plan: ScanColumns, config: Config, folder: str | Path, *, validated: bool = False,
    header: Mapping[str, str] | None = None, layer: int | None = None,
) -> ProgramFiles:  # fmt: skip
    """Write a case of 3DThesis, its ``Path.txt`` first; of one layer where one is given. `header` has no place in it.

    Takes and raises what :func:`ebamcheck.write_program` does.
    """
    path = heat_path(curves, plan, config).of_layer(layer)
    return write_thesis(path, thesis_files(path.rows, config), folder, validated=validated)


def write_thesis(
    path: HeatPath, others: Mapping[str, str], folder: str | Path, *, validated: bool = False
) -> ProgramFiles:
    """Write a case of 3DThesis from its path and its other files."""
    title = f"Mode\tX(mm)\tY(mm)\tZ(mm)\tPmod\ttParam\t{STATUS}"
    line = "%d\t%.6f\t%.6f\t%.6f\t%g\t%.9g\n"
    text = (line * len(path.rows)) % tuple(path.rows.ravel().tolist())
    texts = fill_case({"Path.txt": f"{title}\n{text}", **others}, validated=validated)
    return write_files(texts, Path(folder), validated=validated)


def fill_case(texts: Mapping[str, str], *, validated: bool = False) -> dict[str, str]:
    """Texts of a case with their status."""
    status = VALIDATED if validated else NOT_VALIDATED
    return {name: text.replace(STATUS, status, 1) for name, text in texts.items()}


def heat_path(curves: CurveColumns, plan: ScanColumns, config: Config) -> HeatPath:
    """Path of a stack: a spot without power leads to each bead, and lasts as long as the way there."""
    path = driven_path(curves, plan, config, DECIMALS, "all chords", config.machine.line_tolerance_mm)
    sizes = np.diff(path.track_starts)
    tracks = np.flatnonzero(sizes > 0)
    sizes = sizes[tracks]
    z = np.repeat(path.z, np.diff(path.layer_starts))[tracks]
    rows = np.empty((int(sizes.sum()) + tracks.size, 6))
    spot = np.concatenate([[0], np.cumsum(sizes + 1)])[:-1].astype(np.int64)
    line = np.ones(len(rows), np.bool_)
    line[spot] = False
    rows[:, 0] = np.where(line, LINE_MODE, SPOT_MODE)
    rows[spot, 1:3], rows[line, 1:3] = path.start[tracks], path.end
    rows[:, 3] = np.repeat(z, sizes + 1)
    rows[line, 5] = config.process.travel_speed_mm_s * METRES
    # The rapid move to each track; the first is where the beam is.
    away = np.zeros(spot.size)
    if spot.size:
        away[1:] = np.linalg.norm(rows[spot[1:], 1:4] - rows[spot[1:] - 1, 1:4], axis=1)
    rows[spot, 5] = np.maximum(away / config.machine.rapid_mm_s, LEAST_SPOT_S)
    heat = interpass_of(plan, config)
    layer = np.repeat(np.arange(len(path.z)), np.diff(path.layer_starts))[tracks]
    island = path.island[tracks]
    rows[spot, 5] += np.add(*track_waits_s(layer, path.ring[tracks], island, heat))
    rows[spot, 4], rows[line, 4] = 0.0, power_shares(path, heat, config)
    return HeatPath(rows, np.repeat(layer, sizes + 1), np.repeat(island, sizes + 1))


NAME = "ebamcheck"  # Name of the simulation, with which its result files begin
# The file that names all others, and the one with the threads.
INPUT, SETTINGS = "ParamInput.txt", "Settings.txt"
MODE, DOMAIN, POINTS = "Mode.txt", "Domain.txt", "Points.txt"  # When, and where, temperatures are wanted
# Shares of the time of the path, %, at which a case without places gives a picture of the surface.
PICTURES = (25, 50, 75, 100)
MARGIN = 4.0  # Metal beside the path, in bead widths
Group = Mapping[str, object]


@dataclass(frozen=True)
class Mirrors:
    """Planes that let no heat through, mm: a box around the part instead of a half space; without `z` it has no base."""

    x: tuple[float, float]
    y: tuple[float, float]
    z: float | None = None

    def group(self) -> Group:
        """Keywords of the domain."""
        ends = {"X_min": self.x[0], "X_max": self.x[1], "Y_min": self.y[0], "Y_max": self.y[1]}
        planes = {**ends, **({} if self.z is None else {"Z_min": self.z})}
        # Mirrors of mirrors: with half as many, a plate of 150 x 80 mm misses 5 % of its heat after five minutes.
        return {**{name: METRES * place for name, place in planes.items()}, "Reflections": 4}


def thesis_files(rows: Floats, config: Config) -> dict[str, str]:
    """Return all files of a case but its path, by name; it gives pictures of the surface at :data:`PICTURES`."""
    step_m = METRES * config.process.bead_width_mm / 2.0
    places = rows[:, 1:4] if len(rows) else np.zeros((1, 3))
    margin = np.array([MARGIN, MARGIN, 0.0]) * config.process.bead_width_mm
    low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
    # The box stands on its base plate, deep below the lowest layer.
    low[2] = low[2] - config.layer_height_mm - config.process.base_plate_mm
    ends = zip(low.tolist(), high.tolist(), strict=True)
    x, y, z = ({"Min": METRES * least, "Max": METRES * most} for least, most in ends)
    return {
        **physics(config),
        MODE: groups({"Snapshots": {"ScanFracs": ",".join(map(str, PICTURES)), "Tracking": "None"}}),
        DOMAIN: groups({"X": {**x, "Res": step_m}, "Y": {**y, "Res": step_m}, "Z": {**z, "Num": 1}}),
    }


def physics(config: Config) -> dict[str, str]:
    """Return the files that are the same whenever and wherever temperatures are wanted."""
    process, material = config.process, config.material
    # Its standard deviation is that of our nonlinear model; its heat counts as ended at sqrt(6) of them.
    width_m = METRES * (BEAM_SHARE * process.bead_width_mm * math.sqrt(6.0))
    simulation = {"Name": NAME, **{n: f"{n}.txt" for n in ("Mode", "Material", "Beam", "Path")}}
    options = {n: f"{n}.txt" for n in ("Domain", "Output", "Settings")}
    constants = {
        "T_0": process.ambient_temperature_k,
        "T_L": material.liquidus_k,
        "k": material.conductivity_w_mk,
        "c": material.heat_capacity_j_kgk,
        "p": material.density_kg_m3,
    }
    shape = {"Width_X": width_m, "Width_Y": width_m, "Depth_Z": METRES * config.layer_height_mm}
    intensity = {"Power": process.power_w, "Efficiency": material.absorptivity}
    return {
        INPUT: groups({"Simulation": simulation, "Options": options}),
        "Material.txt": groups({"Constants": constants}),
        "Beam.txt": groups({"Shape": shape, "Intensity": intensity}),
        "Output.txt": groups({"Grid": {"x": 1, "y": 1, "z": 1}, "Temperature": {"T": 1, "T_hist": 0}}),
        # Its own default is half of the threads of the machine, which is none on a machine of one.
        SETTINGS: groups({"Compute": {"MaxThreads": 4}}),
        "run.sh": '#!/bin/sh\n# @status@\ncd "$(dirname "$0")" && exec "${EBAMCHECK_3DTHESIS:-3DThesis}" ParamInput.txt\n',
    }


def readings(times_s: Sequence[float], places: Floats, mirrors: Mirrors | None = None) -> dict[str, str]:
    """Files that ask for the temperatures at places (P, 3), mm, at each of the times; of a half space without mirrors."""
    times = ",".join(f"{time:.9g}" for time in times_s)
    points = "".join(f"{x:.6f}\t{y:.6f}\t{z:.6f}\n" for x, y, z in places.tolist())
    sides = {"BoundaryConditions": mirrors.group()} if mirrors else {}
    return {
        MODE: groups({"Snapshots": {"Times": times, "Tracking": "None"}}),
        DOMAIN: groups(sides | {"Custom": {"File": POINTS}}),
        # Few places a time: threads would wait for each other.
        SETTINGS: groups({"Compute": {"MaxThreads": 1}}),
        POINTS: f"X(mm)\tY(mm)\tZ(mm)\t@status@\n{points}",
    }


def groups(texts: Mapping[str, Group]) -> str:
    """Write groups of keywords; the status goes into the first line, which has no keyword."""
    text = "# @status@\n"
    for name, group in texts.items():
        text += f"{name}\n{{\n"
        for key, value in group.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"{value} is no number for a case")
            text += f"\t{key}\t{f'{value:.9g}' if isinstance(value, float) else value}\n"
        text += "}\n"
    return text
