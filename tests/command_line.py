"""The command line as a user starts it, and the small parts that its tests slice."""

from __future__ import annotations

import io
import logging
import os
import resource
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

from ebamcheck.commands.main import main
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
    """Run the program to its end: in this process, which spares its start, unless it has an environment or limit of its own."""
    if environment or limit_bytes:
        return started(*arguments, cwd=cwd, limit_bytes=limit_bytes, **environment)
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8") for _ in range(2))
    with _as_found(), redirect_stdout(out), redirect_stderr(err):
        os.chdir(cwd)
        sys.argv = ["ebamcheck", *map(str, arguments)]
        try:
            main()
        except SystemExit as left:
            code = int(left.code or 0)
    out.seek(0)
    err.seek(0)
    return subprocess.CompletedProcess(arguments, code, out.read(), err.read())


@contextmanager
def _as_found() -> Iterator[None]:
    """Leave the process as a command has found it, and warn as a process of its own does: once, and without raising."""
    folder, argv, variables = Path.cwd(), sys.argv, dict(os.environ)
    ends, wording = signal.getsignal(signal.SIGTERM), warnings.formatwarning
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    root.handlers.clear()
    try:
        with warnings.catch_warnings():
            warnings.resetwarnings()
            for quiet in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
                warnings.simplefilter("ignore", quiet)
            try:
                yield
            finally:
                logging.captureWarnings(capture=False)
    finally:
        root.handlers[:] = handlers
        root.setLevel(level)
        warnings.formatwarning = wording
        signal.signal(signal.SIGTERM, ends)
        os.environ.clear()
        os.environ.update(variables)
        sys.argv = argv
        os.chdir(folder)


def started(
    *arguments: object, cwd: Path, limit_bytes: int = 0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the program to its end as a process of its own; with a limit, no file of it can grow beyond that."""
    return subprocess.run(
        command(*arguments),
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=(lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes,) * 2)) if limit_bytes else None,
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
