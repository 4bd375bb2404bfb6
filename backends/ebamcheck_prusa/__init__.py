"""The program PrusaSlicer as a slicer: an independent check, read from the images that it writes for printers that cure a layer at
a time.

In these a pixel is white if material covers half of it; the paths of its G-code are offset inwards.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np

from ebamcheck.backend import BackendSettings, CoplanarRule, Probe, labels_of
from ebamcheck.errors import BackendFailed, SettingsError
from ebamcheck.kernels import Bools, Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.stl import write_triangles
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.base import Between
from ebamcheck.slicers.outside import lattices
from ebamcheck.slicers.outside.lattices import Lattice, LatticeStack, Placement, Program, ProgramSettings

PROGRAM = Program(
    name="PrusaSlicer", command="prusa-slicer", variable="EBAMCHECK_PRUSA_SLICER", package="prusa-slicer",
    version_arguments=("--help",), version_pattern=r"PrusaSlicer-(\d+\.\d+\.\d\S*)",
)  # fmt: skip

# Larger side of the part as PrusaSlicer gets it, mm: between half of this and this. Its integers of 1e-6 mm have 32 bits
WORKING_SIZE = 128.0
TALLEST = 1024.0  # largest height of the part as PrusaSlicer gets it, mm, for the same reason
# Layer heights are this times powers of two, mm: sums over many layers are exact, and rounded to steps of 1e-6 mm only once
LENGTH_UNIT = 2.0**-20
DEFAULT_PIXELS = 1024  # default number of pixels along the larger side of the part: as in the paper's images
LARGEST_IMAGE = 16384  # most pixels along a side of an image: the program's memory grows with the square
MARGIN_PIXELS = 4  # empty pixels around the part

# Farthest, in pixels, that a contour is off: a point of a cell of marching squares lies within sqrt(10)/4 of the nearest pixel centre of
# its side, and a disc about it that covers half of that pixel has a radius of 0.850; coverage is counted in steps of 1/256
CONTOUR_REACH = 0.87


class PrusaSettings(ProgramSettings):
    """Settings of the backend ``prusa``."""

    pixel_mm: Annotated[float, Between(1e-7, 1000.0)] | None = None
    """Side of a pixel; None: 1/1024 of the larger side of the part."""


class Prusa:
    """Contours of images; open meshes and parts of negative volume, which PrusaSlicer mends silently, are refused."""

    name: ClassVar[str] = "prusa"
    summary: ClassVar[str] = "witness: the program PrusaSlicer (images of an SL1 archive); refuses open meshes"
    exact: ClassVar[bool] = False
    priority: ClassVar[int] = -40
    coplanar_rule: ClassVar[CoplanarRule] = "undefined"
    inside_rule: ClassVar[str] = "winding > 0"
    Settings: ClassVar[type[BackendSettings]] = PrusaSettings

    def probe(self) -> Probe:
        """Whether PrusaSlicer is installed, and its version."""
        return PROGRAM.probe()

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return 0.87 pixels and the rounding of coordinates to 32 bits, mm."""
        pixel = pixel_mm(part, PrusaSettings.own(settings, self.name))
        return CONTOUR_REACH * pixel + 4.0 * lattices.coordinate_rounding_mm(part)

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the rounding of heights to 32 bits and to steps of 1e-6 of PrusaSlicer's mm."""
        return 3.0 * lattices.height_rounding_mm(part) + 8.0e-6 * float(part.size[2]) / TALLEST

    def prepare(self, part: Part, settings: BackendSettings) -> LatticeStack:
        """Look for the program; it runs when heights are known."""
        PROGRAM.path()
        lattices.refuse_what_is_mended(part, PROGRAM.name)
        own = PrusaSettings.own(settings, self.name)
        own = own.model_copy(update={"pixel_mm": pixel_mm(part, own)})
        pixels = image_pixels(part, own)
        if max(pixels) > LARGEST_IMAGE:
            raise SettingsError(
                f"prusa: pixel_mm {own.pixel_mm:g} makes images of {max(pixels)} pixels, over the limit "
                f"of {LARGEST_IMAGE}: give a larger one"
            )
        return LatticeStack(part, labels_of(part, self.name, own.model_dump()), partial(_cut, part, own))


def pixel_mm(part: Part, settings: PrusaSettings) -> float:
    """Side of a pixel for a part, mm: the setting, or its default."""
    if settings.pixel_mm is not None:
        return settings.pixel_mm
    return (float(part.size[:2].max()) or 1.0) / DEFAULT_PIXELS


def image_pixels(part: Part, settings: PrusaSettings) -> tuple[int, int]:
    """Numbers of columns and rows of an image: even, and enough for the part and a margin."""
    pixel = pixel_mm(part, settings)
    width, height = (2 * (math.ceil(0.5 * s / pixel) + MARGIN_PIXELS) for s in part.size[:2].tolist())
    return width, height


