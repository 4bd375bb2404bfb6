"""Settings of regression reports, and the slicers of each machine: the sections ``[machines.NAME]`` of ``ebamcheck.toml``.

`ebamcheck select --write` writes them; a run takes that of its own machine.
"""

from __future__ import annotations

import os
import platform
from typing import TYPE_CHECKING, Any

from pydantic import ConfigDict, Field

from ebamcheck.settings.base import Section

if TYPE_CHECKING:
    from ebamcheck.settings.config import Config


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


MACHINE_VARIABLE = "EBAMCHECK_MACHINE"
"""Environment variable that names the machine where its host name does not (in a container, say)."""


def machine_name() -> str:
    """Name of this machine: that of the environment variable ``EBAMCHECK_MACHINE``, else its host name."""
    return os.environ.get(MACHINE_VARIABLE, "") or platform.node() or "localhost"


def for_this_machine(config: Config) -> Config:
    """Return the settings with the choice of this machine in force.

    The primary slicer is that of the machine's section, and what it requires is required on top of what the
    settings require anyway. Without a section for this machine nothing changes. The sections themselves go, so that
    the hash of a run's settings does not depend on what other machines use.
    """
    choice = config.machines.of(machine_name())
    slicing = config.slicing
    if choice is not None:
        required = tuple(dict.fromkeys((*slicing.required, *choice.required)))
        slicing = slicing.model_copy(
            update={"primary": choice.primary or slicing.primary, "required": required}
        )
    return config.model_copy(update={"slicing": slicing, "machines": MachineSections()})
