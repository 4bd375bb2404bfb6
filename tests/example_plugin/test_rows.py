"""All that the author of a plugin writes to have it tested."""

from ebamcheck_rows import Rows

from ebamcheck.testing import SlicerSuite


class TestRows(SlicerSuite):
    slicer = Rows
    settings = ({"pitch_mm": 0.4},)
    models = ("cube",)
