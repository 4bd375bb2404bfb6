"""A program of a prism, and all that it was made from: the metal of programs is tested on it."""

import numpy as np

from ebamcheck.checks.metal import deposit
from ebamcheck.checks.metal_rules import deposit_checks
from ebamcheck.curves import Curves
from ebamcheck.layers.stack import from_polygons
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.pipeline.stages import bead_paths, plan_program
from ebamcheck.program import read_program, write_program
from ebamcheck.settings.config import Config

CONFIG = Config().changed(scan={"order": "raster"}, process={"interpass": "off"})


class Made:
    """A program of a prism, and all that it was made from."""

    def __init__(self, folder, section, config=CONFIG, layers=4):
        """Make it of one section, or of a list of one for each layer."""
        self.config = config
        heights = (np.arange(layers) + 0.5) * config.layer_height_mm
        self.layers = from_polygons(
            heights, [[s] for s in (section if isinstance(section, list) else [section] * layers)]
        )
        self.plan = plan_program(self.layers, config)
        self.beads: Curves = bead_paths(self.layers, self.plan, config)
        self.files = write_program(self.beads, self.plan, config, folder / "program")
        self.z = deposition_heights(heights, config.layer_height_mm)

    def read(self):
        return read_program(self.files.main, self.config)

    def checks(self, layers=None):
        nc = self.read()
        found = deposit(nc, layers or self.layers, self.z, self.config)
        return {check.name: check for check in deposit_checks(nc, found, self.config)}

    def failed(self, layers=None):
        return {name for name, check in self.checks(layers).items() if not check.passed}

    def edit(self, name, change):
        path = self.files.folder / name
        lines = path.read_text().split("\n")
        change(lines)
        path.write_text("\n".join(lines))
