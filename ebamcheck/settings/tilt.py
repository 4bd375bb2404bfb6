"""Settings of a tilt table: its rotary axes, and how a part that is turned between layers stands on it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from ebamcheck.settings.base import Between, Place, Section

Component = Annotated[float, Between(-1e6, 1e6)]
"""Component of a direction, of any length but 0."""

Triple = tuple[Place, Place, Place]

ROUNDING = 1e-9
"""How far rows of a rotation may be from unit length and right angles: the digits of a settings file."""


class RotaryAxis(Section):
    """A rotary axis of a tilt table: how it is programmed, and the line about which it turns the plate."""

    name: Annotated[str, Field(pattern="^[ABC][0-9]{0,2}$")]
    """Address in the program: A, B or C, or one with a number, such as C1, which is written with an equals sign."""
    axis: tuple[Component, Component, Component]
    """Direction of its line in the work offset, of any length but 0, where all rotary axes stand at 0."""
    point_mm: Triple
    """A place on that line in the work offset; Z counts from the surface of the base plate."""
    min_deg: Annotated[float, Between(-36000.0, 36000.0)] = -180.0
    """Least position."""
    max_deg: Annotated[float, Between(-36000.0, 36000.0)] = 180.0
    """Greatest position."""
    sign: Literal[1, -1] = 1
    """1: towards greater positions the plate turns counter-clockwise for one who looks against the direction of the line; -1:
    clockwise. Try it on the machine: a wrong one turns the part the other way."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not np.linalg.norm(self.axis) > 0.0:
            raise ValueError(f"rotary axis {self.name}: axis {self.axis} is no direction")
        if not self.min_deg <= 0.0 <= self.max_deg or self.min_deg == self.max_deg:
            raise ValueError(
                f"rotary axis {self.name}: min_deg {self.min_deg:g} and max_deg {self.max_deg:g} leave no room about 0, where the table "
                "stands before and after"
            )
        return self


class OnTable(Section):
    """How the part of a program stands on a tilt table: `ebamcheck` writes it to the settings of a layer of a turned part."""

    direction: tuple[Component, Component, Component]
    """Slicing direction, in the coordinates of the file, that points up where all rotary axes stand at 0: that of the layers
    before."""
    turn: tuple[Triple, Triple, Triple]
    """Rows are the directions of X, Y and Z of the table in the coordinates of the program."""
    shift_mm: Triple
    """Place of the table's zero (that of the work offset) in the coordinates of the program: there p @ turn + shift_mm is what p is
    on the table."""
    low_mm: Triple
    """Least corner of the part's box on the table."""
    high_mm: Triple
    """Greatest corner of the part's box on the table."""
    built_mm: Annotated[float, Between(0.0, 1e6)] = 0.0
    """Height over the base plate up to which it was built along `direction` before it was turned."""

    @field_validator("turn")
    @classmethod
    def _rotation(cls, value: tuple[Triple, Triple, Triple]) -> tuple[Triple, Triple, Triple]:
        turn = np.array(value, np.float64)
        if np.abs(turn @ turn.T - np.eye(3)).max() > ROUNDING or np.linalg.det(turn) < 0.0:
            raise ValueError("turn: is no rotation")
        return value
