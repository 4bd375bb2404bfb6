"""Remedies for a disagreement, by its cause: a setting, another slicer, another direction, or a repair of the part."""

from __future__ import annotations

from collections.abc import Mapping

from ebamcheck.comparison import causes
from ebamcheck.comparison.diagnosis import cause as systematic

LEAVE_OUT = "leave {backend} out (--backends), and tell those who make it"
SETTINGS = "look at the settings of {backend} (slicing.settings.{backend})"
MEND = "mend the mesh at this place, or slice by a method that does not need it whole"

REMEDIES: Mapping[str, str] = {
    causes.COPLANAR_FACE: "shift the layers a little (layers.layer_height_mm, layers.heights_mm), or turn the part (part.direction)",
    causes.VERTEX: "shift the layers a little (layers.layer_height_mm, layers.heights_mm)",
    causes.OPEN_EDGE: MEND,
    causes.NON_MANIFOLD: MEND,
    causes.ORIENTATION: "turn the facets (--fix-orientation), or mend the mesh",
    causes.OVERLAP: "unite the bodies in the model, or leave out the one of both slicers with another inside rule (ebamcheck backends)",
    causes.SELF_INTERSECTION: MEND,
    causes.TOUCHING: "unite the bodies in the model, or move them apart",
    causes.OPEN_PATH: MEND,
    causes.OPEN_SURFACE: MEND,
    causes.THIN: "make the wall thicker in the model, or sample more finely (slicing.settings.{backend})",
    causes.THIN_GAP: "make the gap wider in the model, or sample more finely (slicing.settings.{backend})",
    causes.SHALLOW: "shift the layers a little (layers.heights_mm), or turn the part (part.direction)",
    causes.UNKNOWN_CAUSE: "look at the layer in the report, and slice with a third method that shows which of both is wrong",
    systematic.OFFSET: SETTINGS + " for a compensation of bead or pixel, else " + LEAVE_OUT,
    systematic.TRANSLATION: SETTINGS + " for an origin or a bed, else " + LEAVE_OUT,
    systematic.HEIGHT: SETTINGS + " for the height within a layer at which it cuts, else " + LEAVE_OUT,
    systematic.SCALE: SETTINGS + " for a scale or a compensation of shrinkage, else " + LEAVE_OUT,
    systematic.UNIT: "check the unit of the file (--units), then " + SETTINGS,
    systematic.ROTATION: "check part.direction, then " + SETTINGS,
    systematic.MIRROR: SETTINGS + " for the side from which layers are seen, else " + LEAVE_OUT,
    systematic.MISSING_OUTER: SETTINGS + " for a least area of islands, else " + LEAVE_OUT,
    systematic.MISSING_HOLE: SETTINGS + " for a least area of holes, else " + LEAVE_OUT,
    systematic.EXTRA_OUTER: SETTINGS + " for supports, skirts or rafts, else " + LEAVE_OUT,
    systematic.EXTRA_HOLE: SETTINGS + " for its inside rule, else " + LEAVE_OUT,
    systematic.NESTING: LEAVE_OUT,
    systematic.ORIENTATION: LEAVE_OUT,
    systematic.WINDING_RULE: "unite the bodies in the model, or " + LEAVE_OUT,
    systematic.QUANTISATION: SETTINGS + " for the decimals or the grid of its coordinates, else " + LEAVE_OUT,
    systematic.DROPPED: SETTINGS + " for a least area or a first layer, else " + LEAVE_OUT,
    systematic.DUPLICATED: SETTINGS + " for its layer height, else " + LEAVE_OUT,
    systematic.SHIFTED: SETTINGS + " for its first layer, else " + LEAVE_OUT,
}  # fmt: skip
"""Remedies by cause; for a cause that a slicer declares in its own words it is :data:`DECLARED`."""

DECLARED = "trust {against} here and leave {backend} out (--backends), or mend the mesh at this place"


def remedy(cause: str, backend: str, against: str) -> str:
    """Remedy for a disagreement of one slicer with another, without a full stop.

    Examples
    --------
    >>> remedy("open path", "pixels", "planecut")
    'mend the mesh at this place, or slice by a method that does not need it whole'
    """
    return REMEDIES.get(cause, DECLARED).format(backend=backend, against=against)
