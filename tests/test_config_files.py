"""Settings files keep what was set in them, whatever is added."""

from __future__ import annotations

import random
import tomllib

import pytest
import tomlkit
from command_line import ebamcheck

from ebamcheck.errors import SettingsError
from ebamcheck.settings.checking import as_toml
from ebamcheck.settings.config import Config, load_config
from ebamcheck.settings.files import merge, merged, write_new

KEYS = [
    (name, key)
    for name, section in tomllib.loads(as_toml(Config())).items()
    for key in type(getattr(Config(), name)).model_fields
    if key in section
]

OURS = """# mine
[process] # of machine 7
bead_width_mm = 5.0  # measured

[slicing.settings.planecut]
overlaps = "keep"
"""


def test_a_file_that_is_there_is_not_written_over(tmp_path):
    path = tmp_path / "ebamcheck.toml"
    write_new(path, Config())
    assert load_config(path) == Config()
    path.write_text(OURS)
    done = ebamcheck("config", "-o", path, cwd=tmp_path)
    assert (done.returncode, path.read_text()) == (2, OURS)
    assert "--merge" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("seed", range(6))
def test_keys_that_are_taken_out_come_back_and_no_other_line_changes(tmp_path, seed):
    path = tmp_path / ("pyproject.toml" if seed % 2 else "ebamcheck.toml")
    gone = random.Random(seed).sample(KEYS, [0, 1, 5, 20, 80, len(KEYS)][seed])
    document = tomlkit.parse(as_toml(Config().changed(process={"bead_width_mm": 5.0}, scan={"seed": 7})))
    for name, key in gone:
        del document[name][key]
    if seed % 2:
        outer = tomlkit.document()
        outer["project"] = {"name": "x"}
        outer["tool"] = {"ebamcheck": document}
        document = outer
    path.write_text(tomlkit.dumps(document))
    before, lines = load_config(path), path.read_text().splitlines()
    made = merge(path)
    assert {text.partition(" = ")[0] for text in made.added} == {f"{name}.{key}" for name, key in gone}
    assert load_config(path) == before
    left = iter(path.read_text().splitlines())
    assert all(line in left for line in lines if line.strip()), "what was there stands in its order"
    assert (merge(path).added, made.unknown) == ([], [])


def test_new_keys_bring_their_explanations_and_comments_stay(tmp_path):
    path = tmp_path / "ebamcheck.toml"
    path.write_text(OURS)
    done = ebamcheck("config", "--merge", path, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    text = path.read_text()
    for line in OURS.splitlines():
        assert line in text
    assert "added process.voltage_kv = 60.0" in done.stdout
    assert "added process.bead_width_mm" not in done.stdout
    assert "# Accelerating voltage.\nvoltage_kv = 60.0\n" in text
    explained = {line for line in as_toml(Config()).splitlines() if line.startswith("# ")}
    left = {line for line in explained if line not in text}
    # The file's own head, and the words of what it has set.
    heads = [
        type(getattr(Config(), name)).__doc__.strip().splitlines()[0]
        for name in ("process", "slicing", "machines")
    ]
    assert left - {f"# {head}" for head in heads} == {
        "# Settings of ebamcheck. Every key may be left out; these are the values in force.",
        "# Width of one bead.",
        "# Settings of each backend, by its name.",
        "# [slicing.settings.NAME]",
    }
    assert load_config(path).slicing.settings == {"planecut": {"overlaps": "keep"}}


def test_unknown_keys_are_told_and_kept(tmp_path):
    path = tmp_path / "ebamcheck.toml"
    path.write_text("[process]\nbead_widht_mm = 5.0\n[bead]\nwidth = 1\n")
    done = ebamcheck("config", "--merge", path, cwd=tmp_path)
    assert done.returncode == 2
    told = done.stderr.splitlines()
    assert len(told) == 2
    assert "process.bead_widht_mm: unknown key (did you mean 'bead_width_mm'?)" in told[0]
    assert "bead: unknown key" in told[1]
    assert tomllib.loads(path.read_text())["process"]["bead_widht_mm"] == 5.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[process]\nbead_width_mm = -1\n", "bead_width_mm"),
        ("a = [\n", "is not TOML"),
        (b"\xff", "UTF-8"),
        (None, "-o"),
    ],
)
def test_a_file_that_cannot_be_merged_stays_as_it_is(tmp_path, text, message):
    path = tmp_path / "ebamcheck.toml"
    data = text.encode() if isinstance(text, str) else text
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(SettingsError, match=message):
        merge(path)
    assert (path.read_bytes() if path.exists() else None) == data


def test_dotted_keys_are_added_to_as_well(tmp_path):
    text = 'slicing.backends = ["planecut"]  # ours\n[machines.a]\nprimary = "planecut"\n'
    made = merged(text, tmp_path / "ebamcheck.toml")
    assert 'slicing.backends = ["planecut"]  # ours\n' in made.text
    assert tomllib.loads(made.text)["slicing"]["primary"] == ""
    assert tomllib.loads(made.text)["machines"] == {"a": {"primary": "planecut"}}
