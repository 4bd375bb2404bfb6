"""The main job from part to validated program: what it makes of parts of every kind."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest
from command_line import FAST, WIDE_TOML, ebamcheck, frame, started, write_stl
from finished_runs import THICK, plate_of_every_slicer, plate_of_two_layers
from parts import box, join, moved, sphere
from pipeline_runs import SETTINGS, Listener, contents, gates, untimed
from slicers_here import slicers_here

from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.json_values import sha256_of_file
from ebamcheck.mesh.part import from_arrays
from ebamcheck.pipeline import check_job, run_job
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.verification.verify import verify_run


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    """A finished run with every backend there is, of a plate with a hole."""
    return plate_of_every_slicer(tmp_path_factory)


@pytest.fixture
def copy(plate, tmp_path):
    """A copy of the finished run, to spoil."""
    return shutil.copytree(plate[0].folder.path, tmp_path / "copy.run")


def test_a_plate_with_a_hole_is_validated(plate):
    result, path = plate
    assert result.exit_code is ExitCode.PASS
    assert set(gates(result)) == {"input", "agreement", "fit", "coverage", "deposit", "heat", "program"}
    assert all(gates(result).values())
    manifest = result.folder.manifest()
    assert manifest["part"]["sha256"] == sha256_of_file(path)
    assert manifest["program"]["validated"] is True
    for name, backend in manifest["backends"].items():
        assert backend["status"] == "done", (name, backend["why"])
        assert result.folder.read_layers(name).areas() == pytest.approx([1376.0] * 2, abs=1.5)
        assert backend["rings"] == 4
    assert all(pair["agree"] == pair["gated"] == 2 for pair in manifest["comparison"]["pairs"])


def test_the_record_names_every_file_and_its_hash(plate):
    folder = plate[0].folder.path
    files = plate[0].folder.manifest()["files"]
    assert set(contents(folder)) == set(files)
    for name, recorded in files.items():
        assert sha256_of_file(folder / name) == recorded, name
    assert {f"program/{f['name']}" for f in plate[0].manifest["program"]["files"]} < set(files)
    assert not list(folder.parent.glob(".*"))


@pytest.fixture
def cut_here():
    with slicers_here():
        yield


@pytest.mark.usefixtures("cut_here")
def test_a_sphere_is_validated(tmp_path):
    # Layers so high that a sphere reaches out by less than a bead from one to the next.
    settings = SETTINGS.changed(layers={"layer_height_mm": 5.0})
    result = run_job(write_stl(sphere(20.0), tmp_path / "ball.stl"), tmp_path / "ball.run", settings)
    assert result.exit_code is ExitCode.PASS, gates(result)
    layers = result.folder.read_layers("planecut")
    lost = np.pi * (20.0**2 - layers.heights**2) - layers.areas()
    inside_mm = 2 * 20.0 * (1 - np.cos(np.pi / 48))  # sagitta of a facet along and across
    assert ((lost > 0) & (lost < 2 * np.pi * 20.0 * inside_mm)).all()


@pytest.mark.slow
def test_runs_differ_in_timings_alone(tmp_path, monkeypatch):
    write_stl(sphere(12.0, 24, 48), tmp_path / "ball.stl")
    (tmp_path / "ebamcheck.toml").write_text(
        f"slicing.backends = {FAST.split(',')}\nscan.annealing_steps = 1000\nlayers.layer_height_mm = 4.0\n{WIDE_TOML}"
    )
    # One as a process of its own, with other hashes of texts, the other in this one.
    monkeypatch.setenv("EBAMCHECK_THREADS", "2")
    other = started("run", "ball.stl", "-o", "1", cwd=tmp_path, EBAMCHECK_THREADS="1")
    for done in (other, ebamcheck("run", "ball.stl", "-o", "2", cwd=tmp_path)):
        assert done.returncode == 0, done.stdout + done.stderr
    assert contents(tmp_path / "1") == contents(tmp_path / "2")
    assert untimed(tmp_path / "1") == untimed(tmp_path / "2")


@pytest.mark.usefixtures("cut_here")
@pytest.mark.slow
def test_inside_out_is_named_and_turned_over_when_asked(tmp_path):
    path = write_stl(from_arrays(frame().vertices, frame().faces[:, ::-1], "in"), tmp_path / "in.stl")
    result = check_job(path, tmp_path / "in.run", SETTINGS)
    assert result.exit_code is ExitCode.OUT_OF_TOLERANCE
    assert "inside-out" in result.manifest["gates"][0]["text"]
    assert result.manifest["comparison"]["verdicts"] == {"empty": 2}
    mended = run_job(path, tmp_path / "mended.run", SETTINGS.changed(part={"fix_orientation": True}))
    assert mended.exit_code is ExitCode.PASS
    turned = [found for found in mended.manifest["findings"] if found["code"] == "facets-turned-over"]
    assert [found["text"] for found in turned] == ["32 of 32 facets were turned over"]


@pytest.mark.in_turn(2)
@pytest.mark.parametrize(
    ("part", "layers", "areas", "shut"),
    [
        (box((0, 0, 0), (30, 2, 8)), {"layer_height_mm": 6.0}, [60.0], {"deposit", "program"}),  # thinner than a bead, whose wire is at its least
        (box((0, 0, 0), (30, 30, 1)), {"layer_height_mm": 6.0}, [900.0], {"deposit"}),  # one layer, six times as high
        (box((0, 0, 0), (30, 30, 9)), {"heights_mm": (1.0, 2.5, 8.9)}, [900.0] * 3, {"deposit"}),  # listed heights, the last one too high
        (moved(frame(), shift=(1e6, 1e6, 0)), {"layer_height_mm": 6.0}, [1376.0] * 2, set()),  # far away
        (moved(frame(), np.eye(3) * 0.05 / 40), {"layer_height_mm": 0.0075}, [1376.0 * 0.05**2 / 1600] * 2, {"deposit", "heat", "program"}),  # tiny
        (join(box((0, 0, 0), (20, 20, 5)), box((0, 0, 13), (20, 20, 18))), {"layer_height_mm": 6.0}, [400, 0, 400], {"program", "deposit"}),  # in the air
    ],
    ids=["thin", "one-layer", "listed", "far", "tiny", "gap"],
)  # fmt: skip
@pytest.mark.usefixtures("cut_here")
@pytest.mark.filterwarnings("ignore:.*check the unit")
def test_parts_at_the_edge(tmp_path, part, layers, areas, shut):
    path = write_stl(part, tmp_path / "part.stl")
    wide = {"travel_max_mm": (2e6, 2e6, 1500.0)}
    result = run_job(
        path,
        tmp_path / "part.run",
        SETTINGS.changed(layers=layers | {"layer_height_mm": layers.get("layer_height_mm")}, machine=wide),
    )
    assert result.folder.read_layers("planecut").areas() == pytest.approx(areas, rel=1e-4)
    # Beads lie beside a part that is thinner than a bead: nothing else is wrong with it.
    assert {gate.name for gate in result.gates if not gate.passed} == shut, [gate.text for gate in result.gates]
    assert result.exit_code is (ExitCode.OUT_OF_TOLERANCE if shut else ExitCode.PASS)


@pytest.mark.usefixtures("cut_here")
def test_units_and_direction(tmp_path):
    path = write_stl(moved(frame(), np.eye(3) * 1e-3), tmp_path / "metres.stl")
    for direction, areas in (
        ((0, 0, -1), [1376.0] * 2),
        ((1, 0, 0), [480.0, 480.0, 12.0 * 24.0, 480.0, 480.0]),
    ):
        height = 8.0 if direction[0] else 6.0
        settings = SETTINGS.changed(part={"units": "m", "direction": direction}, layers={"layer_height_mm": height})
        result = check_job(path, tmp_path / "m.run", settings, force=True)
        assert result.folder.read_layers("planecut").areas() == pytest.approx(areas, rel=1e-4)
        assert gates(result)["agreement"]
        assert result.manifest["part"]["direction"] == list(direction)


def test_heights_beside_the_part_are_refused(tmp_path):
    path = write_stl(frame(), tmp_path / "frame.stl")
    with pytest.raises(SettingsError, match="outside of the part 'frame'"):
        run_job(path, tmp_path / "a.run", SETTINGS.changed(layers={"heights_mm": (100.0, 200.0)}))
    assert not (tmp_path / "a.run").exists()
    with pytest.raises(SettingsError, match="must rise"):
        run_job(path, tmp_path / "a.run", SETTINGS.changed(layers={"heights_mm": (2.0, 1.0)}))


@pytest.mark.parametrize(("solidus_k", "at", "told"), [(900.0, "layer", True), (1877.0, "bead", False)])
@pytest.mark.usefixtures("cut_here")
def test_layers_too_hot_for_the_heat_model_are_told(tmp_path, solidus_k, at, told):
    """The limit, which is never over the solidus, holds at the first bead of each layer alone where the settings say so."""
    listener = Listener()
    settings = SETTINGS.changed(material={"solidus_k": solidus_k}, process={"interpass_at": at})
    result = run_job(write_stl(frame(), tmp_path / "f.stl"), tmp_path / "f.run", settings, observer=listener)
    assert result.exit_code is ExitCode.PASS
    assert listener.notes == []
    rows = pd.read_csv(tmp_path / "f.run" / "scan.csv")
    hot = (rows["entry_max_k"] > solidus_k - 293.15).sum()
    assert (hot > 0) == told
    found = [f for f in result.manifest["findings"] if f["code"] == "heat-above-solidus"]
    assert len(found) == told
    assert all(f["text"].startswith(f"{hot} of {len(rows)} layers") for f in found)
    assert all(f["figure"] == rows["entry_max_k"].max() + 293.15 for f in found)


def test_a_finished_run_is_kept_whatever_is_asked_for(copy, plate):
    (copy / "signatures").mkdir()
    (copy / "signatures" / "jane.json").write_text("{}")
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    with pytest.raises(SettingsError, match=r"holds a run that was finished at .*--force"):
        run_job(plate[1], copy, THICK)
    listener = Listener()
    assert run_job(plate[1], copy, THICK, resume=True, observer=listener).gates == plate[0].gates
    assert (listener.stages, listener.notes) == ([], [f"{copy}: is finished already"])
    assert {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()} == before
    check_job(plate[1], copy, SETTINGS, observer=listener, force=True)
    (kept,) = copy.parent.glob("copy.run.*")
    assert kept.name == f"copy.run.{plate[0].manifest['timings']['finished'].rstrip('Z').replace(':', '')}"
    assert listener.notes[1] == f"{copy}: the former run will be kept as {kept.name}"
    assert {copy / path.relative_to(kept): path.read_bytes() for path in kept.rglob("*") if path.is_file()} == before
    assert RunFolder(copy).manifest()["job"] == "check"


def test_settings_and_part_change_the_fingerprint(tmp_path, monkeypatch):
    """What a killed run left is not taken up by a run of something else."""
    from ebamcheck.pipeline import job

    seen = []

    class Enough(Exception):
        pass

    def stop(target, fingerprint, resume, force):
        seen.append(fingerprint)
        raise Enough

    monkeypatch.setattr(job, "start_run", stop)
    one, other = write_stl(frame(), tmp_path / "a.stl"), write_stl(box(), tmp_path / "b.stl")
    for path, settings, reference, layer in [
        (one, SETTINGS, None, 1),
        (one, SETTINGS, None, 1),
        (one, SETTINGS.changed(scan={"seed": 1}), None, 1),
        (one, SETTINGS.changed(slicing={"settings": {"planecut": {"overlaps": "keep"}}}), None, 1),
        (one, SETTINGS, one, 1),
        (other, SETTINGS, None, 1),
        (one, SETTINGS, None, 2),
    ]:
        with pytest.raises(Enough):
            run_job(path, tmp_path / "x.run", settings, reference, from_layer=layer)
    assert seen[0] == seen[1]
    assert len(set(seen)) == 6


def test_a_check_slices_and_compares_and_makes_no_program(tmp_path, tmp_path_factory):
    path = write_stl(frame(), tmp_path / "a.stl")
    checked = check_job(path, tmp_path / "check.run", SETTINGS)
    whole = plate_of_two_layers(tmp_path_factory)
    assert checked.exit_code == ExitCode.PASS
    assert gates(checked) == {"input": True, "agreement": True}
    for name in ("layers.csv", "compare.csv", "compare.parquet", "layers/planecut.parquet"):
        assert sha256_of_file(tmp_path / "check.run" / name) == sha256_of_file(whole / name)
    assert not (tmp_path / "check.run" / "program").exists()
    page = (tmp_path / "check.run" / "report.html").read_text()
    assert "✔ AGREED" in page
    assert "program/" not in page
    assert all(check.passed for check in verify_run(tmp_path / "check.run", path))
