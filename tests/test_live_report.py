"""A build after the fact: every published layer verified from its text by one command, and the page that shows it."""

import hashlib
import json
import re
import shutil

import numpy as np
import pytest
from command_line import ebamcheck

from ebamcheck.json_values import sha256_of_file
from ebamcheck.live.building import Building, answer_to
from ebamcheck.live.heights_table import ticks
from ebamcheck.live.publishing import FIRST
from ebamcheck.live.verifying import read_verified, verify_build

SIZE = (42, 36, 7)


@pytest.fixture(scope="module")
def built(place, maker, tmp_path_factory):
    """Folder with the box, and a build of it whose layers grew a tenth too high."""
    folder = tmp_path_factory.mktemp("report")
    shutil.copy(place / "box.stl", folder)
    building = Building(maker, folder / "box.live")
    answer = building.start()
    answer_to(building, b'{"event": "height", "done": 1, "height_mm": 900}')
    while answer["answer"] == "published":
        height_mm = answer["base_mm"] + 1.1 * answer["thickness_mm"]
        answer = building.height({"event": "height", "done": answer["layer"], "height_mm": height_mm})
    building.close()
    assert answer["answer"] == "done"
    return folder


def test_one_command_verifies_every_layer_of_a_build_from_its_text(built):
    done = ebamcheck("verify", "box.live", "--part", "box.stl", cwd=built)
    assert done.returncode == 0, done.stdout + done.stderr
    count = len(list((built / "box.live" / "layers").iterdir()))
    assert f"{count} of {count} published layers verify from their text alone" in done.stdout
    assert done.stdout.count("pass  MAIN_K") == count
    found = read_verified(built / "box.live")
    assert len(found) == count
    assert all(layer.passed and layer.checks > 50 for layer in found.values())
    assert ebamcheck("verify", "box.live", cwd=built).returncode == 2  # the part is not named


@pytest.mark.parametrize("fault", ["file", "gone", "journal"])
def test_a_layer_that_was_altered_does_not_verify(fault, built, tmp_path):
    shutil.copytree(built / "box.live", tmp_path / "box.live")
    program = tmp_path / "box.live" / "layers" / "MAIN_K0002R1" / "program" / "MAIN_K0002R1_L0001.SPF"
    if fault == "journal":
        # Somebody who alters the file and the journal's hash breaks the chain of the journal.
        journal = tmp_path / "box.live" / "journal.jsonl"
        lines = journal.read_text().split("\n")
        lines[3] = lines[3].replace("height", "heigth")
        journal.write_text("\n".join(lines))
        done = ebamcheck("verify", "box.live", "--part", built / "box.stl", cwd=tmp_path)
        assert done.returncode == 2
        assert "journal.jsonl:" in done.stderr
        return
    program.unlink() if fault == "gone" else program.write_text(program.read_text() + "; more\n")
    found = verify_build(tmp_path / "box.live", built / "box.stl")
    assert [layer.name for layer in found if not layer.passed] == ["MAIN_K0002R1"]


