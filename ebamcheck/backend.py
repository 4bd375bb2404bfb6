"""The protocol between the harness and a slicer: a class found by the entry point group ``ebamcheck.backends``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import version
from types import TracebackType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from ebamcheck.errors import SettingsError

if TYPE_CHECKING:
    # A caller that only asks a plugin what it is must not wait for the kernels' compiler.
    from ebamcheck.layers.stack import Layers
    from ebamcheck.mesh.part import Part

Progress = Callable[[int], None]  # called with the number of layers finished since the last call

CoplanarRule = Literal["half-open", "undefined"]
"""What a slicer makes of a vertex or face in the plane z = h.

``half-open``: the section is that of z = h + 0, exactly (an edge is cut where ``min <= h < max``).
``undefined``: rounding decides; layers nearer to a vertex than the plane margin are not compared.
"""


class BackendSettings(BaseModel):
    """Base of a slicer's own settings: unknown keys are refused, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def own(cls, settings: BackendSettings, backend: str) -> Self:
        """Return settings of this class; raises :class:`SettingsError` for those of another slicer."""
        if not isinstance(settings, cls):
            raise SettingsError(f"{backend}: settings are {type(settings).__name__}: give its own Settings")
        return settings


@dataclass(frozen=True)
class Probe:
    """Whether a slicer can run on this machine, and what it would run on."""

    available: bool
    why: str = ""  # why it is not available, in one line
    hint: str = ""  # what to install or set, in one line
    versions: Mapping[str, str] = field(default_factory=dict)
    device: str = "CPU"  # what computes: the processor, or the renderer's name as OpenGL gives it


def installed(package: str, module: str) -> Probe:
    """Whether a package is there and one of its modules can be imported, and its version."""
    try:
        import_module(module)
        return Probe(True, versions={package: version(package)})
    except (ImportError, OSError) as error:  # among them PackageNotFoundError
        return Probe(False, why=f"{package} cannot be imported: {error}", hint=f"pip install {package}")


def labels_of(part: Part, backend: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Labels of the layers that a slicer makes of a part."""
    return {
        "part": part.sha256,
        "direction": part.direction,
        "backend": backend,
        "settings": dict(settings),
    }


class Prepared(Protocol):
    """A part made ready for one slicer; a context manager that frees what it holds."""

    def __enter__(self) -> Self:
        """Return itself."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Free the index, the tree or the graphics context."""
        ...

    def slice(self, heights: NDArray[np.float64], progress: Progress | None = None) -> Layers:
        """Cut the part at strictly increasing heights (L,), mm, and return canonical layers.

        The result of a layer does not depend on which other layers are asked for.

        A slicer that knows where its answer cannot be trusted on this part declares it in the settings of
        the layers as ``doubtful_regions``: a list of ``{"box_mm": [xmin, ymin, zmin, xmax, ymax, zmax],
        "why": one line}``, and ``"bound_mm"`` where it knows how far a contour may be off there at most. A disagreement
        in such a box has that line as its likely cause. It is still one, unless it is within the limit of the pair and
        that bound, the bound is within `comparison.doubt_mm`, and all is well beside the box: then it is counted and told.
        """
        ...


@runtime_checkable
class Turnable(Protocol):
    """What a :class:`Prepared` may offer, too: it cuts the same part along another direction, cheaper than one made anew."""

    def turned(self, part: Part) -> Prepared:
        """Make ready a part that has the same `faces` under turned vertices; this object stays as it is."""
        ...


@runtime_checkable
class Slicer(Protocol):
    """One method of slicing.

    Attributes
    ----------
    name
        Key in the registry, as on the command line.
    summary
        One line for ``ebamcheck backends``.
    exact
        Whether contours are those of the mesh up to rounding (as against sampled on a grid).
    priority
        The available exact slicer of the highest priority is the default one. One of negative priority is a
        witness: it takes part only where it is asked for by name.
    coplanar_rule, inside_rule
        What is done with a plane through vertices or faces, and which winding numbers are solid
        (``"winding > 0"`` is the house rule).
    Settings
        The slicer's settings, a :class:`BackendSettings`.

    A slicer of this project, made of its own kernels, may have ``isolated = False``, too: then ``ebamcheck slice`` runs it
    in the process of the command. Every other slicer runs in a process of its own.

    Examples
    --------
    >>> import numpy as np
    >>> from ebamcheck_models import CUBE
    >>> from ebamcheck_planecut import PlaneCut
    >>> slicer: Slicer = PlaneCut()
    >>> part, settings = CUBE.tessellate(0.1), slicer.Settings()
    >>> with slicer.prepare(part, settings) as prepared:
    ...     prepared.slice(np.array([1.0, 3.0])).areas().tolist()
    [400.0, 400.0]
    >>> slicer.error_bound_mm(part, settings) < 1e-6
    True
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    exact: ClassVar[bool]
    priority: ClassVar[int]
    coplanar_rule: ClassVar[CoplanarRule]
    inside_rule: ClassVar[str]
    Settings: ClassVar[type[BackendSettings]]

    def probe(self) -> Probe:
        """Whether this machine can run the slicer; cheap, and never raises."""
        ...

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the promised bound r, mm: the section eroded by r lies in the result, the result in it dilated by r."""
        ...

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the promised bound on the height at which a layer is really cut, mm."""
        ...

    def prepare(self, part: Part, settings: BackendSettings) -> Prepared:
        """Make a part ready; raises :class:`ebamcheck.errors.BackendFailed` where the slicer refuses it."""
        ...
