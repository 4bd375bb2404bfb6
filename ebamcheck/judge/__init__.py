"""Layers judged by a heat code of others: 3DThesis beside our own model."""

from ebamcheck.judge.layer import BEADS as BEADS
from ebamcheck.judge.layer import BODIES as BODIES
from ebamcheck.judge.layer import JudgedLayer as JudgedLayer
from ebamcheck.judge.layer import LayerCase as LayerCase
from ebamcheck.judge.layer import judge_layer as judge_layer
from ebamcheck.judge.thesis import THESIS as THESIS

__all__ = ["BEADS", "BODIES", "THESIS", "JudgedLayer", "LayerCase", "judge_layer"]
