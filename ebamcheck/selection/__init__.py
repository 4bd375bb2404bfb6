"""Which slicers suit this machine: accuracy and speed on a part, a choice by stated rules, and its settings."""

from __future__ import annotations

from ebamcheck.selection.trial import (
    Choice,
    Trial,
    Workpiece,
    choose,
    try_backends,
    workpiece_of_model,
    workpiece_of_part,
)
from ebamcheck.selection.writing import write_choice

__all__ = [
    "Choice",
    "Trial",
    "Workpiece",
    "choose",
    "try_backends",
    "workpiece_of_model",
    "workpiece_of_part",
    "write_choice",
]
