"""Plugins of strangers that crash, hang, lie or leave when they are loaded: they are left out with a reason."""

from __future__ import annotations

import json
import os
import re
import subprocess
import time
from importlib.metadata import EntryPoint

import numpy as np
import psutil
import pytest
from command_line import WIDE_TOML, ebamcheck, frame, write_stl
from enemy_plugin import SLICERS
from fake_distribution import environment, found_here, install
from parts import box

import ebamcheck as api
from ebamcheck.errors import BackendFailed, BackendMissing, SettingsError
from ebamcheck.json_values import sha256_of_file
from ebamcheck.pipeline.reports import write_reports
from ebamcheck.plugins import registry
from ebamcheck.plugins import strangers as plugin_answers
from ebamcheck.plugins.processes import run_limited
from ebamcheck.slicers.isolation import Limits, slice_all
from ebamcheck.slicers.slicing import Slicing

TESTS = os.path.dirname(__file__)

HONEST = """
from ebamcheck_planecut import PlaneCut
from ebamcheck.backend import Probe
import os, signal, sys
class S(PlaneCut):
    name = {name!r}
    priority = 1
"""


AT_IMPORT = {
    "exits": ("import sys; sys.exit(7)", "SystemExit: 7"),
    "leaves": ("import os; os._exit(9)", "ended the process with code 9"),
    "interrupts": ("raise KeyboardInterrupt", "KeyboardInterrupt"),
    "base": ("class Odd(BaseException): pass\nraise Odd('no')", "Odd: no"),
    "crashes": ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "ended the process by SIGSEGV"),
    "text-priority": (HONEST + "    priority = 'high'", "its priority is 'high', not a whole number"),
    "text-exact": (HONEST + "    exact = 'yes'", "its exact is 'yes', not True or False"),
    "odd-rule": (HONEST + "    coplanar_rule = 'mine'", "its coplanar_rule is 'mine', not 'half-open' or 'undefined'"),
    "no-model": (HONEST + "    Settings = 5", "its Settings is 5, not a BackendSettings"),
    "planecut": (HONEST, "its name is that of a plugin of ebamcheck"),
}  # fmt: skip
"""Module, and why its slicer is left out."""

AT_PROBE = {
    "probe-exits": ("sys.exit(5)", "its probe raised SystemExit: 5"),
    "probe-leaves": ("os._exit(9)", "ended the process with code 9"),
    "probe-crashes": ("os.kill(os.getpid(), signal.SIGSEGV)", "by SIGSEGV"),
    "probe-none": ("return None", "its probe returned NoneType, not a Probe"),
    "probe-text": ("return 'yes'", "its probe returned str, not a Probe"),
    "probe-odd": ("return Probe('perhaps')", "its probe's available is 'perhaps', not True or False"),
}
"""Body of a probe, and why its slicer is not available."""


QUICK = ("exits", "leaves", "crashes", "text-priority", "planecut", "probe-leaves", "probe-none")
"""Each of them is asked in a process of its own: quick tests have a few."""

OTHERS = [name for name in (*AT_IMPORT, *AT_PROBE) if name not in QUICK]


def module(name):
    return "enemy_" + name.replace("-", "_")


def slicers(names):
    """Entry points and modules of some of the above."""
    texts = {module(name): text.format(name=name) for name, (text, _) in AT_IMPORT.items()}
    for name, (body, _) in AT_PROBE.items():
        texts[module(name)] = HONEST.format(name=name) + f"    def probe(self):\n        {body}\n"
    return {name: f"{module(name)}:S" for name in names}, {module(name): texts[module(name)] for name in names}


@pytest.fixture(scope="module")
def enemies(tmp_path_factory):
    """A few of the above as one distribution, and the folder that it lies in."""
    folder = tmp_path_factory.mktemp("enemies")
    points, texts = slicers(QUICK)
    groups = {
        registry.BACKENDS: points,
        registry.MODELS: {"exits": "enemy_exits:S"},
        registry.REPORTS: {"leaves": "enemy_leaves:S"},
        registry.COMMANDS: {"crashes": "enemy_crashes:S", "config": "enemy_leaves:S"},
    }
    return install(folder, "enemies", groups, texts)


