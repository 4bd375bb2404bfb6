"""Values as Python shows them: one short line, a table in a notebook, items to iterate over, plots."""

from __future__ import annotations

import itertools
import sys
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from parts import box

import ebamcheck
from ebamcheck.curves import LIFTED
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers.stack import from_rings
from ebamcheck.program import read_program, write_program
from ebamcheck.scan import plan_stack
from ebamcheck.settings.config import Config
from ebamcheck.showing import short_text
from ebamcheck.showing.columns import Columns
from ebamcheck.showing.plotting import ExtraMissing
from ebamcheck_models import BLADE, CUBE

SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
HOLE = [(4.0, 4.0), (4.0, 6.0), (6.0, 6.0), (6.0, 4.0)]
CONFIG = Config().changed(layers={"layer_height_mm": 2.0})


@pytest.fixture(scope="module")
def values(tmp_path_factory):
    """A part, and what is made of it on the way to a program."""
    layers = ebamcheck.slice(part := box((0, 0, 0), (40, 30, 6)), [1.0, 3.0, 5.0])
    curves, plan = ebamcheck.fit(layers), plan_stack(layers, CONFIG, order="raster")
    files = write_program(curves, plan, CONFIG, tmp_path_factory.mktemp("program") / "nc")
    program = read_program(files.main, CONFIG)
    return SimpleNamespace(part=part, layers=layers, curves=curves, plan=plan, files=files, program=program)


def cells(value):
    """Text of the cells of a value's table in a notebook."""
    return [e.text for e in ElementTree.fromstring(value._repr_html_()).iter() if e.tag in ("th", "td")]


# -- one short line, and tables ----------------------------------------------------------------------


def test_every_value_is_one_short_line(values) -> None:
    v, part = values, BLADE.tessellate(0.5)
    with ebamcheck.Slicing(part) as slicing:
        shown = [
            part, ebamcheck.inspect(part), v.layers, v.layers[0], v.layers[0].rings[0], v.curves, v.curves[0], v.curves[0].pieces[0],
            v.plan, v.plan[0], v.plan[0].islands[0], v.files, v.program, v.program[0], v.program.files[0], v.program.events, slicing,
            Config(), Config().changed(layers={"heights_mm": [*range(1, 999)]}),
        ]  # fmt: skip
        lines = [repr(value) for value in shown]
    lines.append(repr(ebamcheck.Part(np.zeros((0, 3)), np.zeros((0, 3), np.int32), name="a\x1b[31m\n" * 100)))
    for line in lines:
        assert len(line) <= short_text.LONGEST, line
        assert line.startswith("<")
        assert not {"\n", "\x1b"} & set(line)
        assert "array(" not in line
    assert len(set(lines)) == len(lines)


def test_settings_tell_what_is_not_default() -> None:
    assert repr(Config()) == "<Config: the default settings>"
    changed = repr(CONFIG.changed(process={"bead_width_mm": 5.0}))
    assert "layers.layer_height_mm = 2.0" in changed
    assert "process.bead_width_mm = 5.0" in changed
    assert "machine." not in changed


def test_notebooks_get_tables_that_are_well_formed(values) -> None:
    cube, v = CUBE.tessellate(0.1), values
    part = ebamcheck.Part(cube.vertices, cube.faces, name="<b>&")
    for value in (part, ebamcheck.inspect(part), v.layers, v.layers[1], v.curves, v.plan, v.program):
        assert len(cells(value)) >= 6
    assert "<b>&" in "".join(ElementTree.fromstring(part._repr_html_()).itertext())


# -- items -------------------------------------------------------------------------------------------


def test_layers_rings_pieces_and_islands_are_the_columns(values) -> None:
    stack = from_rings([1.0, 2.0, 3.0], [[SQUARE, HOLE], [], [SQUARE]], [[], [[(0, 0), (5, 0)]], []])
    found = list(stack)
    assert [layer.height_mm for layer in found] == stack.heights.tolist()
    assert [layer.area_mm2 for layer in found] == pytest.approx(stack.areas().tolist())
    assert [layer.perimeter_mm for layer in found] == pytest.approx(stack.perimeters().tolist())
    assert [sorted(ring.kind for ring in layer) for layer in found] == [
        ["hole", "outer"],
        ["open path"],
        ["outer"],
    ]
    assert sum(ring.area_mm2 for ring in found[0]) == pytest.approx(96.0)
    assert sum(p.area for p in found[0].polygons) == pytest.approx(96.0)
    rings = np.concatenate([ring.points for layer in stack for ring in layer])
    np.testing.assert_array_equal(rings, stack.points)
    assert stack[::-1].heights.tolist() == [3.0, 2.0, 1.0]
    assert len(stack[2:1]) == 0
    curves, plan = values.curves, values.plan
    assert curves.method in LIFTED
    pieces = [piece for layer in curves for piece in layer]
    assert len(pieces) == curves.kind.size
    np.testing.assert_array_equal(np.concatenate([p.control for p in pieces]), curves.control)
    islands = [island for layer in plan for island in layer]
    assert [island.index for island in islands] == plan.order.tolist()
    assert [island.rank for island in plan[1]] == list(range(len(plan[1])))
    assert sum(len(island.lines) for island in islands) == len(plan.vectors)
    assert [island.area_mm2 for island in islands] == pytest.approx([island.polygon.area for island in islands])
    assert plan[0].metrics["area_mm2"] == pytest.approx(1200.0)


