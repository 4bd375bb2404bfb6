"""Reader of 3MF files: a look at the package first, then lib3mf in a process of its own, with limits."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError
from ebamcheck.mesh.part import FROM_FILE, FROM_FORMAT
from ebamcheck.mesh.polygons import checked_finite
from ebamcheck.mesh.three_mf_outline import outline_of
from ebamcheck.scratch import scratch_folder

LEAST_SECONDS, BYTES_A_SECOND = 20, 2_000_000
"""Processor time that lib3mf gets, at least and for its text: some ten times what it takes for sound files."""


def read_3mf(data: bytes | memoryview, name: str) -> tuple[NDArray[np.float64], list[str], str, str]:
    """Read the facets that a 3MF file builds.

    Parameters
    ----------
    data
        The whole file.
    name
        Its name, for messages.

    Returns
    -------
    triangles
        (F, 3, 3) corners as placed by the build, in the file's unit.
    notes
        What is not part of the solid and was left out, one line each.
    unit, unit_from
        Unit of the file by our short name, and whether the file states it; if not, it is the millimeter by the specification.

    Raises
    ------
    InputError
        If the file cannot be read exactly: damaged, of unknown unit or extension, with negative volumes, or too large.
    """
    outline = outline_of(data, name)
    with scratch_folder() as folder:
        (folder / "part.3mf").write_bytes(data)
        seconds = LEAST_SECONDS + outline.unpacked_bytes // BYTES_A_SECOND
        asked = {
            "file": str(folder / "part.3mf"),
            "corners": str(folder / "corners.npy"),
            "items": outline.items,
            "unprintable": outline.unprintable,
            "volumes": {f"{path}#{number}": rows for (path, number), rows in outline.volumes.items()},
            "marked": {
                " ".join(f"{path}#{number}" for path, number in keys): kind
                for keys, kind in outline.marked.items()
            },
            "seconds": seconds,
        }
        done = subprocess.run(
            [sys.executable, "-P", "-m", "ebamcheck.mesh.three_mf_meshes"],
            input=json.dumps(asked).encode(),
            capture_output=True,
            check=False,
        )
        if done.returncode:
            raise InputError(f"{name}: cannot be read as 3MF: {_why(done, seconds)}")
        told = json.loads(done.stdout)
        if "error" in told:
            raise InputError(f"{name}: cannot be read as 3MF: {told['error']}")
        corners = np.load(folder / "corners.npy")
    return (
        checked_finite(corners, name),
        told["notes"],
        outline.unit or "mm",
        FROM_FILE if outline.unit else FROM_FORMAT,
    )


def _why(done: subprocess.CompletedProcess[bytes], seconds: int) -> str:
    """Say how the process ended."""
    if done.returncode == -signal.SIGXCPU:
        return f"lib3mf takes more than {seconds} s of processor time for it"
    if done.returncode < 0:
        return f"lib3mf ended with {signal.Signals(-done.returncode).name}: the file is damaged, or needs too much memory"
    last = done.stderr.decode(errors="replace").strip().splitlines()
    return f"lib3mf cannot be used: {last[-1][:160] if last else f'exit code {done.returncode}'}"
