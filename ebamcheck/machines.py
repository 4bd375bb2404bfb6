"""Which slicers a machine uses: the sections ``[machines.NAME]`` of ``ebamcheck.toml``.

`ebamcheck select --write` writes them; a run takes that of its own machine.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from typing import Any

from pydantic import Field

from ebamcheck.config import Config, Section

MACHINE_VARIABLE = "EBAMCHECK_MACHINE"
"""Environment variable that names the machine where its host name does not (in a container, say)."""


class MachineChoice(Section):
    """The slicers of one machine, as `ebamcheck select --write` chose them."""

    primary: str = ""
    """Whose contours go on to fitting and the program."""
    required: tuple[str, ...] = ()
    """A run on this machine ends with exit code 4 where one of these is not available."""
    provenance: dict[str, Any] = Field(default_factory=dict)
    """What the choice rests on: part, settings, versions and figures of every backend."""


def machine_name() -> str:
    """Name of this machine: that of the environment variable ``EBAMCHECK_MACHINE``, else its host name."""
    return os.environ.get(MACHINE_VARIABLE, "") or platform.node() or "localhost"


def for_this_machine(config: Config) -> Config:
    """Return the settings with the choice of this machine in force.

    The primary slicer is that of the machine's section, and what it requires is required on top of what the
    settings require anyway. Without a section for this machine nothing changes.
    """
    sections: Mapping[str, MachineChoice] = getattr(config, "machines", {})
    choice = sections.get(machine_name())
    if choice is None:
        return config
    required = tuple(dict.fromkeys((*config.slicing.required, *choice.required)))
    primary = choice.primary or config.slicing.primary
    slicing = config.slicing.model_copy(update={"primary": primary, "required": required})
    return config.model_copy(update={"slicing": slicing})
