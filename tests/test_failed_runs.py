"""What a failing run says first, and what a failed check names: both checks, the place in part and program, the remedy."""

import logging
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from ebamcheck.checks.checks import OTHERWISE
from ebamcheck.checks.rules import REMEDIES, layer_of, names_of, with_remedies
from ebamcheck.commands.summaries import worst_line
from ebamcheck.pipeline.gates import program_gate
from ebamcheck.plugins.registry import models
from ebamcheck.result import Check, Place
from ebamcheck.testing.accuracy import reference_models
from ebamcheck.testing.conformance import CHECKS
from ebamcheck.testing.solids import sections, simple, winding_rule
from ebamcheck.testing.subject import Raised, Subject

NC = SimpleNamespace(
    files=(SimpleNamespace(name="MAIN.MPF"), SimpleNamespace(name="MAIN_L0001.SPF"), SimpleNamespace(name="MAIN_L0002.SPF")),
    file=np.array([0, 1, 1, 2]),
    line=np.array([9, 20, 30, 20]),
    layer=np.array([-1, 0, 0, 1]),
)  # fmt: skip
CUTS = np.array([5.5, 7.0])


def failed(name, where="MAIN_L0002.SPF:18"):
    return Check(name, False, 0.2, 0.1, "mm", where, "at most 0.2 mm")


def test_both_failed_checks_are_named_with_layer_heights_and_remedy():
    checks = with_remedies(
        [failed("section"), failed("travel", "MAIN_L0001.SPF:25"), failed("feed", "MAIN.MPF:3")],
        NC,
        CUTS,
        1.0,
    )
    text = program_gate(checks).text
    assert text.startswith(
        "3 of 3 checks failed: section at MAIN_L0002.SPF:18, layer 2, cut at z = 7.000 mm, Z 3.000 mm: "
    )
    assert "Z 3.000 mm: at most 0.2 mm; " + REMEDIES["section"] in text
    assert "travel at MAIN_L0001.SPF:25, layer 1, cut at z = 5.500 mm, Z 1.500 mm" in text
    assert text.endswith("and feed")
    assert checks[2].layer is None
    assert checks[2].place == ""


def test_layers_of_places():
    places = ("MAIN_L0001.SPF:1", "MAIN_L0002.SPF:99", "MAIN.MPF:9", "X:1", "")
    assert [layer_of(NC, Place.of_line(where)) for where in places] == [0, 1, None, None, None]


def test_every_check_of_the_metal_has_a_remedy_and_a_passed_one_tells_none():
    assert set(names_of("deposit")) <= set(REMEDIES)
    passed = Check("section", True, 0.0, 0.1, "mm", "", "fine")
    assert with_remedies([passed], NC, CUTS, 1.0) == [passed]
    assert with_remedies([failed("of a plugin")], NC, CUTS, 1.0)[0].remedy == OTHERWISE


def manifest(**changes):
    finding = {
        "layer": 4, "height_mm": 5.5, "backend": "pixels", "against": "planecut", "metric": "depth", "value": 0.3,
        "limit": 0.1, "x_mm": 1.0, "y_mm": 2.0, "cause": "translation", "program_z_mm": 6.0,
        "cause_text": "translation by (0.3, 0) mm (explains 98 % of the difference)", "remedy": "look",
    }  # fmt: skip
    worse = {**finding, "layer": 10, "value": 0.9, "cause_text": "wrong height: cut 1 mm too high"}
    return {
        "exit_code": 1,
        "gates": [
            {"name": "input", "passed": True, "text": ""},
            {"name": "agreement", "passed": False, "text": "no"},
        ],
        "comparison": {"findings": [finding, worse]},
        "findings": [],
        **changes,
    }


def test_the_first_line_is_the_worst_finding_with_cause_size_and_place():
    line = worst_line(manifest())
    assert line.startswith(
        "WORST: pixels against planecut: wrong height: cut 1 mm too high; depth 0.9 over 0.1 at (1.000, "
    )
    assert ") of layer 10, cut at z = 5.500 mm, Z 6.000 mm" in line
    assert line.endswith("; look")
    assert worst_line(manifest(exit_code=0)) == ""
    shut = [{"name": "program", "passed": False, "text": "2 of 37 checks failed"}]
    assert worst_line(manifest(gates=shut)) == "WORST: program: 2 of 37 checks failed"


# -- the kit -------------------------------------------------------------------------------------------


class Odd:
    """A slicer of small parts by the kit's own sections, solid where an odd number of shells is."""

    name, summary, exact, priority = "odd", "odd", True, 0
    coplanar_rule, inside_rule, rule, breaks_over_mm = "half-open", "odd", "odd", np.inf

    class Settings:
        def model_dump(self):
            return {"step_mm": 0.5}

    def error_bound_mm(self, part, settings):
        return 1e-9

    def height_bound_mm(self, part, settings):
        return 0.0

    @contextmanager
    def prepare(self, part, settings):
        def cut(heights, progress=None):
            if (np.asarray(heights) > self.breaks_over_mm).any():
                raise KeyError((26, 27))
            return sections(part, heights, winding_rule(self.rule))

        yield SimpleNamespace(slice=cut)


class House(Odd):
    """Says that it is odd, and is not."""

    rule = "winding > 0"


class Fragile(Odd):
    breaks_over_mm = 1.0


def test_a_slicer_is_held_to_the_rule_that_it_declares_on_models_too():
    chosen = models(["two-spheres"])
    assert not [f for f in reference_models(Subject(Odd, models=chosen)) if f.violated]
    wrong = [f for f in reference_models(Subject(House, models=chosen)) if f.violated]
    assert wrong
    assert "by the rule 'odd'" in wrong[0].text


def test_what_a_slicer_raises_tells_model_settings_height_and_place(caplog):
    (check,) = [c for c in CHECKS if c.name == "bound held"]
    with caplog.at_level(logging.DEBUG):
        (figure,) = check.run(Subject(Fragile))
    assert figure.violated
    assert figure.model == "box"
    assert "KeyError: (26, 27) at z = " in figure.text
    assert "step_mm=0.5" in figure.text
    assert "raised in cut (test_failed_runs.py:" in figure.text
    (record,) = [r for r in caplog.records if r.exc_info]
    assert isinstance(record.exc_info[1], KeyError)


@pytest.mark.parametrize(("heights", "at"), [([1.25, 1.5], 1.25), ([0.5, 1.5], 1.5)])
def test_the_height_is_that_at_which_it_breaks(heights, at):
    with pytest.raises(Raised, match=rf"at z = {at} mm"):
        Subject(Fragile).cut(simple("box"), heights)
