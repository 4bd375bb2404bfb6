"""Small parts as programs of every control, and the means to plant faults in their text."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import shapely

from ebamcheck.controls.gcode.writing import write_linuxcnc, write_plain_gcode
from ebamcheck.controls.sinumerik.writing import write_program
from ebamcheck.curves import fit
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.pipeline.stages import bead_paths, plan_program, smooth_layers
from ebamcheck.program import verify_file
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


@dataclass
class Text:
    """The lines of a program, in the order of its files."""

    folder: Path
    control: str
    lines: dict[str, list[str]] = field(default_factory=dict)

    @classmethod
    def of(cls, folder: Path, control: str) -> Text:
        """Read the files of a program."""
        return cls(folder, control, {p.name: p.read_text().split("\n") for p in sorted(folder.iterdir())})

    def save(self) -> None:
        """Write the files anew."""
        for name, lines in self.lines.items():
            (self.folder / name).write_text("\n".join(lines))

    @property
    def main(self) -> Path:
        """The file that is started."""
        return next(self.folder / name for name in self.lines if not name.endswith(".SPF"))

    def layer(self, k: int) -> tuple[str, int, int]:
        """File of a layer, and from which to which of its lines it stands."""
        if self.control == "sinumerik-840d-sl":
            name = f"MAIN_L{k + 1:04d}.SPF"
            return name, 0, len(self.lines[name])
        (name,) = self.lines
        begins = [i for i, line in enumerate(self.lines[name]) if line.startswith("; LAYER: ")]
        ends = next(i for i, line in enumerate(self.lines[name]) if line == "M2")
        return name, begins[k], [*begins, ends][k + 1]

    def find(self, k: int, pattern: str, nth: int = 0) -> tuple[str, int]:
        """File and index of the nth line of a layer that holds the pattern."""
        name, a, b = self.layer(k)
        return name, [i for i in range(a, b) if re.search(pattern, self.lines[name][i])][nth]

    def insert(self, name: str, at: int, blocks: list[str]) -> str:
        """Insert blocks before a line; their numbers rise, where there are any. The place of the first."""
        before = [re.match(r"N(\d+)", line) for line in self.lines[name][:at]]
        number = max((int(m[1]) for m in before if m), default=0)
        numbered = self.control == "sinumerik-840d-sl"
        self.lines[name][at:at] = [f"N{number + 1} {b}" if numbered and b[0] != ";" else b for b in blocks]
        if numbered:
            self.renumber(name)
        return f"{name}:{at + 1}"

    def renumber(self, name: str) -> None:
        """Give the blocks of a file rising numbers."""
        count = 0
        for i, line in enumerate(self.lines[name]):
            if re.match(r"N\d+ ", line):
                count += 10
                self.lines[name][i] = re.sub(r"^N\d+", f"N{count}", line)

    def switches(self) -> tuple[list[str], list[str]]:
        """Blocks that begin a bead and that end it, as the program has them."""
        name, i = self.find(0, r"beam on")
        _, j = self.find(0, r"beam off")
        plain = [re.sub(r"^N\d+ ", "", line) for line in self.lines[name]]
        return plain[i : i + 3], plain[j - 1 : j + 1]

    def bead(self, *points: tuple[float, float], comment: str = "") -> list[str]:
        """Blocks of a bead along points, at the height of the tool."""
        on, off = self.switches()
        (x, y), *further = points
        way = [f"G1 X{a:.6f} Y{b:.6f}{comment if i else ' F600'}" for i, (a, b) in enumerate(further)]
        return [f"G0 X{x:.6f} Y{y:.6f}", *on, *way, *off]

    def strip(self) -> None:
        """Delete all comments; the path of the work piece is none, a control reads it."""
        for name, lines in self.lines.items():
            kept = [line if line.startswith(";$PATH") else line.split(";")[0].rstrip() for line in lines]
            self.lines[name] = [new for new, old in zip(kept, lines, strict=True) if new or not old]


def checks_of(text: Text, part: Made, planned: bool):
    """Checks by name: against the plan, or of text and part alone."""
    config = part.config.changed(machine={"control": text.control})
    given = {"curves": part.beads, "plan": part.plan} if planned else {"beads": True, "metal": True}
    checks = verify_file(text.main, config=config, layers=part.sections, **given)
    return {check.name: check for check in checks}


def written(part: Made, control: str, folder: Path) -> Text:
    """Write a part's program."""
    config = part.config.changed(machine={"control": control})
    POSTS[control](part.beads, part.plan, config, folder)
    return Text.of(folder, control)
