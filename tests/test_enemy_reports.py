"""Report writers of strangers, and whole runs among enemies."""

from __future__ import annotations

import json
import re
import time

import pytest
from command_line import WIDE_TOML, ebamcheck, frame, write_stl
from enemy_text import TESTS
from fake_distribution import environment, install

from ebamcheck.json_values import sha256_of_file
from ebamcheck.pipeline.reports import write_reports
from ebamcheck.plugins import registry
from ebamcheck.plugins.processes import run_limited

# Bodies of report writers
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


@pytest.fixture(scope="module")
def writers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("writers")
    text = "".join(f"def {name}(run):\n    {body}\n" for name, body in WRITERS.items())
    reports = {name: f"enemy_writers:{name}" for name in WRITERS} | {"html": "enemy_writers:clears"}
    backends = {"fewer": "enemy_plugin:fewer", "gone": "no_such_module:S", "loose": "enemy_plugin:LOOSE"}
    return install(
        folder, "writers", {registry.REPORTS: reports, registry.BACKENDS: backends}, {"enemy_writers": text}
    )


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
    assert loaded.isdisjoint({"ebamcheck.program", "ebamcheck.scan", "pandas"}), (
        "a writer waits for no planning"
    )
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
    (tmp_path / "limited.py").write_text(code)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "work").mkdir()
    begun = time.monotonic()
    lost = run_limited(["limited"], tmp_path / "work", 4.0, 300.0)
    assert re.search(why, lost), lost
    assert "\x1b" not in lost
    assert time.monotonic() - begun < 60.0
