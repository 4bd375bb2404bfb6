"""Programs of layers on a part that is half built: every height that is told counts from the plate, not from what stands."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import FAST, ebamcheck, write_stl
from parts import box

from ebamcheck.checks.rules import with_remedies
from ebamcheck.comparison import compare_all
from ebamcheck.layers.stack import from_rings
from ebamcheck.live.relaying import finished_run
from ebamcheck.pipeline.findings import _at
from ebamcheck.pipeline.finishing import _comparison_record
from ebamcheck.pipeline.gates import agreement_gate
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Outcome

BASE_MM, STEP_MM = 5.0, 1.6
CUTS = [BASE_MM + (k + 0.5) * STEP_MM for k in range(3)]
CONFIG = Config().changed(layers={"heights_mm": CUTS, "base_mm": BASE_MM, "layer_height_mm": STEP_MM})
SQUARE = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)])


def test_a_disagreement_names_the_height_over_the_plate():
    cuts = [0.5, 1.1, 1.7]
    layers = {
        "a": from_rings(cuts, [[SQUARE]] * 3),
        "b": from_rings(cuts, [[SQUARE], [SQUARE], [SQUARE * 0.5]]),
    }
    found = compare_all(
        layers, box(), {"a": (0.0, 0.0), "b": (0.0, 0.0)}, dict.fromkeys("ab", True), dict.fromkeys("ab", "half-open")
    )  # fmt: skip
    outcomes = {name: Outcome(name, file=box()) for name in "ab"}
    gate = agreement_gate(found, outcomes, 3, 1.0, BASE_MM)
    assert not gate.passed
    # Three layers of 0.6 mm on what stands.
    assert f"of layer 3, cut at z = 1.700 mm, Z {BASE_MM + 1.8:.3f} mm" in gate.text
    recorded = _comparison_record(found, CONFIG)["findings"]
    assert [entry["program_z_mm"] for entry in recorded] == pytest.approx([BASE_MM + 1.8] * len(recorded))


def test_a_failed_check_and_a_warning_name_the_height_over_the_plate():
    nc = SimpleNamespace(
        files=(SimpleNamespace(name="MAIN_L0002.SPF"),), file=np.zeros(1, int), line=np.array([9]), layer=np.array([1])
    )  # fmt: skip
    check = Check("section", False, 0.2, 0.1, "mm", "MAIN_L0002.SPF:9", "at most 0.2 mm")
    (found,) = with_remedies([check], nc, np.array(CUTS), STEP_MM, BASE_MM)
    assert f"Z {BASE_MM + 2 * STEP_MM:.3f} mm" in found.place
    assert f"{BASE_MM + 2 * STEP_MM:.3f}" in _at(1, np.array(CUTS), CONFIG, 1.0, 2.0)


def test_a_run_on_what_stands_has_its_entry_program_and_is_verified_again(tmp_path):
    write_stl(box(upper=(30, 24, 12)), tmp_path / "box.stl")
    (tmp_path / "half.toml").write_text(
        f"[layers]\nheights_mm = {CUTS}\nbase_mm = {BASE_MM}\nlayer_height_mm = {STEP_MM}\n"
    )
    done = ebamcheck(
        "run", "box.stl", "-o", "half.run", "-c", "half.toml", "--backends", FAST, "--from-layer", 2, cwd=tmp_path
    )  # fmt: skip
    # How warm it is under the program is not known, and so it is not validated; all other gates are open.
    assert done.returncode == 1, done.stdout + done.stderr
    manifest = json.loads((tmp_path / "half.run" / "run.json").read_text())
    shut = {gate["name"]: gate["text"] for gate in manifest["gates"] if not gate["passed"]}
    assert list(shut) == ["heat"]
    assert "layers.base_mm" in shut["heat"]
    check = manifest["program"]["entry"]["check"]
    assert check["passed"], check
    again = ebamcheck("verify", "half.run", "--part", "box.stl", "--json", cwd=tmp_path)
    failed = {check["name"] for check in json.loads(again.stdout) if not check["passed"]}
    assert failed == {"gate heat"}, failed
    found = finished_run(tmp_path / "half.run", tmp_path / "box.stl")
    assert found.tops_mm == pytest.approx(BASE_MM + STEP_MM * np.arange(1, 4))
    assert found.thickness_mm == pytest.approx(np.full(3, STEP_MM))
