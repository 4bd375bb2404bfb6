"""3MF: units, production extension, what is no part of the solid, and files that are no part at all."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import ebamcheck
from ebamcheck.commands.main import app
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.mesh import three_mf as reader
from ebamcheck.mesh.part_source import read_part
from ebamcheck.preflight.report import ready
from ebamcheck.settings.config import Config
from tests.three_mf import PRODUCTION, box, components, mesh, model, package

A, B = (60, 60, 20), (20, 60, 20)
ONE = 'objectid="1"'


@pytest.fixture
def put(tmp_path: Path):
    def write(data: bytes, name: str = "part.3mf") -> Path:
        (tmp_path / name).write_bytes(data)
        return tmp_path / name

    return write


@pytest.mark.parametrize(
    ("unit", "ours", "size"),
    [
        ('unit="micron"', "um", (0.06, 0.03, 0.03)),
        ('unit="millimeter"', "mm", (60, 30, 30)),
        ("", "mm", (60, 30, 30)),
        ('unit="centimeter"', "cm", (600, 300, 300)),
        ('unit="inch"', "in", (1524, 762, 762)),
        ('unit="foot"', "ft", (18288, 9144, 9144)),
        ('unit="meter"', "m", (60000, 30000, 30000)),
    ],
)
def test_the_unit_of_the_file_holds_and_is_told(put, unit, ours, size):
    path = put(
        package(model(box(1, (60, 30, 30)), ONE, 'objectid="1" transform="1 0 0 0 1 0 0 0 1 60 0 0"', unit=unit))
    )
    part = ebamcheck.load(path)
    assert part.size == pytest.approx((2 * size[0], *size[1:]), rel=1e-7)
    found = ebamcheck.inspect(part)
    assert (found.units, found.units_from) == (ours, "from the file" if unit else "by default of 3MF")
    told = CliRunner().invoke(app, ["inspect", str(path)]).stdout
    assert f"units                {ours} ({found.units_from})" in told


def test_units_that_contradict_the_file_are_an_error(put):
    path = put(package(model(box(1, (2, 1, 1)), ONE, unit='unit="inch"')))
    assert ebamcheck.load(path, units="inches").size == pytest.approx([50.8, 25.4, 25.4])
    with pytest.raises(
        SettingsError,
        match=r"part\.3mf: its unit is in \(from the file\), and --units \(part\.units\) says mm",
    ):
        ebamcheck.load(path, units="mm")
    with pytest.raises(SettingsError, match=r"its unit is in \(from the file\), and --units .* says cm"):
        read_part(path, Config().changed(part={"units": "cm"}).part)
    assert CliRunner().invoke(app, ["inspect", str(path), "--units", "mm"]).exit_code == 2
    bare = put(package(model(box(1, (2, 1, 1)), ONE, unit="")), "bare.3mf")
    with pytest.raises(SettingsError, match=r"its unit is mm \(by default of 3MF\)"):
        ebamcheck.load(bare, units="in")


def _parts(*items: str, own: str = "", inner: str = 'objectid="1" p:path="/3D/Objects/o.model"') -> bytes:
    away = 'objectid="7" p:path="/3D/Objects/o.model" transform="1 0 0 0 1 0 0 0 1 80 0 0"'
    root = model(own + components(5, inner, away), *items, more=PRODUCTION)
    return package(root, **{"3D__Objects__o_model": model(box(1, A) + box(7, B), more=PRODUCTION)})


@pytest.mark.parametrize(
    ("data", "volume"),
    [
        (_parts('objectid="5"'), 96000),
        (_parts('objectid="5"', 'objectid="1"', own=box(1, (10, 60, 20), (200, 0, 0))), 108000),
        (_parts('objectid="7" p:path="/3D/Objects/o.model"', own=""), 24000),
    ],
    ids=["two objects in a part", "same number in two parts", "an item in a part"],
)
def test_the_production_extension_places_each_object_once(put, data, volume):
    found = ebamcheck.inspect(ebamcheck.load(put(data)))
    assert (found.verdict, found.volume_mm3) == ("sound", pytest.approx(volume))


def test_a_root_part_is_found_by_its_relation(put):
    path = put(package(model(box(1, A), ONE), "3D/part.model", **{"3D__old_model": model(box(1, B), ONE)}))
    assert ebamcheck.load(path).volume == pytest.approx(72000)


def test_mirrored_bodies_keep_their_outside(put):
    path = put(package(model(box(1, A) + components(2, 'objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"'), 'objectid="2"', 'objectid="1" transform="1 0 0 0 1 0 0 0 1 5 0 0"')))  # fmt: skip
    found = ebamcheck.inspect(ebamcheck.load(path))
    assert (found.verdict, found.volume_mm3, found.bodies) == ("sound", pytest.approx(144000), 2)


def test_transforms_of_items_and_components_follow_each_other(put):
    turned = components(2, 'objectid="1" transform="0 1 0 -1 0 0 0 0 1 10 0 0"')
    path = put(package(model(box(1, (4, 2, 1)) + turned, 'objectid="2" transform="1 0 0 0 1 0 0 0 1 0 0 5"')))
    assert ebamcheck.load(path).bounds.tolist() == [[8, 0, 5], [10, 4, 6]]


NOTES = "Metadata/Slic3r_PE_model.config"
RANGED = '<config><object id="1"><volume firstid="0" lastid="11"><metadata type="volume" key="volume_type" value="ModelPart"/></volume><volume firstid="12" lastid="23"><metadata type="volume" key="{}" value="{}"/></volume></object></config>'
TWO = f'<object id="1" type="model">{mesh(((0, 0, 0), A), ((20, 20, 8), (20, 20, 22)))}</object>'
BAMBU = '<config><object id="5"><part id="1" subtype="normal_part"/><part id="7" subtype="{}"/></object></config>'


def _with(name: str, text: str, data: bytes, put) -> Path:
    path = put(data)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, text)
    return path


@pytest.mark.parametrize(
    ("items", "objects", "said"),
    [
        (('objectid="1"', 'objectid="2"'), box(1, A) + box(2, B, (80, 0, 0), 'type="support"'), "object 2: a support"),
        (('objectid="1"', 'objectid="2"'), box(1, A) + box(2, B, (80, 0, 0), 'type="solidsupport"'), "a solid support"),
        (('objectid="1"', 'objectid="2"'), box(1, A) + box(2, B, (80, 0, 0), 'type="other" name="jig"'), "object 2 ('jig'): an object of type other"),
        (('objectid="1"', 'objectid="2"'), box(1, A) + box(2, B, (80, 0, 0), 'type="surface"'), "a surface"),
        (('objectid="1"', 'objectid="2" printable="0"'), box(1, A) + box(2, B, (80, 0, 0)), "object 2: not to be printed"),
        (('objectid="1"',), box(1, A) + box(2, B, (80, 0, 0)), "object 2: not in the build"),
        (('objectid="3"',), box(1, A) + box(2, B, (80, 0, 0), 'type="support"') + components(3, 'objectid="1"', 'objectid="2"'), "object 2: a support"),
    ],
)  # fmt: skip
def test_what_is_no_part_of_the_solid_is_left_out_and_said(put, items, objects, said):
    path = put(package(model(objects, *items)))
    part = ebamcheck.load(path)
    assert part.volume == pytest.approx(72000)
    assert len(part.notes) == 1
    assert said in part.notes[0]
    warned = [c for c in ready(path, Config()).preflight.checks if c.level == "warning" and said in c.text]
    assert len(warned) == 1


@pytest.mark.parametrize("kind", ["ParameterModifier", "SupportEnforcer", "SupportBlocker"])
def test_volumes_that_modify_others_are_left_out_and_said(put, kind):
    path = _with(NOTES, RANGED.format("volume_type", kind), package(model(TWO, ONE)), put)
    part = ebamcheck.load(path)
    assert part.size.tolist() == [60, 60, 20]
    assert "left out: object 1" in part.notes[0]


@pytest.mark.parametrize(
    ("name", "text", "data"),
    [
        (NOTES, RANGED.format("volume_type", "NegativeVolume"), package(model(TWO, ONE))),
        ("Metadata/model_settings.config", BAMBU.format("negative_part"), _parts('objectid="5"')),
    ],
)
def test_negative_volumes_are_refused(put, name, text, data):
    with pytest.raises(InputError, match=r"has a negative volume, .*export the result"):
        ebamcheck.load(_with(name, text, data, put))


LATTICE = 'xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"'
BEAMS = '<b:beamlattice minlength="0.1" radius="1"><b:beams><b:beam v1="0" v2="7"/></b:beams></b:beamlattice></mesh>'
DOCTYPE = '<!DOCTYPE a [<!ENTITY b "bbbbbbbbbbbbbbbbbbbb">]>'
TEN = 'objectid="{}"'


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (package(model(box(1, A), ONE, unit='unit="furlong"')), "its unit is 'furlong', and 3MF knows micron"),
        (package(model(box(1, A), ONE, more='xmlns:q="http://example.org/q" requiredextensions="q"')), "requires an extension of 3MF that is not known"),
        (package(model(box(1, A, more='type="metal"'), ONE)), "type of an object is none"),
        (package(model(box(1, A).replace("</mesh>", BEAMS), ONE, more=LATTICE)), "beam lattice .1 beams.: export it as a mesh"),
        (package(model(box(1, A), ONE, 'objectid="9"')), "a build item names object '9', which the file does not hold"),
        (package(model(box(1, A), 'objectid="1" transform="2 0 0 0 2 0 0 0 2"')), "Not enough values"),
        (package(model(box(1, A), 'objectid="1" transform="1 0 0 0 1 0 0 0 1 nan 0 0"')), "a transform has 'nan', which is no number"),
        (package(model(box(1, A), 'objectid="1" transform="1 0 0 0 1 0 0 0 0 0 0 0"')), "transform of object 1 is no placing"),
        (package(model(components(1, ONE), ONE)), "holds no facet"),
        (package(model(box(1, A))), "holds no facet that is built"),
        (package(model(box(1, A, more='type="support"'), ONE)), "holds no facet that is built; left out: object 1: a support"),
        (package(model(box(1, A) + "".join(components(k, *[TEN.format(k - 1)] * 10) for k in range(2, 12)), TEN.format(11))), "places 1e.10 meshes"),
        (package(model(box(1, A), *[ONE] * 100_001)), "places 100001 meshes, over 100000"),
        (package(model(box(1, A), ONE).replace("?><", f"?>{DOCTYPE}<")), "declares a document type"),
        (package(model(box(1, A), ONE)[:-20]), "no well-formed XML"),
        (package(model(box(1, A), ONE), "3D/a.model")[:-100], "no whole zip archive"),
        (_parts('objectid="5"', inner='objectid="1" p:path="/3D/none.model"'), "holds no 3d/none.model"),
        (package(model(box(1, A) + components(2, 'objectid="3" p:path="/o.model"'), 'objectid="2"', more=PRODUCTION), o_model=model(box(3, B), unit='unit="inch"', more=PRODUCTION)), "is in inch, and the model that it belongs to in millimeter"),
    ],
)  # fmt: skip
def test_what_cannot_be_known_is_refused_in_one_line(put, data, why):
    with pytest.raises(InputError, match=why) as refused:
        ebamcheck.load(put(data))
    assert str(refused.value).startswith("part.3mf: ")
    assert "\n" not in str(refused.value)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(
    "again", ["3D/3dmodel.model", "3D/3DModel.model", "3d\\3dmodel.model", "_RELS/.rels", "METADATA/a.Config"]
)
def test_two_files_of_one_name_are_refused_whatever_their_case(put, again):
    sound = package(model(box(1, A), ONE), **{"Metadata__a.config": "<config/>"})
    path = _with("3D/", "", sound, put)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("3D/", "")
    assert ebamcheck.load(path).volume == pytest.approx(72000)
    with pytest.raises(InputError, match=r"holds two files of the name .*export it anew"):
        ebamcheck.load(_with(again, model(box(1, B), ONE), sound, put))


@pytest.mark.parametrize(
    ("name", "text", "fits"),
    [
        ("Metadata/model_settings.config", BAMBU.format("negative_part").replace("<part", '<metadata key="name" value="a & b"/><part', 1), False),
        ("METADATA/Model_Settings.Config", "x" + BAMBU.format("negative_part"), False),
        ("Metadata/model_settings.config", BAMBU.format("normal_part")[:-9], False),
        (NOTES, RANGED.format("volume_type", "NegativeVolume").replace("<config>", "<config a=b>"), False),
        ("Metadata/other.config", "\ufeff <config>&</config>", False),
        ("Metadata/project_settings.config", '{"name": "a & b"}', True),
        ("Metadata/Slic3r_PE.config", "; made by a slicer\n; notes = <b> & c", True),
        ("Metadata/model_settings.config", BAMBU.format("normal_part").replace("<part", '<metadata key="name" value="a &amp; b"/><part', 1), True),
    ],
)  # fmt: skip
def test_notes_of_a_slicer_that_cannot_be_read_are_refused(put, name, text, fits):
    path = _with(name, text, _parts('objectid="5"'), put)
    if fits:
        assert ebamcheck.load(path).volume == pytest.approx(96000)
        return
    with pytest.raises(InputError, match=r"is no well-formed XML: .*: save it anew in its slicer") as refused:
        ebamcheck.load(path)
    assert name in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("times", "fits"), [(1.2, False), (1 / 1.2, True)])
def test_a_small_file_of_much_text_is_not_unpacked(put, monkeypatch, times, fits):
    data = package(model(box(1, A), ONE), a_txt=bytes(1 << 20))
    with zipfile.ZipFile(put(data)) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
    monkeypatch.setattr(reader, "FREE_BYTES", 1 << 19)
    monkeypatch.setattr(reader, "MOST_RATIO", unpacked / len(data) / times)
    if fits:
        assert ebamcheck.load(put(data)).volume == pytest.approx(72000)
    else:
        with pytest.raises(InputError, match="would unpack to"):
            ebamcheck.load(put(data))
    monkeypatch.setattr(reader, "MOST_RATIO", np.inf)
    monkeypatch.setattr(reader, "MOST_BYTES", unpacked / times)
    if not fits:
        with pytest.raises(InputError, match="would unpack to"):
            ebamcheck.load(put(data))


# -- what could be read in two ways ---------------------------------------------------------------------------


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
