"""The parts that are measured: two series of eleven meshes of one solid, kept as STL files between runs.

``ladder``
    The reference model of that name at the paper's eleven tolerances. A tolerance alone makes tall and thin facets:
    31.1 million points at the top.
``even``
    The same solid with near-equilateral facets, as many as the paper's eleven file sizes hold: 9.0 million points at
    the top.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

import ebamcheck_models
from benchmarks import even_mesh
from ebamcheck.atomic_file import replacing
from ebamcheck.mesh.part import Part
from ebamcheck_models import LADDER, MODELS, write_stl
from ebamcheck_models.ring_wall import LAYER_MM
from ebamcheck_reports.paper import published

Series = Literal["ladder", "even"]
SERIES: tuple[Series, ...] = ("ladder", "even")

FOLDER = Path(__file__).parent / ".parts"
HEADER_BYTES, FACET_BYTES = 84, 50
SIZES = len(published.SIZES_MB)
TOP = SIZES
BASE_SIZE = 6
"""The size of some 38,000 facets, to which growth is related."""

DEMO_TOLERANCE_MM, DEMO_REFERENCE_MM = 0.1, 0.005
"""Of the demo part and its reference, as in the Makefile's target `demo`."""

SHUFFLE_SEED = 4
DIGEST_LETTERS = 8


@dataclass(frozen=True)
class BenchmarkPart:
    """A file to be sliced."""

    series: str
    size: int
    path: Path
    facets: int
    layer_mm: float

    @property
    def key(self) -> str:
        """Name in tables of raw figures."""
        return f"{self.series}-{self.size}"

    @property
    def bytes(self) -> int:
        """Size of the file."""
        return self.path.stat().st_size


def benchmark_part(series: Series, size: int, layer_mm: float = LAYER_MM) -> BenchmarkPart:
    """Return the part of a series of that size, 1 .. 11; it is made on the first call."""
    path = _kept(f"{series}-{size:02}", lambda: _make(series, size))
    return BenchmarkPart(series, size, path, facets_in(path), layer_mm)


def shuffled(part: BenchmarkPart) -> BenchmarkPart:
    """Return the same part with its facets in random order."""

    def make() -> bytes:
        data = part.path.read_bytes()
        facets = np.frombuffer(data, f"V{FACET_BYTES}", offset=HEADER_BYTES)
        order = np.random.default_rng(SHUFFLE_SEED).permutation(len(facets))
        return data[:HEADER_BYTES] + facets[order].tobytes()

    path = _kept(f"{part.series}-{part.size:02}-shuffled", make)
    return BenchmarkPart(f"{part.series}-shuffled", part.size, path, part.facets, part.layer_mm)


def model_file(name: str, tolerance_mm: float) -> Path:
    """Return the file of a reference model."""
    return _kept(f"{name}-{tolerance_mm:g}", lambda: MODELS[name].tessellate(tolerance_mm))


def facets_in(path: Path) -> int:
    """Facets of a binary STL file."""
    with path.open("rb") as file:
        return int.from_bytes(file.read(HEADER_BYTES)[80:], "little")


def sizes_of(text: str) -> tuple[int, ...]:
    """Read sizes as the command line gives them: numbers and ranges, 1 .. 11.

    Examples
    --------
    >>> sizes_of("1,6,9-11")
    (1, 6, 9, 10, 11)
    """
    found: set[int] = set()
    for item in text.split(","):
        first, _, last = item.partition("-")
        found.update(range(int(first), int(last or first) + 1))
    if not found or min(found) < 1 or max(found) > SIZES:
        raise ValueError(f"sizes {text!r}: give numbers and ranges from 1 to {SIZES}, such as 1,6,9-11")
    return tuple(sorted(found))


def _make(series: Series, size: int) -> Part:
    if series == "ladder":
        return LADDER.tessellate(published.tolerances_by_size()[size - 1])
    wanted = (published.SIZES_MB[size - 1] * 2**20 - HEADER_BYTES) / FACET_BYTES
    return even_mesh.even_mesh(LADDER, round(wanted))


def _kept(name: str, make: Callable[[], Part | bytes]) -> Path:
    """Return the file of that name, made where there is none by the code that is here now."""
    path = FOLDER / f"{name}-{_code_digest()}.stl"
    if not path.is_file():
        FOLDER.mkdir(exist_ok=True)
        for outdated in FOLDER.glob(f"{name}-{'?' * DIGEST_LETTERS}.stl"):
            outdated.unlink()
        made = make()
        if isinstance(made, Part):
            write_stl(made, path)
        else:
            with replacing(path) as temporary:
                temporary.write_bytes(made)
    return path


@cache
def _code_digest() -> str:
    """Hash of the code that makes parts, so that no file outlives it."""
    sources: Iterable[Path] = [
        *sorted(Path(ebamcheck_models.__file__).parent.glob("*.py")),
        Path(even_mesh.__file__),
    ]
    digest = hashlib.sha256()
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:DIGEST_LETTERS]
