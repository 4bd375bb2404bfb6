"""A build after the fact: every published layer verified from its text by one command, and the page that shows it."""

import hashlib
import json
import re
import shutil

import numpy as np
import pytest
from command_line import FAST, ebamcheck, write_stl
from parts import box

from ebamcheck.json_values import sha256_of_file
from ebamcheck.live.building import Building, answer_to
from ebamcheck.live.heights_table import ticks
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.publishing import FIRST
from ebamcheck.live.relaying import finished_run
from ebamcheck.live.verifying import read_verified, verify_build


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with a run of a box, and a build of it whose layers grew a tenth too high."""
    folder = tmp_path_factory.mktemp("report")
    write_stl(box(upper=(36, 30, 6.7)), folder / "box.stl")
    done = ebamcheck("run", "box.stl", "-o", "box.run", "--backends", FAST, cwd=folder)
    assert done.returncode == 0, done.stderr
    found = finished_run(folder / "box.run")
    with LayerMaker(found.part, found.config, found.primary) as maker:
        building = Building(maker, folder / "box.live")
        answer = building.start()
        answer_to(building, b'{"event": "height", "done": 1, "height_mm": 900}')
        while answer["answer"] == "published":
            height_mm = answer["base_mm"] + 1.1 * answer["thickness_mm"]
            answer = building.height({"event": "height", "done": answer["layer"], "height_mm": height_mm})
        building.close()
    assert answer["answer"] == "done"
    return folder


def test_every_published_layer_is_judged_by_the_form_of_its_beads_as_its_text_is(place):
    found = json.loads((place / "box.live" / "layers" / "MAIN_K0001R1" / "layer.json").read_text())
    assert found["validated"]
    config = finished_run(place / "box.run")
    with LayerMaker(config.part, config.config, config.primary) as maker:
        building = Building(maker, place / "again.live")
        building.start()
        made = building._made(building._last)[1]
        building.close()
    assert {"crossings", "islands once"} & {check.name for check in made[1].checks}


def test_one_command_verifies_every_layer_of_a_build_from_its_text(place):
    done = ebamcheck("verify", "box.live", "--part", "box.stl", cwd=place)
    assert done.returncode == 0, done.stdout + done.stderr
    count = len(list((place / "box.live" / "layers").iterdir()))
    assert f"{count} of {count} published layers verify from their text alone" in done.stdout
    assert done.stdout.count("pass  MAIN_K") == count
    found = read_verified(place / "box.live")
    assert len(found) == count
    assert all(layer.passed and layer.checks > 50 for layer in found.values())
    assert ebamcheck("verify", "box.live", cwd=place).returncode == 2  # the part is not named


@pytest.mark.parametrize("fault", ["file", "text", "gone", "settings"])
def test_a_layer_that_was_altered_does_not_verify(fault, place, tmp_path):
    shutil.copytree(place / "box.live", tmp_path / "box.live")
    layer = tmp_path / "box.live" / "layers" / "MAIN_K0002R1"
    program = layer / "program" / "MAIN_K0002R1_L0001.SPF"
    if fault == "file":
        program.write_text(program.read_text() + "; more\n")
    elif fault == "gone":
        program.unlink()
    elif fault == "settings":
        text = (layer / "settings.toml").read_text()
        (layer / "settings.toml").write_text(re.sub(r"bead_width_mm = [\d.]+", "bead_width_mm = 4.0", text))
    else:
        # Somebody who alters the file and the journal's hash breaks the chain of the journal.
        journal = tmp_path / "box.live" / "journal.jsonl"
        lines = journal.read_text().split("\n")
        lines[3] = lines[3].replace("height", "heigth")
        journal.write_text("\n".join(lines))
        done = ebamcheck("verify", "box.live", "--part", place / "box.stl", cwd=tmp_path)
        assert done.returncode == 2
        assert "journal.jsonl:" in done.stderr
        return
    found = verify_build(tmp_path / "box.live", place / "box.stl")
    assert [layer.name for layer in found if not layer.passed] == ["MAIN_K0002R1"]


class Forged:
    """A build that another program might have made: files and journal fit each other, whatever was done to them."""

    def __init__(self, place, folder):
        self.place, self.folder = place, folder / "box.live"
        shutil.copytree(place / "box.live", self.folder)
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
                place = self.folder / "layers" / entry["name"]
                entry["files"] = {name: sha256_of_file(place / "program" / name) for name in entry["files"]}
                paper = json.loads((place / "layer.json").read_text())
                paper["files"] = entry["files"]
                (place / "layer.json").write_text(json.dumps(paper))
            entry["after"] = last
            lines.append(json.dumps(entry, sort_keys=True, separators=(",", ":")) + "\n")
            last = hashlib.sha256(lines[-1].encode()).hexdigest()
        (self.folder / "journal.jsonl").write_text("".join(lines))
        current = json.loads((self.folder / "current.json").read_text())
        if current["sha256"] != "0" and (path := self.folder / current["program"]).is_file():
            self.current(sha256=sha256_of_file(path))
        return {
            layer.name: layer.why
            for layer in verify_build(self.folder, self.place / "box.stl")
            if not layer.passed
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


@pytest.mark.parametrize("fault", FORGED)
def test_a_build_that_does_not_hold_together_does_not_verify(fault, place, tmp_path):
    plant, layer, said = FORGED[fault]
    build = Forged(place, tmp_path)
    plant(build)
    found = build.failed()
    if layer is None:
        assert found == {}
        return
    name = f"MAIN_K{layer:04d}R1"
    assert name in found
    assert said in found[name]


def test_the_page_of_a_build_shows_heights_layers_and_refusals(place):
    done = ebamcheck("report", "box.live", "-o", "before.html", cwd=place)
    assert done.returncode == 0, done.stderr
    ebamcheck("verify", "box.live", "--part", "box.stl", cwd=place)
    assert ebamcheck("report", "box.live", "-o", "box.html", cwd=place).returncode == 0
    html = (place / "box.html").read_text()
    assert "BUILT AND VERIFIED" in html
    assert "<strong>BUILT" in (place / "before.html").read_text()
    for head in (
        "planned top, mm",
        "corrected top, mm",
        "measured top, mm",
        "deviation, mm",
        "cusp, mm",
        "from its text",
    ):
        assert head in html
    assert "Heights of" in html  # the plot
    assert "1 absurd" in html
    assert re.search(r"10(\.0+)? % over the height that was planned", html)
    rows = re.findall(r"<code>MAIN_K\d{4}R\d_L0001.SPF</code>", html)
    assert len(rows) == len(list((place / "box.live" / "layers").iterdir()))
    assert "http" not in html.replace("http://www.w3.org/2000/svg", "")


def test_a_top_that_is_missed_or_a_layer_that_fails_is_shown_as_such(place, tmp_path):
    shutil.copytree(place / "box.live", tmp_path / "box.live")
    verified = tmp_path / "box.live" / "verified.json"
    rows = [vars(layer) for layer in verify_build(tmp_path / "box.live", place / "box.stl")]
    rows[1]["why"] = "crossings: runs across a bead of its own layer"
    verified.write_text(json.dumps(rows))
    assert ebamcheck("report", "box.live", "-o", "bad.html", cwd=tmp_path).returncode == 0
    html = (tmp_path / "bad.html").read_text()
    assert "OUT OF TOLERANCE" in html
    assert "runs across a bead" in html


def test_a_build_without_a_layer_has_no_page(place, tmp_path):
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
