"""Saving a value in the format that the name of its file says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ebamcheck.atomic_file import replacing
from ebamcheck.curves import Curves
from ebamcheck.errors import SettingsError
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.stl import write_triangles
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.settings.config import Config

CURVE_TOLERANCE_MM = 0.001  # Formats that know no splines get polylines this near to the curves

Writer = Callable[[Any, Path], None]


def save(value: Part | Layers | Curves | ScanPlan | Config, path: str | Path) -> Path:
    """Write a value into a file whose suffix names the format; the file appears whole or not at all.

    Parameters
    ----------
    value
        A part (``.stl``, ``.vtp``), layers (``.parquet``, ``.cli``, ``.svg``, ``.vtp``, ``.dxf``, ``.3mf``, ``.csv``), curves (``.parquet``;
        ``.vtp``, ``.dxf`` as polylines within :data:`CURVE_TOLERANCE_MM`), a scan plan (``.parquet``) or settings (``.toml``).
        STL has 32-bit numbers.
    path
        The file.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    SettingsError
        If the value has no such format, or the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from ebamcheck.layers.files import read_layers
    >>> from ebamcheck.layers.stack import from_rings
    >>> layers = from_rings([0.5], [[[(0, 0), (2, 0), (2, 2), (0, 2)]]])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     read_layers(save(layers, Path(folder) / "square.parquet")).areas().tolist()
    [4.0]
    """
    path = Path(path)
    for kind, writers in _writers().items():
        if isinstance(value, kind):
            write = writers.get(path.suffix.lower())
            if write is None:
                told = f"{kind.__name__} cannot be saved as {path.suffix!r}: use {', '.join(writers)}"
                raise SettingsError(f"{path}: {told}")
            write(value, path)
            return path
    known = ", ".join(kind.__name__ for kind in _writers())
    raise SettingsError(f"{path}: a value of type {type(value).__name__} cannot be saved: give one of {known}")


def _writers() -> Mapping[type, Mapping[str, Writer]]:
    """Writers of each kind of value, by suffix."""
    from ebamcheck.layers.contour_files import write_dxf, write_part, write_vtp
    from ebamcheck.layers.files import FORMATS

    def toml(config: Config, path: Path) -> None:
        from ebamcheck.settings.checking import as_toml

        path.write_text(as_toml(config), encoding="utf-8")

    return {
        Part: {".stl": _whole(lambda part, path: write_triangles(part.triangles, path)), ".vtp": write_part},
        Layers: {suffix: write for suffix, (write, _) in FORMATS.items()},
        Curves: {
            ".parquet": _whole(Curves.to_parquet),
            ".vtp": lambda curves, path: write_vtp(curves.sample_tolerance(CURVE_TOLERANCE_MM), path),
            ".dxf": lambda curves, path: write_dxf(curves.sample_tolerance(CURVE_TOLERANCE_MM), path),
        },
        ScanPlan: {".parquet": _whole(ScanPlan.to_parquet)},
        Config: {".toml": _whole(toml)},
    }


def _whole(write: Writer) -> Writer:
    """Writer of a file that appears whole or not at all."""

    def written(value: Any, path: Path) -> None:
        with replacing(path) as temporary:
            write(value, temporary)

    return written