@pytest.fixture
def here(enemies, monkeypatch):
    found_here(enemies, monkeypatch)
    yield enemies
    registry.forget()


@pytest.fixture(scope="module")
def told(enemies):
    return asked(enemies)


def asked(folder):
    """What `ebamcheck backends` says, as text and as JSON; the JSON by name."""
    with pytest.MonkeyPatch.context() as patch:
        found_here(folder, patch)
        # In one process, where each plugin is asked once.
        text = ebamcheck("backends", cwd=folder)
        records = ebamcheck("backends", "--json", cwd=folder)
        registry.forget()
    assert (text.returncode, records.returncode) == (0, 0), text.stderr + records.stderr
    return text.stdout, json.loads(records.stdout)


@pytest.mark.parametrize("name", [name for name in AT_IMPORT if name in QUICK])
def test_a_plugin_that_breaks_is_left_out_with_a_reason(told, name):
    assert_left_out(told, name)


@pytest.mark.parametrize("name", [name for name in AT_PROBE if name in QUICK])
def test_a_probe_that_breaks_makes_its_slicer_unavailable(told, name):
    assert_unavailable(told, name)


@pytest.mark.slow
def test_so_it_is_with_all_the_others(tmp_path):
    points, texts = slicers(OTHERS)
    told = asked(install(tmp_path, "enemies", {registry.BACKENDS: points}, texts))
    for name in OTHERS:
        (assert_left_out if name in AT_IMPORT else assert_unavailable)(told, name)


def assert_left_out(told, name):
    text, records = told
    (record,) = [r for r in records if r["name"] == name and r.get("broken") and r["group"] == registry.BACKENDS]
    assert AT_IMPORT[name][1] in record["why"]
    assert record["distribution"] == "enemies 1"
    assert f"left out: plugin {name!r}" in text


def assert_unavailable(told, name):
    (record,) = [r for r in told[1] if r["name"] == name]
    assert record["available"] is False
    assert AT_PROBE[name][1] in record["why"]


def test_the_house_goes_on_and_is_not_shadowed(told, here):
    listed = {r["name"]: r for r in told[1] if not r.get("broken")}
    assert listed["planecut"]["available"]
    assert listed["planecut"]["priority"] != 1
    groups = {(r["group"], r["name"]) for r in told[1] if r.get("broken")}
    assert {
        (registry.MODELS, "exits"),
        (registry.REPORTS, "leaves"),
        (registry.COMMANDS, "crashes"),
    } <= groups
    with pytest.warns(registry.BrokenPluginWarning, match="'planecut' of ebamcheck.backends"):
        assert type(registry.slicer("planecut")).__module__ == "ebamcheck_planecut"


def test_a_plugin_that_hangs_at_import_is_ended(tmp_path, monkeypatch):
    install(
        tmp_path,
        "hangs",
        {registry.BACKENDS: {"hangs": "hanging:S"}},
        {"hanging": "import time; time.sleep(600)"},
    )
    found_here(tmp_path, monkeypatch)
    monkeypatch.setenv(plugin_answers.TIME_VARIABLE, "3")
    with pytest.warns(registry.BrokenPluginWarning, match="it took over 3 s"):
        assert "hangs" not in registry.slicers()
    registry.forget()
    monkeypatch.setenv(plugin_answers.TIME_VARIABLE, "soon")
    with pytest.raises(SettingsError, match="EBAMCHECK_PLUGIN_TIME_S='soon'"):
        plugin_answers.ask(EntryPoint("a", "b:c", registry.BACKENDS), "load")