class Forged:
    """A build that another program might have made: files and journal fit each other, whatever was done to them."""

    def __init__(self, built, folder):
        self.built, self.folder = built, folder / "box.live"
        shutil.copytree(built / "box.live", self.folder)
        self.entries = [json.loads(line) for line in (self.folder / "journal.jsonl").read_text().splitlines()]

    def layer(self, k):
        return self.folder / "layers" / f"MAIN_K{k:04d}R1"

    def edit(self, k, file, pattern, replacement):
        path = self.layer(k) / file
        text = re.sub(pattern, replacement, path.read_text(), count=1)
        assert text != path.read_text()
        path.write_text(text)

    def sub(self, k, pattern, replacement):
        self.edit(k, f"program/MAIN_K{k:04d}R1_L0001.SPF", pattern, replacement)

    def current(self, **values):
        path = self.folder / "current.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | values))

    def swap(self, k, other):
        """Each layer under the name of the other one."""
        self.layer(k).rename(self.folder / "held")
        self.layer(other).rename(self.layer(k))
        (self.folder / "held").rename(self.layer(other))
        for to, of in ((k, other), (other, k)):
            names = f"K{of:04d}", f"K{to:04d}"
            for path in [p for p in self.layer(to).rglob("*") if p.is_file()]:
                path.write_text(path.read_text().replace(*names))
                path.rename(path.with_name(path.name.replace(*names)))

    def failed(self):
        """Names and reasons, with all hashes of files and journal made anew."""
        last, lines = FIRST, []
        for entry in self.entries:
            if entry["kind"] == "layer":
                layer = self.folder / "layers" / entry["name"]
                entry["files"] = {name: sha256_of_file(layer / "program" / name) for name in entry["files"]}
                paper = json.loads((layer / "layer.json").read_text())
                paper["files"] = entry["files"]
                (layer / "layer.json").write_text(json.dumps(paper))
            entry["after"] = last
            lines.append(json.dumps(entry, sort_keys=True, separators=(",", ":")) + "\n")
            last = hashlib.sha256(lines[-1].encode()).hexdigest()
        (self.folder / "journal.jsonl").write_text("".join(lines))
        current = json.loads((self.folder / "current.json").read_text())
        if current["sha256"] != "0" and (path := self.folder / current["program"]).is_file():
            self.current(sha256=sha256_of_file(path))
        return {
            layer.name: layer.why for layer in verify_build(self.folder, self.built / "box.stl") if not layer.passed
        }

    def without(self, kind, nth):
        index = [i for i, entry in enumerate(self.entries) if entry["kind"] == kind][nth]
        return self.entries.pop(index)

    def height(self, done, more_mm):
        entry = next(e for e in self.entries if e["kind"] == "height" and e["done"] == done)
        entry["height_mm"] += more_mm


LAST = 4
FORGED = {
    "nothing": (lambda f: None, None, ""),
    "layers that change places": (lambda f: f.swap(2, 3), 2, "number of the layer"),
    "a layer that the journal does not know": (lambda f: f.without("layer", 1), 3, "number of the layer"),
    "a layer on a height that nobody measured": (lambda f: f.without("height", 2), 3, "by the journal on nan mm"),
    "a layer on another height than was measured": (lambda f: f.height(1, 0.3), 2, "by the journal on"),
    "a layer that its settings have on another height": (
        lambda f: f.edit(2, "settings.toml", r"base_mm = [\d.]+", "base_mm = 1.5"), 2, "hash of the settings"),
    "a limit that was raised": (lambda f: f.edit(2, "settings.toml", r"interpass_limit_k = 873", "interpass_limit_k = 1500"), 2, "hash of the settings"),
    "a layer that was not validated": (lambda f: f.edit(2, "layer.json", r'"validated": true', '"validated": false'), 2, "validated"),
    "another part": (lambda f: f.edit(2, "layer.json", r'(?s)("part": .*?"sha256": ")[0-9a-f]{8}', r"\g<1>00000000"), 2, "hash of the part"),
    "the layer before is called": (lambda f: f.current(program="layers/MAIN_K0002R1/program/MAIN_K0002R1_L0001.SPF"), LAST, "current.json"),
    "no wait before the next layer": (lambda f: f.current(wait_s=0.0), LAST, "current.json"),
    "another wait before a layer": (lambda f: f.edit(2, "layer.json", r'"wait_s": [-+.e\d]+', '"wait_s": 4321.0'), 2, "wait before it"),
    "another hash is released": (lambda f: f.current(sha256="0"), LAST, "current.json"),
    "a current that is not there": (lambda f: f.current(program=""), LAST, "current.json"),
    "power that the main program alone sets": (lambda f: f.sub(2, r"N\d+ H2=.*\n((?:.*\n)*?)N\d+ H2=.*\n", r"\1"), 2, "layer by itself"),
    "voltage that the main program alone sets": (lambda f: f.sub(2, r"N\d+ H1=.*\n", ""), 2, "layer by itself"),
    "a layer that ends low": (lambda f: f.sub(2, r"N\d+ G0 Z[\d.]+\n(N\d+ M17)", r"\1"), 2, "layer by itself"),
    "a layer that does not begin with a rise": (lambda f: f.sub(2, r"(N\d+ G0) (Z[\d.]+)\n(; RING 0\n)", r"\1 X0 Y0 \2\n\3"), 2, "layer by itself"),
    "a layer that leaves the beam on": (
        lambda f: f.sub(2, r"N\d+ M63.*\nN\d+ M61.*\nN\d+ G0 Z[\d.]+\n(N\d+ M17)", r"\1"), 2, "layer by itself"),
}  # fmt: skip


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("fault", FORGED)
def test_a_build_that_does_not_hold_together_does_not_verify(fault, built, tmp_path):
    plant, layer, said = FORGED[fault]
    build = Forged(built, tmp_path)
    plant(build)
    found = build.failed()
    if layer is None:
        assert found == {}
        return
    name = f"MAIN_K{layer:04d}R1"
    assert name in found
    assert said in found[name]


