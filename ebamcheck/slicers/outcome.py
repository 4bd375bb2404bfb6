"""What becomes of a backend that slices: its file of layers and figures, or why it has none."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ebamcheck.backend import Probe
from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck.layers.stack import Layers

Failure = Literal["", "unavailable", "refused", "crashed", "timed out", "out of memory", "killed"]
"""What can become of a backend but success."""


@dataclass(frozen=True)
class Limits:
    """What a backend's process may use, and how many there are at a time."""

    time_s: float = 600.0
    memory_mb: float = 8192.0
    processes: int | None = None
    """Processes side by side; None: as many as there are cores."""


@dataclass(frozen=True)
class Outcome:
    """What became of one backend."""

    name: str
    failure: Failure = ""
    why: str = ""
    file: Path | None = None
    """Where its layers lie; None where it failed."""
    probe: Probe = field(default_factory=lambda: Probe(False))
    error_bound_mm: float = 0.0
    height_bound_mm: float = 0.0
    rings: int = 0
    open_paths: int = 0
    points: int = 0
    prepare_s: float = 0.0
    slice_s: float = 0.0
    compile_s: float = 0.0
    """Time in which kernels were compiled; it is in none of the others."""
    peak_mb: float = 0.0

    def made(self) -> Path:
        """File of its layers; raises what it failed of."""
        if self.file is None:
            kind = BackendMissing if self.failure == "unavailable" else BackendFailed
            raise kind(f"backend {self.name!r} {self.failure}: {self.why}")
        return self.file

    def read(self) -> Layers:
        """Read all its layers; raises what it failed of."""
        from ebamcheck.layers.files import read_parquet

        return read_parquet(self.made())
