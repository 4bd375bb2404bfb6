"""Heat simulators as controls: what they are given is a whole case, which no reader proves."""

from __future__ import annotations

from ebamcheck.program.language.control import Control

_WRITERS = "ebamcheck.program.simulators.heat_paths:write_"

THESIS = Control("3dthesis", f"{_WRITERS}3dthesis")
ADAMANTINE = Control("adamantine", f"{_WRITERS}adamantine")
ADDITIVEFOAM = Control("additivefoam", f"{_WRITERS}additivefoam")
