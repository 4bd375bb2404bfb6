"""Values as Python shows them: one short line, a table in a notebook, items to iterate over, plots; and public names that load late."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from parts import box

import ebamcheck
from ebamcheck.curves import LIFTED
from ebamcheck.curves.columns import Curves
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.nc.files import ProgramFiles
from ebamcheck.program import NCProgram, read_program, write_program
from ebamcheck.scan import ScanPlan, plan_stack
from ebamcheck.settings.config import Config
from ebamcheck.showing import short_text
from ebamcheck.showing.columns import Columns
from ebamcheck.showing.plotting import ExtraMissing
from ebamcheck_models import BLADE, CUBE

SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
CONFIG = Config().changed(layers={"layer_height_mm": 2.0})
HOLE = [(4.0, 4.0), (4.0, 6.0), (6.0, 6.0), (6.0, 4.0)]


@pytest.fixture(scope="module")
def layers() -> Layers:
    part = box((0, 0, 0), (40, 30, 6))
    return ebamcheck.slice(part, [1.0, 3.0, 5.0])


@pytest.fixture(scope="module")
def curves(layers: Layers) -> Curves:
    return ebamcheck.fit(layers)


@pytest.fixture(scope="module")
def plan(layers: Layers) -> ScanPlan:
    return plan_stack(layers, CONFIG, order="raster")


@pytest.fixture(scope="module")
def files(curves: Curves, plan: ScanPlan, tmp_path_factory: pytest.TempPathFactory) -> ProgramFiles:
    return write_program(curves, plan, CONFIG, tmp_path_factory.mktemp("program") / "nc")


@pytest.fixture(scope="module")
def program(files: ProgramFiles) -> NCProgram:
    return read_program(files.main, CONFIG)


def test_every_value_is_one_short_line(
    layers: Layers, curves: Curves, plan: ScanPlan, files: ProgramFiles, program: NCProgram
) -> None:
    part = BLADE.tessellate(0.5)
    with ebamcheck.Slicing(part) as slicing:
        values = [
            part, ebamcheck.inspect(part), layers, layers[0], layers[0].rings[0], curves, curves[0], curves[0].pieces[0], plan,
            plan[0], plan[0].islands[0], files, program, program[0], program.files[0], program.events, slicing,
            Config(), Config().changed(layers={"heights_mm": [*range(1, 999)]}),
        ]  # fmt: skip
        lines = [repr(value) for value in values]
    for line in lines:
        assert len(line) <= short_text.LONGEST, line
        assert line.startswith("<")
        assert "\n" not in line
        assert "array(" not in line
    assert len(set(lines)) == len(lines)


def test_names_break_no_line_and_settings_tell_what_is_not_default() -> None:
    line = repr(ebamcheck.Part(np.zeros((0, 3)), np.zeros((0, 3), np.int32), name="a\x1b[31m\n" * 100))
    assert "\n" not in line
    assert "\x1b" not in line
    assert len(line) <= short_text.LONGEST
    assert repr(Config()) == "<Config: the default settings>"
    changed = repr(CONFIG.changed(process={"bead_width_mm": 5.0}))
    assert "layers.layer_height_mm = 2.0" in changed
    assert "process.bead_width_mm = 5.0" in changed
    assert "machine." not in changed


def test_notebooks_get_tables_that_are_well_formed(
    layers: Layers, curves: Curves, plan: ScanPlan, program: NCProgram
) -> None:
    part = ebamcheck.Part(CUBE.tessellate(0.1).vertices, CUBE.tessellate(0.1).faces, name="<b>&")
    for value in (part, ebamcheck.inspect(part), layers, layers[1], curves, plan, program):
        tree = ElementTree.fromstring(value._repr_html_())
        assert len(list(tree.iter("th"))) >= 3
    assert "<b>&" in "".join(ElementTree.fromstring(part._repr_html_()).itertext())
    assert len(list(ElementTree.fromstring(layers[1]._repr_html_()).iter())) > 10


# -- items -----------------------------------------------------------------------------------------


def test_layers_and_rings_are_the_columns() -> None:
    stack = from_rings([1.0, 2.0, 3.0], [[SQUARE, HOLE], [], [SQUARE]], [[], [[(0, 0), (5, 0)]], []])
    found = list(stack)
    assert [layer.height_mm for layer in found] == stack.heights.tolist()
    assert [layer.area_mm2 for layer in found] == pytest.approx(stack.areas().tolist())
    assert [layer.perimeter_mm for layer in found] == pytest.approx(stack.perimeters().tolist())
    assert [len(layer) for layer in found] == [2, 1, 1]
    assert sorted(ring.kind for ring in found[0]) == ["hole", "outer"]
    assert [ring.kind for ring in found[1]] == ["open path"]
    assert sum(ring.area_mm2 for ring in found[0]) == pytest.approx(96.0)
    assert sum(p.area for p in found[0].polygons) == pytest.approx(96.0)
    rings = np.concatenate([ring.points for layer in stack for ring in layer])
    np.testing.assert_array_equal(rings, stack.points)


def test_parts_of_a_stack_by_slice(layers: Layers) -> None:
    assert layers[1:].heights.tolist() == [3.0, 5.0]
    assert layers[::-1].heights.tolist() == [5.0, 3.0, 1.0]
    assert len(layers[2:1]) == 0


def test_pieces_of_curves_are_the_columns(curves: Curves) -> None:
    assert curves.settings is not None
    assert curves.method in LIFTED
    pieces = [piece for layer in curves for piece in layer]
    assert len(pieces) == curves.kind.size
    np.testing.assert_array_equal(np.concatenate([p.control for p in pieces]), curves.control)
    assert [p.layer for p in pieces] == sorted(p.layer for p in pieces)


def test_islands_come_in_scan_order_with_their_lines(plan: ScanPlan) -> None:
    assert [layer.height_mm for layer in plan] == plan.heights.tolist()
    islands = [island for layer in plan for island in layer]
    assert [island.index for island in islands] == plan.order.tolist()
    assert [island.rank for island in plan[1]] == list(range(len(plan[1])))
    assert sum(len(island.lines) for island in islands) == len(plan.vectors)
    for island in islands:
        assert island.area_mm2 == pytest.approx(island.polygon.area)
    assert plan[0].metrics["area_mm2"] == pytest.approx(1200.0)


def test_motions_come_in_the_order_of_execution(program: NCProgram) -> None:
    motions = list(program)
    assert len(motions) == len(program)
    assert [m.where for m in motions] == [program.where(k) for k in range(len(program))]
    laid = sum(m.length_mm for m in motions if m.deposits)
    assert laid == pytest.approx(float(program.lengths[program.deposit].sum()))
    for before, after in itertools.pairwise(motions[1:]):
        assert after.start_mm == pytest.approx(before.end_mm, nan_ok=True)
    assert program[-1] == motions[-1]
    with pytest.raises(IndexError, match="no motion"):
        program[len(program)]


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
    names = ("a", "bb", "ccc")
    bottles = Bottles(*names, owner="Ann")
    assert tuple(bottles) == names
    assert [bottles[k] for k in range(-3, 3)] == [names[k] for k in range(-3, 3)]
    with pytest.raises(SettingsError, match="no bottle 3: the crate has 3 bottles, from 0"):
        bottles[3]
    with pytest.raises(IndexError):
        bottles[-4]
    assert repr(bottles) == "<Bottles: 3 bottles, Ann>"
    assert repr(Bottles("a")) == "<Bottles: 1 bottle>"
    cells = [
        e.text for e in ElementTree.fromstring(Bottles("a")._repr_html_()).iter() if e.tag in ("th", "td")
    ]
    assert cells == ["bottles", "1", "owner", "not named", "letters", "1"]


# -- runs ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_check_from_python_is_that_of_the_command_line(tmp_path: Path) -> None:
    file = ebamcheck.save(box((0, 0, 0), (20, 20, 6)), tmp_path / "box.stl")
    settings = ebamcheck.save(
        Config().changed(layers={"layer_height_mm": 2.0}, slicing={"backends": ("planecut", "manifold")}),
        tmp_path / "settings.toml",
    )
    made = ebamcheck.check(file, tmp_path / "box.run", settings)
    assert made.verdict == "AGREED"
    assert made.is_check
    assert made.slicers == ("manifold", "planecut")
    assert [gate.name for gate in made.gates] == ["input", "agreement"]
    assert made.layers_of("manifold").heights.tolist() == [1.0, 3.0, 5.0]
    assert repr(ebamcheck.Run(made.path)) == repr(made)
    ElementTree.fromstring(made._repr_html_())
    with pytest.raises(InputError, match="wrote no program"):
        _ = made.program
    with pytest.raises(InputError, match=r"has no curves\.parquet"):
        _ = made.curves
    with pytest.raises(InputError, match="has no layers of 'stencil': it has manifold, planecut"):
        made.layers_of("stencil")


def test_a_run_needs_a_file_and_a_folder_that_is_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"save it first: ebamcheck\.save"):
        ebamcheck.run(box((0, 0, 0), (1, 1, 1)))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="is no run folder"):
        ebamcheck.Run(tmp_path)


# -- plots -----------------------------------------------------------------------------------------


def test_without_matplotlib_the_extra_is_named(layers: Layers, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ExtraMissing, match=r"plot\(\) needs matplotlib.*pip install 'ebamcheck\[plot\]'"):
        layers[0].plot()


def test_plots_draw_every_line_on_the_axes_given(
    layers: Layers, curves: Curves, plan: ScanPlan, program: NCProgram, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is an extra and is not installed")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 2)
    assert layers[0].plot(axes[0, 0]) is axes[0, 0]
    (x0, x1), (y0, y1) = axes[0, 0].get_xlim(), axes[0, 0].get_ylim()
    assert x0 <= 0 and x1 >= 40 and y0 <= 0 and y1 >= 30  # noqa: PT018
    assert "curves of layer 3" in curves.plot(2, axes[0, 1]).get_title()
    drawn = plan.plot(1, axes[1, 0])
    assert len(drawn.collections[0].get_paths()) == len(plan[1])
    assert len(drawn.collections[1].get_paths()) == len(plan.vectors_of(1))
    drawn = program.plot(1, ax=axes[1, 1])
    paths = sum(len(c.get_paths()) for c in drawn.collections)
    known = np.isfinite(program.start[:, :2]).all(axis=1)
    assert paths == int(np.count_nonzero(known & (program.layer == 1)))
    figure.canvas.draw()
    pyplot.close("all")


def test_stacks_and_parts_are_drawn_in_space(layers: Layers, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is an extra and is not installed")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    from matplotlib import pyplot

    part = CUBE.tessellate(0.1)
    assert part.plot().get_zlim() == pytest.approx((0.0, 20.0))
    ax = layers.plot()
    assert ax.get_zlim() == pytest.approx((1.0, 5.0))
    with pytest.raises(SettingsError, match="give plain ones"):
        layers[0].plot(ax)
    _, flat = pyplot.subplots()
    with pytest.raises(SettingsError, match="give three-dimensional ones"):
        part.plot(flat)
    pyplot.close("all")
