"""The stack of a finished run: its settings, the paths of its contour beads, and its scan plan."""

from __future__ import annotations

from pathlib import Path

from ebamcheck.commands.options import settings_of
from ebamcheck.curves import Curves
from ebamcheck.errors import InputError
from ebamcheck.record.run_folder import MANIFEST, RunFolder
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config, validated


def stack_of_run(folder: Path, config_file: Path | None) -> tuple[Config, Curves, ScanPlan, str]:
    """Settings, bead paths and plan of a run; other settings only where a file names them."""
    run = RunFolder(folder)
    manifest = run.manifest()
    config = (
        settings_of(config_file, "", "", None) if config_file else validated(manifest["settings"], MANIFEST)
    )
    beads, plan = folder / "beads.parquet", folder / "scan.parquet"
    if not beads.is_file() or not plan.is_file():
        raise InputError(f"{folder}: has no bead paths: make it with `ebamcheck run`, not `check`")
    return (
        config,
        Curves.from_parquet(beads),
        ScanPlan.from_parquet(plan),
        str(manifest["part"]["sha256"]),
    )
