"""Diagnosis of a disagreement: systematic causes over layers and rings, with their size and the share that they explain."""

from __future__ import annotations

from ebamcheck.comparison.diagnosis.cause import KINDS, Cause
from ebamcheck.comparison.diagnosis.diagnose import Differing, cause_of, diagnose

__all__ = ["KINDS", "Cause", "Differing", "cause_of", "diagnose"]
