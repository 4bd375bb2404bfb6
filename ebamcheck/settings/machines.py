"""Which slicers a machine uses: the sections ``[machines.NAME]`` of ``ebamcheck.toml``.

`ebamcheck select --write` writes them; a run takes that of its own machine.
"""

from __future__ import annotations

import os
import platform

from ebamcheck.settings.config import Config
from ebamcheck.settings.selection import MachineSections

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
