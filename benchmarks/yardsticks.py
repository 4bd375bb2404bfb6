"""Two programs measured by themselves: manifold3d without its backend, and PrusaSlicer's slice stage."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import tempfile
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.errors import BackendFailed
from ebamcheck.kernels import Floats
from ebamcheck.mesh.part import Part

STAGE_BEGINS = "slice_mesh to polygons"
STAGE_ENDS = "Slicing volumes - removing top empty layers"
"""Lines of PrusaSlicer's log (level 4) between which it makes polygons of all layers from the mesh it has read and
repaired. What follows (perimeters, G-code) is no slicing in our sense: the process is ended there."""

_TIME = re.compile(r"^\[(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+)\]")

BED_MM = 2000
HIGHEST_MM = 1200
"""The tallest printer that PrusaSlicer believes in."""

NOZZLE_MM = 0.4


def manifold_alone(part: Part, heights: Floats) -> dict[str, Any]:
    """Time construct, slice and to_polygons of manifold3d on the vertices and facets of a part."""
    from manifold3d import Error, Manifold, Mesh64

    start = time.perf_counter()
    solid = Manifold(Mesh64(part.vertices, part.faces.astype(np.uint64)))
    if solid.status() != Error.NoError:
        raise BackendFailed(f"manifold3d refuses the part: {solid.status()}")
    ready = time.perf_counter()
    rings = points = 0
    for height in heights.tolist():
        found = solid.slice(height).to_polygons()
        rings += len(found)
        points += sum(len(ring) for ring in found)
    return {
        "prepare_s": ready - start,
        "slice_s": time.perf_counter() - ready,
        "layers": len(heights),
        "layers_cut": len(heights),
        "points": points,
        "rings": rings,
        "output_bytes": 16 * points,
    }


def prusa_stage(stl: Path, layer_mm: float) -> dict[str, Any]:
    """Time PrusaSlicer's slice stage by the stamps of its own log."""
    with tempfile.TemporaryDirectory(prefix="ebamcheck-prusa-") as folder:
        command = [
            "prusa-slicer", "--export-gcode", "--loglevel", "4", "--output", str(Path(folder, "out.gcode")),
            "--bed-shape", f"0x0,{BED_MM}x0,{BED_MM}x{BED_MM},0x{BED_MM}", "--max-print-height", str(HIGHEST_MM),
            "--dont-arrange", "--center", f"{BED_MM // 2},{BED_MM // 2}",
            "--layer-height", f"{layer_mm:g}", "--first-layer-height", f"{layer_mm:g}",
            "--nozzle-diameter", f"{max(NOZZLE_MM, 2.0 * layer_mm):g}",
            "--slice-closing-radius", "0", "--resolution", "0", "--slicing-mode", "regular",
            "--perimeters", "1", "--fill-density", "0", "--skirts", "0",
            "--top-solid-layers", "0", "--bottom-solid-layers", "0", str(stl),
        ]  # fmt: skip
        process = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors="replace", start_new_session=True,
        )  # fmt: skip
        try:
            assert process.stdout is not None
            stage_s = stage_seconds(process.stdout)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if process.stdout is not None:
                process.stdout.close()
    return {"load_s": 0.0, "prepare_s": 0.0, "slice_s": stage_s, "layers": 0, "layers_cut": 0}


def stage_seconds(log: Any) -> float:
    """Seconds between the two lines of a log that begin and end the slice stage.

    Raises
    ------
    BackendFailed
        If the log ends before that.
    """
    began: datetime | None = None
    line = ""
    for line in log:
        stamp = _TIME.match(line)
        if stamp is None:
            continue
        if began is None and STAGE_BEGINS in line:
            began = datetime.fromisoformat(stamp[1])
        elif began is not None and STAGE_ENDS in line:
            return (datetime.fromisoformat(stamp[1]) - began).total_seconds()
    raise BackendFailed(f"PrusaSlicer ended without a slice stage: {line.strip()[:200]}")
