"""Drawing on matplotlib axes, where matplotlib is installed; nothing else needs it.

Every function draws columns on the axes that it is given, or on new ones, and returns them. What a value is, the value's own
``plot`` says; this module knows lines and areas only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import EbamcheckError, ExitCode, SettingsError
from ebamcheck.kernels import Floats

ORDER_COLOURS = "viridis"  # from first to last
MOST_FACETS = 200_000  # facets that matplotlib turns around in a bearable time
LEAST_EXTENT_MM = 1e-6


class ExtraMissing(EbamcheckError):
    """A package that is an extra of this one is not installed."""

    exit_code = ExitCode.USAGE


class Lines(NamedTuple):
    """Lines of one style."""

    points: Sequence[Floats]  # (n, 2) or (n, 3) each, mm
    colour: str
    width: float = 1.2
    dashes: str = "-"
    name: str = ""  # entry of the legend; empty for none


def missing(package: str, extra: str, what: str) -> ExtraMissing:
    """Error that names the extra that a feature needs."""
    return ExtraMissing(
        f"{what} needs {package}, which is not installed: pip install 'ebamcheck[{extra}]', or pip install {package}"
    )


def axes(ax: Any = None, *, space: bool = False) -> Any:
    """Axes to draw on: those given, or new ones; `space` asks for three dimensions, which those given must have."""
    try:
        from matplotlib import pyplot
    except ImportError:
        raise missing("matplotlib", "plot", "plot()") from None
    if ax is None:
        _, ax = pyplot.subplots(subplot_kw={"projection": "3d"} if space else {})
    if hasattr(ax, "get_zlim") != space:
        kind = 'three-dimensional ones (subplot_kw={"projection": "3d"})' if space else "plain ones"
        raise SettingsError(f"these axes cannot show this value: give {kind}, or none")
    return ax


def plot_facets(vertices: Floats, faces: NDArray[np.int32], name: str, ax: Any = None, **style: Any) -> Any:
    """Draw facets, at most :data:`MOST_FACETS`, shaded, on three-dimensional axes."""
    ax = axes(ax, space=True)
    if len(faces) > MOST_FACETS:
        raise SettingsError(
            f"{name}: has {len(faces)} facets, over the {MOST_FACETS} that matplotlib can draw: "
            "slice it and plot the layers, or save it as .vtp for a viewer"
        )
    x, y, z = vertices.T
    ax.plot_trisurf(x, y, z, triangles=faces, **{"color": "#9fc3e8", "linewidth": 0.0, **style})
    return _spaced(ax, vertices, name)


def plot_in_space(lines: Lines, title: str, ax: Any = None, **style: Any) -> Any:
    """Draw lines (n, 3) on three-dimensional axes."""
    ax = axes(ax, space=True)
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped, unused-ignore]

    if not lines.points:
        return ax
    drawn = {"colors": lines.colour, "linewidths": lines.width, **style}
    ax.add_collection3d(Line3DCollection(list(lines.points), **drawn))
    return _spaced(ax, np.concatenate(list(lines.points)), title)


def plot_lines(groups: Sequence[Lines], title: str, ax: Any = None, **style: Any) -> Any:
    """Draw groups of lines (n, 2), each in its style, with a legend of those that are named."""
    ax = axes(ax)
    _add_lines(ax, groups, style)
    if any(group.name for group in groups):
        ax.legend(loc="best", fontsize="small")
    return _plane(ax, title)


def plot_areas(
    outlines: Sequence[Floats], ranks: Sequence[int], over: Sequence[Lines], title: str, ax: Any = None
) -> Any:
    """Fill outlines (n, 2) in the colours of their ranks, and draw lines over them."""
    ax = axes(ax)
    from matplotlib.collections import PolyCollection

    filled = PolyCollection(list(outlines), cmap=ORDER_COLOURS, alpha=0.55, edgecolors="white")
    filled.set_array(np.array(ranks, np.float64))
    ax.add_collection(filled)
    _add_lines(ax, over, {})
    return _plane(ax, title)


def _add_lines(ax: Any, groups: Sequence[Lines], style: dict[str, Any]) -> None:
    from matplotlib.collections import LineCollection

    for group in groups:
        drawn = {"colors": group.colour, "linewidths": group.width, "linestyles": group.dashes}
        named = {**drawn, "label": group.name or None, **style}
        ax.add_collection(LineCollection(list(group.points), **named))


def _plane(ax: Any, title: str) -> Any:
    ax.autoscale_view()
    ax.set_aspect("equal")
    ax.set_xlabel("X, mm")
    ax.set_ylabel("Y, mm")
    ax.set_title(title)
    return ax


def _spaced(ax: Any, points: Floats, title: str) -> Any:
    low = points.min(axis=0)
    wide = np.maximum(np.ptp(points, axis=0), LEAST_EXTENT_MM)
    for k, name in enumerate("xyz"):
        getattr(ax, f"set_{name}lim")(low[k], low[k] + wide[k])
        getattr(ax, f"set_{name}label")(f"{name.upper()}, mm")
    ax.set_box_aspect(wide)
    ax.set_title(title)
    return ax