def _cut(part: Part, settings: PrusaSettings, lattice: Lattice) -> Layers:
    """Run PrusaSlicer on a part for the planes of a lattice."""
    scale = lattices.scale_to(part, WORKING_SIZE)
    placement = Placement(part, lattice, scale, LENGTH_UNIT)
    layer = math.ldexp(1.0, math.floor(math.log2(TALLEST / placement.layer_count)))
    placement = replace(placement, layer=layer)
    pixel, pixels = pixel_mm(part, settings) * scale, image_pixels(part, settings)
    # The middle of the part's box goes to the middle of the images.
    shift = 0.5 * (part.size[:2] * scale - pixel * np.array(pixels))
    with scratch_folder() as folder:
        write_triangles(placement.triangles() - (*shift.tolist(), 0.0), folder / "part.stl")
        (folder / "printer.ini").write_text(_printer(layer, pixel, pixels), encoding="ascii")
        said = PROGRAM.run(ARGUMENTS, folder, settings.time_limit_s)
        archive = folder / "part.sl1"
        if not archive.exists():
            raise PROGRAM.failed(f"wrote no images of part {part.name!r}", said)
        found = {
            number: [ring * pixel + shift for ring in contours(solid)]
            for number, solid in archived_images(archive)
            if 0 <= number - placement.first_layer < lattice.count
        }
    if len(found) < lattice.count:
        raise BackendFailed(f"PrusaSlicer wrote {len(found)} of {lattice.count} layers of part {part.name!r}")
    return placement.layers(found)


# Command line; with it the part stays where the file puts it
ARGUMENTS = (
    "--datadir=.", "--loglevel=0", "--export-sla", "--load=printer.ini", "--dont-arrange", "--output=part.sl1", "part.stl",
)  # fmt: skip


def _printer(layer: float, pixel: float, pixels: tuple[int, int]) -> str:
    """Settings of a printer whose display holds the part: no support, no compensation, no grey pixel."""
    width, height = (pixel * count for count in pixels)
    return f"""\
printer_technology = SLA
layer_height = {layer:.20f}
initial_layer_height = {layer:.20f}
max_print_height = {4.0 * TALLEST}
bed_shape = 0x0,{width!r}x0,{width!r}x{height!r},0x{height!r}
display_width = {width!r}
display_height = {height!r}
display_pixels_x = {pixels[0]}
display_pixels_y = {pixels[1]}
display_orientation = landscape
display_mirror_x = 0
display_mirror_y = 0
gamma_correction = 0
slice_closing_radius = 0
slicing_mode = regular
absolute_correction = 0
elefant_foot_compensation = 0
relative_correction = 1,1
relative_correction_x = 1
relative_correction_y = 1
relative_correction_z = 1
material_correction = 1,1,1
supports_enable = 0
support_object_elevation = 0
pad_enable = 0
hollowing_enable = 0
thumbnails =
"""


# -- Images of layers in an SL1 archive, a zip file with a grey PNG image for each, 255 where there is material -------

_IMAGE = re.compile(r"\D*(\d+)\.png")


def archived_images(path: Path) -> Iterator[tuple[int, Bools]]:
    """Number of each layer and mask (H, W) of its solid pixels, rows upwards; :class:`BackendFailed` where they cannot be read."""
    try:
        with zipfile.ZipFile(path) as archive:
            for name in sorted(archive.namelist()):
                if match := _IMAGE.fullmatch(name):
                    yield int(match[1]), solid_pixels(archive.read(name))
    except (OSError, zipfile.BadZipFile, zlib.error) as error:
        raise BackendFailed(f"the archive that PrusaSlicer wrote cannot be read: {error}") from None


def solid_pixels(png: bytes) -> Bools:
    """Mask (H, W) of the pixels of an 8-bit grey PNG image that are brighter than half, with rows upwards."""
    from PIL.PngImagePlugin import PngImageFile

    try:
        # `Image.open` would refuse images as large as those of a wide part.
        image = PngImageFile(io.BytesIO(png))
        pixels = np.asarray(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise BackendFailed(f"an image that PrusaSlicer wrote is no PNG file: {error}") from None
    if image.mode != "L":
        raise BackendFailed("an image that PrusaSlicer wrote is not grey with 8 bits a pixel")
    bits: Bools = pixels[::-1] > 127
    return bits


def contours(solid: Bools) -> list[Floats]:
    """Rings (n, 2), closed, half way between solid and empty pixel centres, solid on the left, in pixels from the image's
    corner."""
    from skimage.measure import find_contours

    rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
    if not rows.size:
        return []
    row, column = int(rows[0]), int(columns[0])
    # A margin of empty pixels closes every contour.
    window = np.pad(solid[row : rows[-1] + 1, column : columns[-1] + 1], 1).astype(np.float64)
    found: list[Floats] = find_contours(  # type: ignore[no-untyped-call]
        window, 0.5, fully_connected="low", positive_orientation="low"
    )
    corner = np.array([column - 0.5, row - 0.5])
    return [_straight(ring[:, ::-1] + corner) for ring in found]


def _straight(ring: Floats) -> Floats:
    """Leave out the points inside straight runs of a ring of half pixels."""
    points = ring[:-1]
    ahead, behind = np.roll(points, -1, axis=0) - points, points - np.roll(points, 1, axis=0)
    corners = points[ahead[:, 0] * behind[:, 1] != ahead[:, 1] * behind[:, 0]]
    return np.concatenate([corners, corners[:1]])
