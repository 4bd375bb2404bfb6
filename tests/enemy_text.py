"""The text of an honest plugin that an enemy begins with."""

from __future__ import annotations

import os

TESTS = os.path.dirname(__file__)

HONEST = """
from ebamcheck_planecut import PlaneCut
from ebamcheck.backend import Probe
import os, signal, sys
class S(PlaneCut):
    name = {name!r}
    priority = 1
"""
