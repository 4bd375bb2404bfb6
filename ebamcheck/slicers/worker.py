"""A worker process, ``python -m ebamcheck.slicers.worker LABEL PIPE PARENT``: JSON order on stdin, JSON events in the pipe."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from ebamcheck.layers.files import KeptBlocks
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry
from ebamcheck.plugins.processes import die_with
from ebamcheck.plugins.trial import probed
from ebamcheck.slicers.cutting import cut


class Order(TypedDict):
    """What a worker is to do."""

    backend: str
    folder: str  # where part, heights and borders of the blocks lie
    file: str  # where the layers go
    settings: dict[str, Any]
    bounds_only: bool  # tell the bounds and slice nothing
    keep_blocks: (
        bool  # whether a block that is cut is kept beside the file until that is whole, for a run that is killed
    )


def write_part(folder: Path, part: Part) -> None:
    """Write a part as plain columns, the fastest that another process can read."""
    np.save(folder / "vertices.npy", part.vertices)
    np.save(folder / "faces.npy", part.faces)
    names = ("name", "source", "source_sha256", "units", "units_from", "direction", "sha256")
    labels = {name: getattr(part, name) for name in names}
    (folder / "part.json").write_text(json.dumps(labels), encoding="utf-8")


def read_part(folder: Path) -> Part:
    """Read a part from the columns that :func:`write_part` wrote."""
    labels = json.loads((folder / "part.json").read_text(encoding="utf-8"))
    sha256, labels["direction"] = labels.pop("sha256"), tuple(labels["direction"])
    # Read whole, not mapped: compiled kernels know plain arrays only.
    part = Part(np.load(folder / "vertices.npy"), np.load(folder / "faces.npy"), **labels)
    part.__dict__["sha256"] = sha256
    return part


def _work(order: Order, tell: Callable[..., None]) -> None:
    folder, file = Path(order["folder"]), Path(order["file"])
    slicer = registry.loaded_slicer(order["backend"])
    probe = probed(slicer)
    tell(probe={**asdict(probe), "versions": dict(probe.versions)})
    if not probe.available:
        tell(failure="unavailable", why=f"{probe.why}{f'; {probe.hint}' if probe.hint else ''}")
        return
    settings = slicer.Settings.model_validate(order["settings"])
    part = read_part(folder)
    heights = np.load(folder / "heights.npy")
    tell(
        error_bound_mm=float(slicer.error_bound_mm(part, settings)),
        height_bound_mm=float(slicer.height_bound_mm(part, settings)),
    )
    if order["bounds_only"]:
        return
    borders = np.load(folder / "borders.npy")
    # A single block is as good as the whole file.
    keep = order["keep_blocks"] and borders.size > 2
    blocks = KeptBlocks(file, part.sha256, order["backend"]) if keep else None
    if not cut(slicer, part, settings, heights, borders, file, tell, blocks):
        return
    if blocks is not None:
        blocks.remove()
    tell(peak_mb=_peak_mb())


def _peak_mb() -> float:
    """Largest resident memory of this process, MB (what ``getrusage`` tells includes the parent before the exec)."""
    with contextlib.suppress(OSError), open("/proc/self/status", encoding="ascii") as status:
        for line in status:
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    return 0.0


@contextlib.contextmanager
def _teller(pipe: int) -> Iterator[Callable[..., None]]:
    """A function that writes its keywords as one JSON line; progress is thinned to a few lines a second."""
    pending = 0
    last = 0.0
    with os.fdopen(pipe, "wb", buffering=0) as out:

        def tell(**event: Any) -> None:
            nonlocal pending, last
            if "done" in event:
                pending += event["done"]
                if time.monotonic() - last < 0.05:
                    return
                last, event, pending = time.monotonic(), {"done": pending}, 0
            elif pending:
                out.write(json.dumps({"done": pending}).encode() + b"\n")
                pending = 0
            out.write(json.dumps(event).encode() + b"\n")

        yield tell


def main(arguments: Sequence[str]) -> int:
    """Entry point: a label, descriptor of the event pipe, the parent's id; one order comes on standard input."""
    _, pipe, parent = arguments
    die_with(int(parent))
    line = sys.stdin.readline()
    # A worker whose parent is gone, or has no order for it, gets no answer any more and must not run on.
    if line:
        with _teller(int(pipe)) as tell, contextlib.suppress(BrokenPipeError):
            _work(json.loads(line), tell)
    return 0


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stdout.flush()
    # Nothing is left to free: the interpreter's own farewell takes as long as a small part.
    os._exit(code)
