"""The metal that beads lay: where it comes to lie, and how much wire each bead needs so that a layer comes out flat."""

from ebamcheck.metal.footprints import Footprints as Footprints
from ebamcheck.metal.footprints import balanced_widths as balanced_widths
from ebamcheck.metal.footprints import footprints as footprints
from ebamcheck.metal.surface import Surface as Surface
from ebamcheck.metal.surface import bead_centres as bead_centres
from ebamcheck.metal.surface import levelled as levelled
from ebamcheck.metal.surface import reachable as reachable
from ebamcheck.metal.target import Target as Target
from ebamcheck.metal.target import target_of as target_of