def test_the_page_of_a_build_shows_heights_layers_and_refusals(built):
    done = ebamcheck("report", "box.live", "-o", "before.html", cwd=built)
    assert done.returncode == 0, done.stderr
    ebamcheck("verify", "box.live", "--part", "box.stl", cwd=built)
    assert ebamcheck("report", "box.live", "-o", "box.html", cwd=built).returncode == 0
    html = (built / "box.html").read_text()
    assert "BUILT AND VERIFIED" in html
    assert "<strong>BUILT" in (built / "before.html").read_text()
    for head in ("planned", "corrected", "measured"):
        assert f"{head} top, mm" in html
    for head in ("deviation, mm", "cusp, mm", "from its text"):
        assert head in html
    assert "Heights of" in html  # the plot
    assert "1 absurd" in html
    assert re.search(r"10(\.0+)? % over the height that was planned", html)
    rows = re.findall(r"<code>MAIN_K\d{4}R\d_L0001.SPF</code>", html)
    assert len(rows) == len(list((built / "box.live" / "layers").iterdir()))
    assert "http" not in html.replace("http://www.w3.org/2000/svg", "")


def test_a_top_that_is_missed_or_a_layer_that_fails_is_shown_as_such(built, tmp_path):
    shutil.copytree(built / "box.live", tmp_path / "box.live")
    verified = tmp_path / "box.live" / "verified.json"
    rows = [vars(layer) for layer in verify_build(tmp_path / "box.live", built / "box.stl")]
    rows[1]["why"] = "crossings: runs across a bead of its own layer"
    verified.write_text(json.dumps(rows))
    assert ebamcheck("report", "box.live", "-o", "bad.html", cwd=tmp_path).returncode == 0
    html = (tmp_path / "bad.html").read_text()
    assert "OUT OF TOLERANCE" in html
    assert "runs across a bead" in html


def test_a_build_without_a_layer_has_no_page(built, tmp_path):
    (tmp_path / "no.live").mkdir()
    (tmp_path / "no.live" / "journal.jsonl").write_text("")
    done = ebamcheck("report", "no.live", cwd=tmp_path)
    assert done.returncode == 2
    assert "no layer was published yet" in done.stderr


def test_ticks_are_round_and_within():
    random = np.random.default_rng(3)
    for low, width in zip(random.uniform(-50, 50, 200), 10.0 ** random.uniform(-3, 4, 200), strict=True):
        found = ticks(low, low + width)
        assert 2 <= len(found) <= 8
        assert low - 1e-9 * width <= found[0]
        assert found[-1] <= low + width * (1 + 1e-9)
