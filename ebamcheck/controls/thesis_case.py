"""Cases of 3DThesis: the analytic heat of a moving Gaussian beam on a half space of constant material data.

Every layer heats a half space under itself, without the sides of the part: one layer at a time is what it is for.
Keywords as its ``Init.cpp`` reads them: groups in braces, lengths in metres; paths and points in millimetres.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ebamcheck.heat.medium import BEAM_SHARE
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config

NAME = "ebamcheck"
"""Name of the simulation, with which its result files begin."""

INPUT, SETTINGS = "ParamInput.txt", "Settings.txt"
"""The file that names all others, and the one with the threads."""

MODE, DOMAIN, POINTS = "Mode.txt", "Domain.txt", "Points.txt"
"""When, and where, temperatures are wanted."""

METRES = 1e-3

ENDS = ("min", "max")

PICTURES = (25, 50, 75, 100)
"""Shares of the time of the path, %, at which a case without places gives a picture of the surface."""

GRID_CELLS = 2.0
"""Points of that picture across a bead."""

THREADS = 4
"""Threads: its own default is half of those of the machine, which is none on a machine of one."""

REFLECTIONS = 4
"""Mirrors of mirrors that count: with half as many, a plate of 150 x 80 mm misses 5 % of its heat after five minutes."""

Group = Mapping[str, object]


@dataclass(frozen=True)
class Mirrors:
    """Planes that let no heat through, mm: a box around the part instead of a half space; without `z` it has no base."""

    x: tuple[float, float]
    y: tuple[float, float]
    z: float | None = None

    def group(self) -> Group:
        """Keywords of the domain."""
        planes = {
            f"{a}_{e}": METRES * v
            for a, b in (("X", self.x), ("Y", self.y))
            for e, v in zip(ENDS, b, strict=True)
        }
        base = {} if self.z is None else {"Z_min": METRES * self.z}
        return {**planes, **base, "Reflections": REFLECTIONS}


def thesis_files(rows: Floats, config: Config) -> dict[str, str]:
    """Return all files of a case but its path, by name; it gives pictures of the surface at :data:`PICTURES`."""
    block, step_m = Block.around(rows, config), METRES * config.process.bead_width_mm / GRID_CELLS
    x, y, z = (
        {"Min": METRES * low, "Max": METRES * high} for low, high in zip(block.low, block.high, strict=True)
    )
    return {
        **physics(config),
        MODE: groups({"Snapshots": {"ScanFracs": ",".join(map(str, PICTURES)), "Tracking": "None"}}),
        DOMAIN: groups({"X": {**x, "Res": step_m}, "Y": {**y, "Res": step_m}, "Z": {**z, "Num": 1}}),
    }


def physics(config: Config) -> dict[str, str]:
    """Return the files that are the same whenever and wherever temperatures are wanted."""
    source, material = HeatSource.of(config), config.material
    width_m = METRES * source.radius_mm(EDGE)
    return {
        INPUT: groups(
            {
                "Simulation": {"Name": NAME, **{n: f"{n}.txt" for n in ("Mode", "Material", "Beam", "Path")}},
                "Options": {n: f"{n}.txt" for n in ("Domain", "Output", "Settings")},
            }
        ),
        "Material.txt": groups(
            {
                "Constants": {
                    "T_0": config.process.ambient_temperature_k,
                    "T_L": material.liquidus_k,
                    "k": material.conductivity_w_mk,
                    "c": material.heat_capacity_j_kgk,
                    "p": material.density_kg_m3,
                }
            }
        ),
        "Beam.txt": groups(
            {
                "Shape": {"Width_X": width_m, "Width_Y": width_m, "Depth_Z": METRES * source.depth_mm},
                "Intensity": {"Power": source.power_w, "Efficiency": source.absorptivity},
            }
        ),
        "Output.txt": groups({"Grid": {"x": 1, "y": 1, "z": 1}, "Temperature": {"T": 1, "T_hist": 0}}),
        SETTINGS: _settings(THREADS),
        "run.sh": '#!/bin/sh\n# @status@\ncd "$(dirname "$0")" && exec "${EBAMCHECK_3DTHESIS:-3DThesis}" ParamInput.txt\n',
    }


def readings(times_s: Sequence[float], places: Floats, mirrors: Mirrors | None = None) -> dict[str, str]:
    """Files that ask for the temperatures at places (P, 3), mm, at each of the times; of a half space without mirrors."""
    times = ",".join(f"{time:.9g}" for time in times_s)
    points = "".join(f"{x:.6f}\t{y:.6f}\t{z:.6f}\n" for x, y, z in places.tolist())
    return {
        MODE: groups({"Snapshots": {"Times": times, "Tracking": "None"}}),
        DOMAIN: groups(
            {**({"BoundaryConditions": mirrors.group()} if mirrors else {}), "Custom": {"File": POINTS}}
        ),
        # Few places a time: threads would wait for each other.
        SETTINGS: _settings(1),
        POINTS: f"X(mm)\tY(mm)\tZ(mm)\t@status@\n{points}",
    }


def snapshot(number: int) -> str:
    """Name of the file with the temperatures at a time, in the folder ``Data``: x, y, z in metres, and T in K."""
    return f"{NAME}.Snapshot.{number:02d}.csv"


def _settings(threads: int) -> str:
    return groups({"Compute": {"MaxThreads": threads}})


def groups(texts: Mapping[str, Group]) -> str:
    """Write groups of keywords; the status goes into the first line, which has no keyword."""
    blocks = (
        name + "\n{\n" + "".join(f"\t{key}\t{_word(value)}\n" for key, value in group.items()) + "}\n"
        for name, group in texts.items()
    )
    return "# @status@\n" + "".join(blocks)


def _word(value: object) -> str:
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{value} is no number for a case")
        return f"{value:.9g}"
    return str(value)


EDGE = math.exp(-3.0)
"""Intensity of the beam over that of its middle where its heat counts as ended: at sqrt(6) standard deviations."""

MARGIN = 4.0
"""Metal beside the path, in bead widths."""


@dataclass(frozen=True)
class HeatSource:
    """A Gaussian beam that heats the layer that it lays.

    Parameters
    ----------
    sigma_mm
        Standard deviation in the plane: ``BEAM_SHARE`` of the bead.
    depth_mm
        Depth at which the heat has fallen to :data:`EDGE`: the height of a layer, in which our own models set it free.
    power_w, absorptivity
        Power of the beam at full power, and the share of it that the part takes up.
    """

    sigma_mm: float
    depth_mm: float
    power_w: float
    absorptivity: float

    @classmethod
    def of(cls, config: Config) -> HeatSource:
        """Beam of a profile."""
        process = config.process
        return cls(
            BEAM_SHARE * process.bead_width_mm,
            config.layer_height_mm,
            process.power_w,
            config.material.absorptivity,
        )

    @property
    def sigma_z_mm(self) -> float:
        """Standard deviation downwards."""
        return self.depth_mm / math.sqrt(6.0)

    def radius_mm(self, share: float) -> float:
        """Radius at which the intensity has fallen to a share of that of the middle."""
        return self.sigma_mm * math.sqrt(-2.0 * math.log(share))


@dataclass(frozen=True)
class Block:
    """The box in which a path is simulated: (3,) least and greatest X, Y, Z, mm; it stands on its base plate."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @classmethod
    def around(cls, rows: Floats, config: Config) -> Block:
        """Box around rows (n, 6) of a path: a base plate deep below the lowest layer, up to the highest."""
        places = rows[:, 1:4] if len(rows) else np.zeros((1, 3))
        margin = MARGIN * config.process.bead_width_mm
        low, high = places.min(axis=0), places.max(axis=0)
        bottom = low[2] - config.layer_height_mm - config.process.base_plate_mm
        return cls(
            (float(low[0] - margin), float(low[1] - margin), float(bottom)),
            (float(high[0] + margin), float(high[1] + margin), float(high[2])),
        )
