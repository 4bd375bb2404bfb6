"""Cross-checking validation harness for slicing parts for electron-beam additive manufacturing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ebamcheck.names_on_demand import on_demand
from ebamcheck.version import __version__

if TYPE_CHECKING:
    from ebamcheck.comparison import compare as compare
    from ebamcheck.curves import Curves as Curves
    from ebamcheck.curves import fit as fit
    from ebamcheck.errors import EbamcheckError as EbamcheckError
    from ebamcheck.layers.heights import layer_heights as layer_heights
    from ebamcheck.layers.stack import Layers as Layers
    from ebamcheck.mesh.files import load as load
    from ebamcheck.mesh.inspection import inspect as inspect
    from ebamcheck.mesh.part import Part as Part
    from ebamcheck.program import read_program as read_program
    from ebamcheck.program import write_program as write_program
    from ebamcheck.runs import Run as Run
    from ebamcheck.runs import check as check
    from ebamcheck.runs import run as run
    from ebamcheck.saving import save as save
    from ebamcheck.scan import compare_orders as compare_orders
    from ebamcheck.scan import plan_scan as plan_scan
    from ebamcheck.settings.config import Config as Config
    from ebamcheck.settings.config import load_config as load_config
    from ebamcheck.slicers.slicing import Slicing as Slicing
    from ebamcheck.slicers.slicing import slice_part as slice
    from ebamcheck.verification.verify import verify as verify

# Public names and where they live; they load when first used, so that `import ebamcheck` is instant
_PUBLIC = {
    "Config": "settings.config",
    "Curves": "curves",
    "EbamcheckError": "errors",
    "Layers": "layers.stack",
    "Part": "mesh.part",
    "Run": "runs",
    "Slicing": "slicers.slicing",
    "check": "runs",
    "compare": "comparison",
    "compare_orders": "scan",
    "fit": "curves",
    "inspect": "mesh.inspection",
    "layer_heights": "layers.heights",
    "load": "mesh.files",
    "load_config": "settings.config",
    "plan_scan": "scan",
    "read_program": "program",
    "run": "runs",
    "save": "saving",
    "slice": "slicers.slicing:slice_part",
    "verify": "verification.verify",
    "write_program": "program",
}

__all__ = [*sorted(_PUBLIC), "__version__"]


__getattr__ = on_demand("ebamcheck", _PUBLIC)


def __dir__() -> list[str]:
    """List the public names."""
    return __all__
