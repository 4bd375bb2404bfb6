"""Diagnosis of a disagreement: what is systematic in it over layers and rings, how large, and how much it explains."""

from __future__ import annotations

from ebamcheck.comparison.diagnosis.cause import KINDS, Cause
from ebamcheck.comparison.diagnosis.diagnose import Differing, cause_of, diagnose

__all__ = ["KINDS", "Cause", "Differing", "cause_of", "diagnose"]
