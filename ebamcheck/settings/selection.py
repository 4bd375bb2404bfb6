"""Settings of regression reports, and the slicers of each machine."""

from __future__ import annotations

from typing import Any

from pydantic import ConfigDict, Field

from ebamcheck.settings.base import Section


class RegressionSettings(Section):
    """Regression reports (`ebamcheck regress`)."""

    baselines: str = ""
    """Folder of the baselines; empty: reports/baselines of the checkout in which the command runs."""
    history: str = ""
    """SQLite file of the history; empty: history.sqlite in the output folder."""
    tolerances: dict[str, dict[str, Any]] = Field(default={})
    """What may grow by how much: metrics.NAME and backends.BACKEND.NAME, each with absolute and relative."""


class MachineChoice(Section):
    """The slicers of one machine, as `ebamcheck select --write` chose them."""

    primary: str = ""
    """Whose contours go on to fitting and the program."""
    required: tuple[str, ...] = ()
    """A run on this machine ends with exit code 4 where one of these is not available."""
    provenance: dict[str, Any] = Field(default={})
    """What the choice rests on: part, settings, versions and figures of every backend."""


class MachineSections(Section):
    """Slicers by machine, [machines.NAME]; a run takes those of its own machine (EBAMCHECK_MACHINE, else the host)."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, MachineChoice] = Field(init=False)

    def of(self, machine: str) -> MachineChoice | None:
        """Return the choice of a machine, or None."""
        return (self.model_extra or {}).get(machine)
