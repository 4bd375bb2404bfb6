"""Puts the kernels that ``make wheel`` has compiled into the wheel; without them it is the plain one for any machine."""

from __future__ import annotations

import os
import platform
import sys
from importlib.metadata import version
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

KERNELS = "EBAMCHECK_WHEEL_KERNELS"
"""Variable of the environment that names their file."""


class WheelHook(BuildHookInterface):
    """Machine code is for one kind of machine, one kind of Python and one version of numba."""

    def initialize(self, version_of_wheel: str, build_data: dict[str, Any]) -> None:
        """Add the file, the tag that says so, and the version of numba."""
        file = os.environ.get(KERNELS, "")
        if not file or version_of_wheel == "editable":
            return
        python = f"cp{sys.version_info.major}{sys.version_info.minor}"
        build_data["force_include"][file] = "ebamcheck/numeric/ready.kernels"
        build_data["pure_python"] = False
        build_data["tag"] = f"{python}-{python}-linux_{platform.machine()}"
        build_data["dependencies"].append(f"numba=={version('numba')}")
