"""Cross-checking validation harness for slicing parts for electron-beam additive manufacturing."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

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
    "Config": "ebamcheck.settings.config",
    "Curves": "ebamcheck.curves",
    "EbamcheckError": "ebamcheck.errors",
    "Layers": "ebamcheck.layers.stack",
    "Part": "ebamcheck.mesh.part",
    "Run": "ebamcheck.runs",
    "Slicing": "ebamcheck.slicers.slicing",
    "check": "ebamcheck.runs",
    "compare": "ebamcheck.comparison",
    "compare_orders": "ebamcheck.scan",
    "fit": "ebamcheck.curves",
    "inspect": "ebamcheck.mesh.inspection",
    "layer_heights": "ebamcheck.layers.heights",
    "load": "ebamcheck.mesh.files",
    "load_config": "ebamcheck.settings.config",
    "plan_scan": "ebamcheck.scan",
    "read_program": "ebamcheck.program",
    "run": "ebamcheck.runs",
    "save": "ebamcheck.saving",
    "slice": "ebamcheck.slicers.slicing:slice_part",
    "verify": "ebamcheck.verification.verify",
    "write_program": "ebamcheck.program",
}

__all__ = [*sorted(_PUBLIC), "__version__"]


def __getattr__(name: str) -> Any:
    """Load a public name from its module when it is first used."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'ebamcheck' has no attribute {name!r}")
    module, _, attribute = _PUBLIC[name].partition(":")
    return getattr(import_module(module), attribute or name)


def __dir__() -> list[str]:
    """List the public names."""
    return __all__