def test_no_process_is_started_where_there_are_no_strangers(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("a process was started")

    registry.forget()
    monkeypatch.setattr(subprocess, "Popen", refuse)
    assert "planecut" in registry.slicers()
    assert registry.broken_plugins() == []
    registry.forget()


def counted(folder, text, version="1"):
    """A distribution whose import leaves a mark."""
    head = f"open({str(folder / 'imports')!r}, 'a').write('x')\n"
    return install(
        folder, "counted", {registry.BACKENDS: {"counted": "counting:S"}}, {"counting": head + text}, version
    )


def imports(folder):
    return len((folder / "imports").read_text())


def answer():
    registry.forget()
    return registry.slicer("counted").summary


def test_answers_are_kept_until_code_version_or_file_change(tmp_path, monkeypatch):
    text = HONEST.format(name="counted")
    counted(tmp_path, text)
    found_here(tmp_path, monkeypatch)
    answer()
    answer()
    assert imports(tmp_path) == 1
    plugin_answers.cache_file().write_text("{no json", encoding="utf-8")
    answer()
    assert imports(tmp_path) == 2
    kept = json.loads(plugin_answers.cache_file().read_text())
    (record,) = kept["plugins"].values()
    record["stamp"] = record["stamp"].replace("counted 1", "counted 0")
    record["answer"] = record["answer"].replace("exact plane cut", "forged")
    plugin_answers.cache_file().write_text(json.dumps(kept), encoding="utf-8")
    assert "forged" not in answer()
    assert imports(tmp_path) == 3
    (tmp_path / "counting.py").write_text((tmp_path / "counting.py").read_text() + "    summary = 'another'\n")
    assert answer() == "another"
    registry.forget()


def test_settings_of_a_stranger_are_checked_by_it(tmp_path, monkeypatch):
    text = HONEST.format(name="counted") + (
        "    from ebamcheck.backend import BackendSettings as B\n    class Settings(B):\n        grid_mm: float = 0.5\n"
    )
    counted(tmp_path, text)
    found_here(tmp_path, monkeypatch)
    assert registry.slicer_settings("counted", {}).model_dump() == {"grid_mm": 0.5}
    assert registry.slicer_settings("counted", {"grid_mm": 2}).model_dump() == {"grid_mm": 2.0}
    # A baseline is known by the settings that are no defaults.
    for values in ({}, {"grid_mm": 0.5}, {"grid_mm": 2.0}):
        dumped = registry.slicer_settings("counted", values).model_dump(mode="json", exclude_defaults=True)
        assert dumped == {k: v for k, v in values.items() if v != 0.5}
    with pytest.raises(
        SettingsError,
        match=r"'counted': grid_mm: it takes a number, such as 0.5 \(given 'wide'\); known keys: grid_mm",
    ):
        registry.slicer_settings("counted", {"grid_mm": "wide"})
    registry.forget()


# -- slicers of strangers, each in a process of its own -------------------------------------------------------


HEIGHTS = np.linspace(0.1, 1.9, 40)


@pytest.fixture(scope="module")
def slicing_enemies(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slicing")
    points = {name: f"enemy_plugin:{name.replace('-', '_')}" for name in SLICERS}
    points |= {"forks": "enemy_plugin:FORKS", "loose": "enemy_plugin:LOOSE"}
    return install(folder, "slicing-enemies", {registry.BACKENDS: points})


QUICK_SLICERS = [*SLICERS][::4]
"""Each of them takes two processes: quick tests have a few."""


@pytest.fixture(
    scope="module",
    params=[
        QUICK_SLICERS,
        pytest.param([n for n in SLICERS if n not in QUICK_SLICERS], marks=pytest.mark.slow),
    ],
    ids=["some", "others"],
)
def sliced(request, slicing_enemies, tmp_path_factory):
    """What became of some of them and of honest slicers, run side by side."""
    with pytest.MonkeyPatch.context() as patch:
        found_here(slicing_enemies, patch, TESTS)
        target = tmp_path_factory.mktemp("layers")
        backends = {name: registry.slicer_settings(name, {}) for name in (*request.param, "planecut", "manifold")}
        steps = dict.fromkeys(backends, 0)

        def progress(name, done):
            steps[name] += done

        outcomes = slice_all(box(), HEIGHTS, backends, target, Limits(time_s=300.0, processes=3), progress)
        registry.forget()
    assert max(steps.values()) <= 40
    return outcomes, target


def test_slicers_that_lie_are_lost_and_reported(sliced):
    liars = {name: outcome for name, outcome in sliced[0].items() if name in SLICERS}
    assert len(liars) >= 4
    for name, outcome in liars.items():
        assert (outcome.failure, outcome.file) == ("crashed", None), name
        assert re.search(SLICERS[name][1], outcome.why), (name, outcome.why)
        assert "\n" not in outcome.why, name


def test_the_others_go_on(sliced):
    outcomes, target = sliced
    for name in ("planecut", "manifold"):
        assert outcomes[name].read().areas() == pytest.approx([4.0] * 40)
    assert sorted(file.name for file in target.iterdir()) == ["manifold.parquet", "planecut.parquet"]


def test_no_child_of_a_worker_outlives_it(slicing_enemies, tmp_path, monkeypatch):
    found_here(slicing_enemies, monkeypatch, TESTS)
    settings = {"forks": registry.slicer_settings("forks", {})}
    assert slice_all(box(), HEIGHTS, settings, tmp_path)["forks"].failure == ""
    sleeping = ["import time; time.sleep(600)"]
    left = []
    for process in psutil.process_iter():
        try:
            if process.cmdline()[2:] == sleeping and process.status() != psutil.STATUS_ZOMBIE:
                left.append(process)
        except psutil.Error:
            continue
    assert left == []
    registry.forget()


def test_a_stranger_slices_in_no_process_but_its_own(slicing_enemies, monkeypatch):
    found_here(slicing_enemies, monkeypatch, TESTS)
    assert api.slice(box(), [1.0], backend="loose").areas().tolist() == [4.0]
    with Slicing(box(), "loose") as slicing:
        assert slicing.at(1.0).areas().tolist() == [4.0]
    with pytest.raises(BackendFailed, match="'leaver' crashed: its process ended with code 0"):
        api.slice(box(), [1.0], backend="leaver")
    with pytest.raises(BackendFailed, match=r"'loose' of slicing-enemies 1 runs in a process of its own only"):
        registry.slicer("loose").prepare(box(), registry.slicer_settings("loose", {}))
    assert registry.one_method("loose", "planecut")
    assert not registry.one_method("manifold", "planecut")
    with pytest.raises(BackendMissing, match="unknown backend 'nobody'"):
        registry.loaded_slicer("nobody")
    registry.forget()


# -- report writers of strangers, and whole runs among enemies ------------------------------------------------


WRITERS = {
    "exits": "import sys; sys.exit(0)",
    "leaves": "import os; os._exit(0)",
    "raises": "raise RuntimeError('no ink')",
    "clears": "import shutil; shutil.rmtree(run.path)",
    "forges": "(run.path / 'run.json').write_text('{}'); (run.path / 'certificate.json').write_text('{}')",
    "links": "import os; os.symlink('/etc/passwd', run.path / 'link.txt')",
    "good": "(run.path / 'mine').mkdir(); (run.path / 'mine' / 'good.txt').write_text(run.manifest()['job']); "
    "import sys; (run.path / 'mine' / 'loaded.txt').write_text(' '.join(sys.modules))",
}
"""Bodies of report writers."""


@pytest.fixture(scope="module")
def writers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("writers")
    text = "".join(f"def {name}(run):\n    {body}\n" for name, body in WRITERS.items())
    reports = {name: f"enemy_writers:{name}" for name in WRITERS} | {"html": "enemy_writers:clears"}
    backends = {"fewer": "enemy_plugin:fewer", "gone": "no_such_module:S", "loose": "enemy_plugin:LOOSE"}
    return install(folder, "writers", {registry.REPORTS: reports, registry.BACKENDS: backends}, {"enemy_writers": text})


@pytest.mark.slow
def test_a_run_among_enemies_is_whole_and_honest(writers, tmp_path):
    write_stl(frame(), tmp_path / "frame.stl")
    (tmp_path / "ebamcheck.toml").write_text(WIDE_TOML)
    done = ebamcheck(
        "check", "frame.stl", "--layer-height", 3, "--backends", "planecut,manifold,fewer,loose",
        cwd=tmp_path, **environment(writers, TESTS),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    folder = tmp_path / "frame.run"
    manifest = json.loads((folder / "run.json").read_text())
    assert manifest["job"] == "check"
    assert {n: b["status"] for n, b in manifest["backends"].items()} == {
        "planecut": "done", "manifold": "done", "fewer": "crashed", "loose": "done",
    }  # fmt: skip
    for name, digest in manifest["files"].items():
        assert sha256_of_file(folder / name) == digest, name
    assert (folder / "report.html").is_file()
    assert (folder / "mine" / "good.txt").read_text() == "check"
    loaded = set((folder / "mine" / "loaded.txt").read_text().split())
    assert "ebamcheck.record.run_folder" in loaded
    assert loaded.isdisjoint({"ebamcheck.program", "ebamcheck.scan", "pandas"}), "a writer waits for no planning"
    assert not {"link.txt", "certificate.json"} & {file.name for file in folder.iterdir()}
    for said in (
        "'exits' of writers 1 was lost: it ended the process with code 0",
        "'leaves' of writers 1 was lost: it ended the process with code 0",
        "'raises' of writers 1 was lost: it ended the process with code 1: RuntimeError: no ink",
        "'clears' of writers 1: it removed files of its copy of the run",
        "'forges' of writers 1: it changed run.json, which is not its own",
        "'forges' of writers 1: certificate.json is a name of the run's own",
        "'links' of writers 1: link.txt is no plain file",
        "plugin 'html' of ebamcheck.reports",
    ):
        assert said in done.stderr, (said, done.stderr)
    # The loose one agrees with everything; the run does not rest on it.
    assert manifest["comparison"]["evidence"] == [
        {"methods": ["planecut", "manifold"], "first_layer": 0, "last_layer": 3}
    ]
    assert "0.7 mm is over 0.6 mm" in manifest["comparison"]["no_evidence"]["loose"]
    assert {"no-evidence", "backend-lost"} <= {f["code"] for f in manifest["findings"]}
    gate = next(g for g in manifest["gates"] if g["name"] == "agreement")
    assert "every one rests on planecut and manifold" in gate["text"]


def test_house_writers_write_where_strangers_may_not(tmp_path):
    """Nothing but the run's own folder is written to; a folder that is no run is left with a note for each writer."""
    notes = []
    write_reports(tmp_path, notes.append)
    assert len(notes) == len(registry.names(registry.REPORTS))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("code", "why"),
    [
        ("hoard = b'x' * 700_000_000; import time; time.sleep(60)", "over the limit of 300 MB"),
        ("import time; time.sleep(60)", "it took over 4 s"),
        ("raise ValueError('a\\x1b[31mb')", r"with code 1: ValueError: a \[31mb$"),
        ("import os, shutil; shutil.rmtree(os.environ['TMPDIR'])", "^$"),
        ("pass", "^$"),
    ],
)
def test_limits_of_a_process(tmp_path, monkeypatch, code, why):
    import re

    (tmp_path / "limited.py").write_text(code)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "work").mkdir()
    begun = time.monotonic()
    lost = run_limited(["limited"], tmp_path / "work", 4.0, 300.0)
    assert re.search(why, lost), lost
    assert "\x1b" not in lost
    assert time.monotonic() - begun < 60.0
