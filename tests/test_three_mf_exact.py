"""3MF: numbers, units and models that could be read in two ways, or would be read as something else than they say."""

from __future__ import annotations

from pathlib import Path

import pytest

import ebamcheck
from ebamcheck.errors import InputError
from tests.three_mf import PRODUCTION, box, components, model, package

A, B = (60, 60, 20), (20, 60, 20)
ONE = 'objectid="1"'
SLICES = 'xmlns:s="http://schemas.microsoft.com/3dmanufacturing/slice/2015/07"'
STACK = '<s:slicestack id="9"><s:slice ztop="5"><s:vertices><s:vertex x="0" y="0"/><s:vertex x="9" y="0"/><s:vertex x="9" y="9"/></s:vertices><s:polygon startv="0"><s:segment v2="1"/><s:segment v2="2"/><s:segment v2="0"/></s:polygon></s:slice></s:slicestack>'


@pytest.fixture
def load(tmp_path: Path):
    def read(data: bytes) -> ebamcheck.Part:
        (tmp_path / "part.3mf").write_bytes(data)
        return ebamcheck.load(tmp_path / "part.3mf")

    return read


@pytest.mark.parametrize(
    ("root", "inner", "fits"),
    [
        ('unit="inch"', 'unit="inch"', True),
        ('unit="millimeter"', "", True),
        ("", 'unit="millimeter"', True),
        ("", "", True),
        ('unit="inch"', "", False),
        ("", 'unit="inch"', False),
    ],
)
def test_a_model_without_a_unit_is_in_millimeters_wherever_it_stands(load, root, inner, fits):
    of = components(2, 'objectid="3" p:path="/o.model"')
    data = package(
        model(of, 'objectid="2"', unit=root, more=PRODUCTION),
        o_model=model(box(3, B), unit=inner, more=PRODUCTION),
    )
    if fits:
        inches = "inch" in root
        assert load(data).volume == pytest.approx(24000 * (25.4**3 if inches else 1))
    else:
        with pytest.raises(InputError, match=r"o\.model is in .*, and the model that it belongs to in"):
            load(data)


def _sliced(way: str, of: int) -> bytes:
    """An assembly of assemblies of a box, of which object `of` is given by slices."""
    text = STACK + box(1, A) + components(2, ONE) + components(3, 'objectid="2"')
    marked = text.replace(f'<object id="{of}"', f'<object id="{of}" s:slicestackid="9" {way}')
    return package(model(marked, 'objectid="3"', more=SLICES))


@pytest.mark.parametrize("of", [1, 2, 3])
def test_a_rough_mesh_of_what_slices_give_is_refused_on_assemblies_too(load, of):
    assert load(_sliced('s:meshresolution="fullres"', of)).volume == pytest.approx(72000)
    with pytest.raises(InputError, match=f"object {of} is given by slices, and its mesh is a rough one"):
        load(_sliced('s:meshresolution="lowres"', of))


@pytest.mark.parametrize("starts", [("3D/a.model", "3D/b.model"), ("3D/b.model", "3D/a.model")])
def test_two_models_to_start_from_are_refused(load, starts):
    two = {"3D__b_model": model(box(1, B), ONE)}
    sound = package(model(box(1, A), ONE), "3D/a.model", starts[:1], **two)
    assert load(sound).volume == pytest.approx(72000 if "a" in starts[0] else 24000)
    with pytest.raises(InputError, match=r"names 2 models to start from .*export it anew"):
        load(package(model(box(1, A), ONE), "3D/a.model", starts, **two))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *((text, 0) for text in ("40mm", "1.2.3", "1_0", "40 50", "0x28", "\u0664\u0660", "nan", "")),
        *(("40", 40), (" 40 ", 40), ("+4.e1", 40), ("400E-1", 40), (".5", 0.5)),
    ],
)
def test_a_coordinate_is_a_number_to_its_end(load, text, value):
    """In the usual form of the tag, and in one that takes another way through the reader."""
    usual = model(box(1, (30, 30, 30)).replace('x="30"', f'x="{text}"'), ONE)
    for data in (package(usual), package(usual.replace(f'x="{text}"', f"x='{text}' "))):
        if value:
            assert load(data).size == pytest.approx((value, 30, 30))
        else:
            with pytest.raises(InputError, match=r"a vertex has '.*', which is no number: export it anew"):
                load(data)
    if not value and text and " " not in text:
        moved = model(box(1, A), f'objectid="1" transform="1 0 0 0 1 0 0 0 1 {text} 0 0"')
        with pytest.raises(InputError, match=f"a transform has '{text}', which is no number"):
            load(package(moved))


@pytest.mark.parametrize(("times", "fits"), [(1 / 1.2, True), (1.2, False), (1e12, False)])
def test_a_mesh_is_not_moved_so_far_that_its_coordinates_are_lost(load, times, fits):
    far = 2**28 * 60 * 2 * times
    moved = f'objectid="1" transform="2 0 0 0 2 0 0 0 2 0 {-far:g} 0"'
    data = package(model(box(1, A), moved))
    if fits:
        assert load(data).size == pytest.approx((120, 120, 40), rel=1e-6)
    else:
        with pytest.raises(InputError, match="moves it so far that its coordinates are lost"):
            load(data)
