"""Small parts of a few layers, planned, and what is checked of their programs on every control."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ebamcheck.controls.gcode.writing import write_linuxcnc, write_plain_gcode
from ebamcheck.controls.sinumerik.writing import write_program
from ebamcheck.curves import fit
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.pipeline.stages import bead_paths, plan_program, smooth_layers
from ebamcheck.program import Check, verify_file
from ebamcheck.settings.config import Config

POSTS = {"sinumerik-840d-sl": write_program, "linuxcnc": write_linuxcnc, "plain-gcode": write_plain_gcode}
LAYERS = 4

BLOCK = shapely.box(0, 0, 56, 44).difference(shapely.Point(20, 22).buffer(7, 64))
"""A block with a cooling channel."""


def discs(k: int) -> shapely.geometry.base.BaseGeometry:
    """Two balls side by side, from their middles upwards."""
    return shapely.union_all(
        [shapely.Point(x, 0).buffer((r**2 - (1.7 * k) ** 2) ** 0.5, 64) for x, r in ((0, 22), (60, 16))]
    )


def tube(k: int) -> shapely.geometry.base.BaseGeometry:
    """The upper half of a torus that lies flat."""
    half = (15.0**2 - (1.7 * k) ** 2) ** 0.5
    return shapely.Point(0, 0).buffer(28 + half, 64).difference(shapely.Point(0, 0).buffer(28 - half, 64))


SHAPES = {
    "cube": lambda k: shapely.box(0, 0, 30, 30),
    "block with a channel": lambda k: BLOCK,
    "two spheres": discs,
    "torus": tube,
}


@dataclass(frozen=True, eq=False)
class Made:
    """A part as planned."""

    config: Config
    sections: Layers
    plan: object
    beads: object

    def on(self, control: str) -> Config:
        """Settings for a control."""
        return self.config.changed(machine={"control": control})

    def by(self, **sections: dict[str, Any]) -> Made:
        """The same part by other settings."""
        return replace(self, config=self.config.changed(**sections))


def made(shape: str) -> Made:
    """Plan a part; the order matters nothing here."""
    config = Config().changed(
        scan={"order": "raster"},
        process={"interpass": "off"},
        machine={"travel_min_mm": (-1000.0, -1000.0, 0.0)},
    )
    heights = (np.arange(LAYERS) + 0.5) * config.layer_height_mm
    sections = from_polygons(heights, [list(shapely.get_parts(SHAPES[shape](k))) for k in range(LAYERS)])
    smooth = smooth_layers(fit(sections, config.curves.method, config.curves))
    plan = plan_program(smooth, config)
    return Made(config, sections, plan, bead_paths(smooth, plan, config))


def written(part: Made, control: str, folder: Path) -> Path:
    """Main file of a part's program."""
    return POSTS[control](part.beads, part.plan, part.on(control), folder).main


def checks_of(main: Path, part: Made, control: str, planned: bool) -> dict[str, Check]:
    """Checks by name: against the plan, or of text and part alone."""
    given = {"curves": part.beads, "plan": part.plan} if planned else {"beads": True, "metal": True}
    checks = verify_file(main, config=part.on(control), layers=part.sections, **given)
    return {check.name: check for check in checks}