def test_motions_come_in_the_order_of_execution(values) -> None:
    program, motions = values.program, list(values.program)
    assert [m.where for m in motions] == [program.where(k) for k in range(len(program))]
    laid = sum(m.length_mm for m in motions if m.deposits)
    assert laid == pytest.approx(float(program.lengths[program.deposit].sum()))
    for before, after in itertools.pairwise(motions[1:]):
        assert after.start_mm == pytest.approx(before.end_mm, nan_ok=True)


class Bottles(Columns[str]):
    _item_in = ("bottle", "crate")

    def __init__(self, *names: str, owner: str = "") -> None:
        self.names, self.owner = names, owner

    def __len__(self) -> int:
        return len(self.names)

    def _item(self, index: int) -> str:
        return self.names[index]

    def _facts(self) -> dict[str, int | str]:
        return {"bottles": len(self), "owner": self.owner}

    def _more(self) -> dict[str, int | str]:
        return {"letters": sum(map(len, self.names))}


def test_columns_are_counted_taken_and_shown_in_one_way() -> None:
    bottles = Bottles("a", "bb", "ccc", owner="Ann")
    assert [bottles[k] for k in range(-3, 3)] == [*bottles] * 2 == ["a", "bb", "ccc"] * 2
    with pytest.raises(SettingsError, match="no bottle 3: the crate has 3 bottles, from 0"):
        bottles[3]
    with pytest.raises(IndexError):
        bottles[-4]
    assert repr(bottles) == "<Bottles: 3 bottles, Ann>"
    assert repr(Bottles("a")) == "<Bottles: 1 bottle>"
    assert cells(Bottles("a")) == ["bottles", "1", "owner", "not named", "letters", "1"]


# -- runs --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_check_from_python_is_that_of_the_command_line(tmp_path) -> None:
    file = ebamcheck.save(box((0, 0, 0), (20, 20, 6)), tmp_path / "box.stl")
    config = CONFIG.changed(slicing={"backends": ("planecut", "manifold")})
    made = ebamcheck.check(file, tmp_path / "box.run", ebamcheck.save(config, tmp_path / "settings.toml"))
    assert (made.verdict, made.is_check, made.slicers) == ("AGREED", True, ("manifold", "planecut"))
    assert [gate.name for gate in made.gates] == ["input", "agreement"]
    assert made.layers_of("manifold").heights.tolist() == [1.0, 3.0, 5.0]
    assert repr(ebamcheck.Run(made.path)) == repr(made)
    assert cells(made)
    for asked, said in (
        (lambda: made.program, "wrote no program"),
        (lambda: made.curves, r"has no curves\.parquet"),
        (lambda: made.layers_of("stencil"), "has no layers of 'stencil': it has manifold, planecut"),
    ):
        with pytest.raises(InputError, match=said):
            asked()


def test_a_run_needs_a_file_and_a_folder_that_is_one(tmp_path) -> None:
    with pytest.raises(InputError, match=r"save it first: ebamcheck\.save"):
        ebamcheck.run(box((0, 0, 0), (1, 1, 1)))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="is no run folder"):
        ebamcheck.Run(tmp_path)


# -- plots -------------------------------------------------------------------------------------------


def test_without_matplotlib_the_extra_is_named(values, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ExtraMissing, match=r"plot\(\) needs matplotlib.*pip install 'ebamcheck\[plot\]'"):
        values.layers[0].plot()


def test_plots_draw_every_line_on_the_axes_given(values, monkeypatch) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is an extra and is not installed")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    from matplotlib import pyplot

    layers, plan, program = values.layers, values.plan, values.program
    figure, axes = pyplot.subplots(2, 2)
    assert layers[0].plot(axes[0, 0]) is axes[0, 0]
    ends = [*axes[0, 0].get_xlim(), *axes[0, 0].get_ylim()]
    assert (np.array([1, -1, 1, -1]) * ends <= [0, -40, 0, -30]).all()
    assert "curves of layer 3" in values.curves.plot(2, axes[0, 1]).get_title()
    drawn = plan.plot(1, axes[1, 0])
    assert [len(c.get_paths()) for c in drawn.collections[:2]] == [len(plan[1]), len(plan.vectors_of(1))]
    drawn = program.plot(1, ax=axes[1, 1])
    known = np.isfinite(program.start[:, :2]).all(axis=1)
    assert sum(len(c.get_paths()) for c in drawn.collections) == int((known & (program.layer == 1)).sum())
    figure.canvas.draw()
    # In space.
    assert values.part.plot().get_zlim() == pytest.approx((0.0, 6.0))
    solid = layers.plot()
    assert solid.get_zlim() == pytest.approx((1.0, 5.0))
    with pytest.raises(SettingsError, match="give plain ones"):
        layers[0].plot(solid)
    with pytest.raises(SettingsError, match="give three-dimensional ones"):
        values.part.plot(axes[0, 0])
    pyplot.close("all")
