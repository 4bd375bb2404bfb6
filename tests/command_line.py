"""The command line as a user starts it, and the small parts that its tests slice."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np

from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.mesh.stl import FACET

FAST = "planecut,manifold"
"""Two exact backends that start quickly."""

WIDE = {
    "wire_speed_min_mm_s": 1e-3,
    "wire_speed_max_mm_s": 1e4,
    "layer_over_bead": (1e-3, 100.0),
    "bead_section_mm2": (1e-3, 1e4),
    "metal_energy_j_mm3": (0.01, 1e6),
}
"""A process window of no machine: for tests whose layers are few because they are thick."""

WIDE_TOML = "\n".join(
    f"process.{name} = {list(value) if isinstance(value, tuple) else value}" for name, value in WIDE.items()
)


def ebamcheck(
    *arguments: object, cwd: Path, limit_bytes: int = 0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the program to its end; with a limit, no file of it can grow beyond that."""
    return subprocess.run(
        command(*arguments),
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=(lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes,) * 2))
        if limit_bytes
        else None,
    )


def command(*arguments: object) -> list[str]:
    start = "import sys; from ebamcheck.commands.main import main; sys.argv[0] = 'ebamcheck'; main()"
    return [sys.executable, "-c", start, *map(str, arguments)]


def write_stl(part: Part, path: Path) -> Path:
    facets = np.zeros(len(part.faces), FACET)
    facets["corners"] = part.vertices[part.faces]
    path.write_bytes(b"test".ljust(80) + np.uint32(len(facets)).tobytes() + facets.tobytes())
    return path


def frame() -> Part:
    """Plate of 40 x 40 x 12 mm with a hole of 14 x 16 mm; its section has 1376 mm2."""
    corners = [(0, 0), (40, 0), (40, 40), (0, 40), (13, 12), (27, 12), (27, 28), (13, 28)]
    faces = []
    for k in range(4):
        j = (k + 1) % 4
        faces += [(k, 4 + k, 4 + j), (k, 4 + j, j), (8 + k, 8 + j, 12 + j), (8 + k, 12 + j, 12 + k)]
        faces += [(k, j, 8 + j), (k, 8 + j, 8 + k), (4 + k, 12 + k, 12 + j), (4 + k, 12 + j, 4 + j)]
    return from_arrays([(*c, z) for z in (0, 12) for c in corners], faces, "frame")
