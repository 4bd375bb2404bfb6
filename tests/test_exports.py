"""Files for other programs, read back by those programs' own readers: VTK, ezdxf, lib3mf; and by plain XML."""

from __future__ import annotations

import base64
import locale
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from parts import box

import ebamcheck
from ebamcheck.errors import SettingsError
from ebamcheck.layers.contour_files import keeping_locale, slice_heights
from ebamcheck.layers.files import read_layers
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.saving import CURVE_TOLERANCE_MM
from ebamcheck_models import BLADE

EXACT_MM = 1e-5
TYPES = {"Float64": "<f8", "Int64": "<i8", "UInt8": "u1"}
OPEN_STACK = from_rings([1.0, 2.0], [[[(0, 0), (4, 0), (4, 4)]], []], [[], [[(1, 1), (2, 2), (3, 1)]]])


@pytest.fixture(scope="module")
def layers() -> Layers:
    part = BLADE.tessellate(0.5)
    return ebamcheck.slice(part, ebamcheck.layer_heights(part, 40.0))


def vtp_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a .vtp file by an XML parser and the words of its format alone."""
    tree = ElementTree.parse(path)
    text = "".join((tree.getroot().findtext("AppendedData") or "").split())
    assert text[0] == "_"
    found = {}
    for node in tree.getroot().iter("DataArray"):
        # Each array: 8 bytes of its length, then itself, in base64 from its offset on.
        encoded = text[1 + int(node.get("offset", "0")) :]
        size = int.from_bytes(base64.b64decode(encoded[:12])[:8], "little")
        data = base64.b64decode(encoded[: 4 * -(-(8 + size) // 3)])[8 : 8 + size]
        values = np.frombuffer(data, TYPES[node.get("type", "")])
        columns = int(node.get("NumberOfComponents", "1"))
        found[node.get("Name", "")] = values.reshape(-1, columns) if columns > 1 else values
    return found


def lines_of(arrays: dict[str, np.ndarray]) -> list[np.ndarray]:
    return np.split(arrays["connectivity"], arrays["offsets"][:-1]) if arrays["offsets"].size else []


@pytest.mark.parametrize("closed_only", [True, False])
def test_vtp_of_layers_has_every_ring(layers: Layers, tmp_path: Path, closed_only: bool) -> None:
    stack = layers if closed_only else OPEN_STACK
    arrays = vtp_arrays(ebamcheck.save(stack, tmp_path / "a.vtp"))
    np.testing.assert_array_equal(arrays["Points"][:, :2], stack.points)
    np.testing.assert_array_equal(arrays["layer"], stack.ring_layer + 1)
    np.testing.assert_array_equal(arrays["area_mm2"], stack.ring_areas)
    rings = lines_of(arrays)
    assert len(rings) == stack.closed.size
    for r, line in enumerate(rings):
        a, b = stack.ring_starts[r], stack.ring_starts[r + 1]
        assert line.tolist() == [*range(a, b), *([a] if stack.closed[r] else [])]
        assert (arrays["Points"][line, 2] == stack.heights[stack.ring_layer[r]]).all()


@pytest.mark.parametrize("stack", ["blade", "open"])
def test_dxf_is_what_ezdxf_reads(stack: str, layers: Layers, tmp_path: Path) -> None:
    ezdxf = pytest.importorskip("ezdxf", reason="ezdxf is not installed")
    chosen = layers if stack == "blade" else OPEN_STACK
    document = ezdxf.readfile(ebamcheck.save(chosen, tmp_path / "a.dxf"))
    audit = document.audit()
    assert not audit.errors
    assert not audit.fixes
    assert document.dxfversion == "AC1009"
    lines = list(document.modelspace())
    assert len(lines) == chosen.closed.size
    for r, line in enumerate(lines):
        layer = int(chosen.ring_layer[r])
        points = np.array([tuple(p) for p in line.points()])
        assert line.is_closed == chosen.closed[r]
        assert line.dxf.layer == f"LAYER_{layer + 1:04d}"
        np.testing.assert_allclose(points[:, :2], chosen.ring(r), atol=1e-6)
        np.testing.assert_allclose(points[:, 2], chosen.heights[layer], atol=1e-6)
    if stack == "open":
        assert [line.dxf.color for line in lines] == [5, 6]


@pytest.mark.parametrize("with_mesh", [True, False])
def test_3mf_slices_are_what_lib3mf_reads(layers: Layers, tmp_path: Path, with_mesh: bool) -> None:
    import lib3mf

    stack = layers if with_mesh else layers.labelled(mesh=None)
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    before = locale.setlocale(locale.LC_ALL)
    saved = ebamcheck.save(stack, tmp_path / "a.3mf")
    assert locale.setlocale(locale.LC_ALL) == before
    with keeping_locale():
        reader.ReadFromFile(str(saved))
    assert reader.GetWarningCount() == 0
    stacks = model.GetSliceStacks()
    assert stacks.MoveNext()
    found = stacks.GetCurrentSliceStack()
    bottom, tops = slice_heights(layers)
    assert found.GetBottomZ() == pytest.approx(bottom, abs=1e-4)
    assert found.GetSliceCount() == len(layers)
    for k, layer in enumerate(layers):
        part = found.GetSlice(k)
        assert part.GetZTop() == pytest.approx(tops[k], abs=1e-4)
        vertices = np.array([tuple(v.Coordinates) for v in part.GetVertices()]).reshape(-1, 2)
        area = 0.0
        for p in range(part.GetPolygonCount()):
            index = list(part.GetPolygonIndices(p))
            assert index[0] == index[-1]
            x, y = vertices[index].T
            area += 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
        assert area == pytest.approx(layer.area_mm2, rel=1e-4)
    body = model.GetMeshObjects()
    assert body.MoveNext()
    mesh = body.GetCurrentMeshObject()
    assert mesh.HasSlices(False)
    assert mesh.GetTriangleCount() == (len(BLADE.tessellate(0.5).faces) if with_mesh else 12)


@pytest.mark.parametrize(
    ("stack", "why"),
    [
        (OPEN_STACK, "1 open paths"),
        (from_rings([2.0, 1.0], [[], []]), "whose heights rise"),
        (from_rings([2.0], [[]]), "at least two layers"),
        (from_rings([1.0, 2.0], [[], []]), "nothing to write"),
    ],
)
def test_3mf_refuses_what_it_cannot_hold(stack: Layers, why: str, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=why):
        ebamcheck.save(stack, tmp_path / "a.3mf")
    assert not list(tmp_path.iterdir())


def test_slices_reach_half_way_to_their_neighbours() -> None:
    bottom, tops = slice_heights(from_rings([1.0, 3.0, 6.0], [[], [], []]))
    assert bottom == 0.0
    assert tops.tolist() == [2.0, 4.5, 7.5]


# -- saving ----------------------------------------------------------------------------------------


def test_what_is_saved_is_read_back(layers: Layers, tmp_path: Path) -> None:
    part = box((0, 0, 0), (3, 4, 5))
    assert ebamcheck.load(ebamcheck.save(part, tmp_path / "a.stl")).volume == pytest.approx(60.0)
    back = read_layers(ebamcheck.save(layers, tmp_path / "a.parquet"))
    np.testing.assert_array_equal(back.points, layers.points)
    curves = ebamcheck.fit(layers)
    read = ebamcheck.Curves.from_parquet(ebamcheck.save(curves, tmp_path / "c.parquet"))
    np.testing.assert_array_equal(read.control, curves.control)
    config = ebamcheck.Config().changed(layers={"layer_height_mm": 2.5})
    assert ebamcheck.load_config(ebamcheck.save(config, tmp_path / "c.toml")) == config


def test_curves_as_polylines_stay_near(layers: Layers, tmp_path: Path) -> None:
    curves = ebamcheck.fit(layers)
    arrays = vtp_arrays(ebamcheck.save(curves, tmp_path / "c.vtp"))
    areas = np.bincount(arrays["layer"] - 1, arrays["area_mm2"], minlength=len(layers))
    # A line that is nowhere farther off than the tolerance is off by its length times that at most.
    exact = curves.sample_tolerance(EXACT_MM)
    assert (np.abs(areas - exact.areas()) <= (CURVE_TOLERANCE_MM + EXACT_MM) * exact.perimeters()).all()
    assert not np.array_equal(areas, exact.areas())


@pytest.mark.parametrize(
    ("make", "name", "why"),
    [
        (lambda: box((0, 0, 0), (1, 1, 1)), "a.step", r"Part cannot be saved as '\.step': use \.stl, \.vtp"),
        (lambda: OPEN_STACK, "a.stl", r"Layers cannot be saved as '\.stl'"),
        (lambda: 7, "a.stl", "a value of type int cannot be saved: give one of Part, Layers"),
        (lambda: box((0, 0, 0), (1, 1, 1)), "no/such/a.vtp", "cannot be written"),
    ],
)
def test_what_cannot_be_saved_is_told(make: Callable[[], Any], name: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=why):
        ebamcheck.save(make(), tmp_path / name)
    assert not list(tmp_path.iterdir())
