"""Layers: the contours of a stack, their heights, their canonical form, and their files."""

from ebamcheck.layers.stack import Layers as Layers
from ebamcheck.layers.stack import canonical as canonical
from ebamcheck.layers.stack import from_polygons as from_polygons
