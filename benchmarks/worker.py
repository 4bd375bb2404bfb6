"""The fresh process of one measurement: ``python -m benchmarks.worker FOLDER``.

It reads ``request.json`` in the folder, makes the file ``began`` when it is warm and the clock may start, and
writes ``answer.json``.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

Begin = Callable[[], None]
"""Called when everything is warm: what is compiled once has been compiled."""

TASKS = {
    "time": "benchmarks.timing:time_method",
    "overlaps": "benchmarks.overlap_cost:clean_part",
    "unions": "benchmarks.overlap_cost:unions",
    "latency": "benchmarks.latency:latency",
    "bitmaps": "benchmarks.bitmaps:bitmaps",
    "crossings": "benchmarks.crossings:crossings",
    "drawing": "benchmarks.drawing:drawing",
}


def main(folder: Path) -> None:
    """Do what the request in the folder says."""
    request: dict[str, Any] = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    module, function = TASKS[request.pop("task")].split(":")
    task: Callable[..., dict[str, Any]] = getattr(import_module(module), function)
    answer = task(begin=(folder / "began").touch, **request)
    (folder / "answer.json").write_text(json.dumps(answer), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
