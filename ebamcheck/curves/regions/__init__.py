"""Regions of a mesh, found before its normals: planes, strips with straight rulings, and freely curved facets."""

from ebamcheck.curves.regions.segmentation import FREEFORM as FREEFORM
from ebamcheck.curves.regions.segmentation import PLANE as PLANE
from ebamcheck.curves.regions.segmentation import STRIP as STRIP
from ebamcheck.curves.regions.segmentation import Regions as Regions
from ebamcheck.curves.regions.segmentation import find_regions as find_regions
