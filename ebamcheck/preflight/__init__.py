"""What is looked at before anything is sliced: mesh, units, machine, settings and the work that the job will be."""

from ebamcheck.preflight.checks import PreflightCheck as PreflightCheck
from ebamcheck.preflight.report import Preflight as Preflight
from ebamcheck.preflight.report import Ready as Ready
from ebamcheck.preflight.report import ready as ready

__all__ = ["Preflight", "PreflightCheck", "Ready", "ready"]
