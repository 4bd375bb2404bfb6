"""A run folder in the form that reports read; parts missing in a run that ended early are None or empty."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from ebamcheck.curves import Curves
from ebamcheck.errors import InputError
from ebamcheck.layers.files import LayerFile, read_parquet
from ebamcheck.layers.stack import Layers
from ebamcheck.record.certificate import Statement, statement
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config, validated
from ebamcheck_reports.markup import number

# Gates of a run in their order; a run without contours ends after the second
GATES = ("input", "agreement", "fit", "coverage", "deposit", "heat", "program")
CHECK_GATES = GATES[:2]  # Gates of a cross-check alone
BEAD_WIDTH_MM = 6.0  # Width at which beads are drawn if the settings name none

Column = TypeVar("Column")


class RunData:
    """Record, tables and columns of one run, each read when it is first asked for."""

    def __init__(self, folder: RunFolder) -> None:
        self.folder = folder

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """The record of the run, ``run.json``, from which everything else derives."""
        return self.folder.manifest()

    def part_of(self, name: str) -> Mapping[str, Any]:
        """One part of ``run.json``; empty if the run did not get so far."""
        found = self.manifest.get(name)
        return found if isinstance(found, dict) else {}

    @cached_property
    def config(self) -> Config:
        """Settings of the run."""
        return validated(self.manifest["settings"], "run.json")

    def setting(self, section: str, name: str, default: float) -> float:
        """One number of the settings, also of a run by another version that may not have it."""
        return number(self.part_of("settings").get(section, {}).get(name, default))

    @property
    def backends(self) -> Mapping[str, Mapping[str, Any]]:
        """Record of each backend."""
        return self.part_of("backends")

    @property
    def gates(self) -> list[Mapping[str, Any]]:
        """Gates that the run reached."""
        return list(self.manifest.get("gates", []))

    def gate_limit(self, name: str) -> float | None:
        """Limit of a gate; None if the run did not reach it."""
        return next((number(gate["limit"]) for gate in self.gates if gate["name"] == name), None)

    @property
    def missing_gates(self) -> list[str]:
        """Gates that the run did not reach."""
        reached = {gate["name"] for gate in self.gates}
        if GATES[-1] in reached:  # a run of an earlier version has fewer gates
            return []
        return [name for name in (CHECK_GATES if self.is_check else GATES) if name not in reached]

    @property
    def is_check(self) -> bool:
        """Whether only a cross-check was asked for, without a program."""
        return bool(self.manifest.get("job") == "check")

    @property
    def pairs(self) -> list[Mapping[str, Any]]:
        """Worst figures of each pair of backends."""
        return list(self.part_of("comparison").get("pairs", []))

    @property
    def disagreements(self) -> list[Mapping[str, Any]]:
        """Findings of the comparison: disagreements between methods."""
        return list(self.part_of("comparison").get("findings", []))

    @property
    def findings(self) -> list[Mapping[str, Any]]:
        """Findings that a person must know in addition to the gates; none in a run of an earlier version."""
        return list(self.manifest.get("findings", []))

    @property
    def statement(self) -> Statement:
        """What the run proves, and what is left for people to check."""
        return statement(self.manifest)

    @property
    def compared(self) -> bool:
        """Whether two methods could be compared on at least one layer."""
        return bool(self.part_of("comparison").get("compared_layers"))

    @property
    def checks(self) -> list[Mapping[str, Any]]:
        """Checks of the program."""
        return list(self.part_of("program").get("checks", []))

    @property
    def passed(self) -> bool:
        """Whether the job succeeded: the methods agree, or every gate of the program passed."""
        return self.manifest["exit_code"] == 0 if self.is_check else self.validated

    @property
    def validated(self) -> bool:
        """Whether every gate passed: the program says so itself, and the run ended well."""
        return bool(self.part_of("program").get("validated")) and self.manifest["exit_code"] == 0

    def table(self, name: str) -> pd.DataFrame:
        """Read a table of the run, as people open it: its column `layer` counts from 1; InputError if missing or damaged."""
        path = self.folder.path / name
        try:
            found = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path)
        except (OSError, ValueError) as error:
            why = str(error).partition("\n")[0]
            raise InputError(f"{name}: cannot be read as a table of the run: {why}") from None
        if len(found.columns) and "layer" not in found:
            raise InputError(f"{name}: is no table of a run: it has no column 'layer'")
        return found

    @cached_property
    def pair_table(self) -> pd.DataFrame:
        """One row a pair of backends and layer."""
        return self.table("compare.parquet")

    @cached_property
    def layer_table(self) -> pd.DataFrame:
        """One row a layer: verdict, areas and counts of each backend."""
        return self.table("layers.csv")

    @cached_property
    def methods(self) -> list[str]:
        """Backends that cut the part: by their status if their layers were dropped, else those with a file of layers."""
        if self.part_of("slabs"):  # their layers are dropped
            return [name for name, record in self.backends.items() if record["status"] == "done"]
        return self.kept_methods

    @cached_property
    def kept_methods(self) -> list[str]:
        """Backends whose files of layers exist."""
        return [name for name in self.backends if self.folder.layers_file(name).is_file()]

    def layer(self, layer: int) -> dict[str, Layers]:
        """One layer of every backend whose layers are there, each as a stack of its own."""
        found = {}
        for name in self.kept_methods:
            with LayerFile(self.folder.layers_file(name), edges=False) as file:
                found[name] = file.block(layer, layer + 1)
        return found

    @cached_property
    def primary(self) -> Layers | None:
        """Layers that the program was made from."""
        name = self.manifest.get("primary", "")
        return self.folder.read_layers(name) if name in self.kept_methods else None

    @cached_property
    def curves(self) -> Curves | None:
        """Fitted contours."""
        return self._column("curves", Curves.from_parquet)

    @cached_property
    def plan(self) -> ScanPlan | None:
        """Scan plan of the layers."""
        return self._column("scan", ScanPlan.from_parquet)

    @cached_property
    def reference(self) -> Layers | None:
        """Sections of the finer tessellation."""
        return self._column("reference", read_parquet)

    def _column(self, name: str, read: Callable[[Path], Column]) -> Column | None:
        path = self.folder.path / f"{name}.parquet"
        return read(path) if path.is_file() else None

    @cached_property
    def filled_layers(self) -> list[int]:
        """Layers on which some backend found a contour or an open path."""
        table, found = self.layer_table, np.zeros(len(self.layer_table), np.bool_)
        for name in self.methods:
            found |= (table[f"rings_{name}"] + table[f"open_paths_{name}"]).to_numpy() > 0
        return [int(layer) for layer in np.flatnonzero(found)]

    @property
    def middle_layer(self) -> int | None:
        """The middle one of the layers that are not empty."""
        filled = self.filled_layers
        return filled[len(filled) // 2] if filled else None


def layer_name(layer: int, height_mm: float) -> str:
    """Name of the layer of an index, the same in every section."""
    return f"layer {layer + 1}, z = {height_mm:.3f} mm"
