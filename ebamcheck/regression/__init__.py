"""Regression reports: how far every slicer is from the truth, held against committed baselines."""

from __future__ import annotations

from ebamcheck.regression.baselines import UpdateMode
from ebamcheck.regression.job import Regression, run_regression
from ebamcheck.regression.measurement import Measured, Truth, measure_outcome, truth_of
from ebamcheck.regression.settings import Tolerance, Tolerances

__all__ = [
    "Measured",
    "Regression",
    "Tolerance",
    "Tolerances",
    "Truth",
    "UpdateMode",
    "measure_outcome",
    "run_regression",
    "truth_of",
]
