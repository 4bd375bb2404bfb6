"""Draw the pictures of README.md from a finished run of the demo part: ``python reports/pictures/draw.py demo/run``; that of the
viewer where chromium is installed."""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from ebamcheck.checks.metal import deposit
from ebamcheck.layers.stack import Layers
from ebamcheck.layers.svg import layer_svg, overlay_svg, sheet_svg
from ebamcheck.program import NCProgram, read_program
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.scan import ScanPlan
from ebamcheck.scan.plan.comparing import SEEDS, OrderComparison, compared_orders, figures_of
from ebamcheck.settings.config import Config
from ebamcheck.showing.markup import FONT
from ebamcheck.showing.pictures import Scene, islands_svg, pareto_svg
from ebamcheck_reports import part_picture, program_pictures
from ebamcheck_reports.markup import Markup, element
from ebamcheck_reports.run_data import RunData, layer_name
from ebamcheck_reports.sections import agreement, scan
from ebamcheck_reports.sections import metal as metal_section
from ebamcheck_viewer.contents import of_run
from ebamcheck_viewer.page import document

ROOT_LAYER, BLADE_LAYER = 12, 57
"""A layer of the root, which is partitioned into hexagons, and one through the hollow blade."""

WORST_LIMITS = 1.0
"""Half the height of the enlarged place, which is three times as wide, over the limit of the pair."""

METHODS = {
    "embree": "rays",
    "manifold": "solid modelling",
    "planecut": "an exact sweep",
    "stencil": "pixels, as in the paper",
}
"""How the house slicers find their contours, in a few words."""

SHOWN_BLOCKS = "G0", "M60", "H3", "G1", "POLY"
"""First words of the blocks that the picture of the idea quotes."""

NAMESPACE = ' xmlns="http://www.w3.org/2000/svg"'


def draw(folder: Path, target: Path) -> None:
    """Write every picture of the README into `target`."""
    run = RunData(RunFolder(folder))
    exact = RunFolder(folder).read_layers(run.manifest["primary"])
    stacks = run.layer(BLADE_LAYER)
    worst = agreement.worst_places(run)[BLADE_LAYER]
    reach = WORST_LIMITS * worst.limit_mm
    plan = ScanPlan.from_parquet(folder / "scan.parquet")
    program = read_program(folder / "program", run.config)
    bead_mm = run.config.process.bead_width_mm
    root, blade = (layer_name(k, float(exact.heights[k])) for k in (ROOT_LAYER, BLADE_LAYER))
    pictures = {
        "idea": idea(run, exact, stacks, program, folder / "program"),
        "layers": sheet_svg(exact, width_px=1200, columns=4, most=8),
        "overlay": overlay_svg(stacks, 0, width_px=720, title=blade),
        "overlay-worst": overlay_svg(
            stacks,
            0,
            width_px=720,
            box=(worst.x_mm - 3 * reach, worst.y_mm - reach, worst.x_mm + 3 * reach, worst.y_mm + reach),
            title=f"layer {BLADE_LAYER + 1}, enlarged: {worst.pair}, {worst.depth_mm:.3f} mm deep",
        ),
        "partition-root": scan.draw(plan, exact, ROOT_LAYER, bead_mm, root),
        "program-blade": program_pictures.draw(program, f"{blade}, read back from the program", BLADE_LAYER),
        "metal-root": metal(
            program, RunFolder(folder).read_layers(run.manifest["program"]["witness"]), run.config, root
        ),
        **orders(exact, run.config, root),
    }
    for name, picture in pictures.items():
        text = str(picture)
        if NAMESPACE not in text.split(">", 1)[0]:
            text = text.replace("<svg ", f"<svg{NAMESPACE} ", 1)
        (target / f"{name}.svg").write_text(text + "\n", encoding="utf-8")
    if chromium := shutil.which("chromium"):
        viewer(folder, target / "viewer.png", chromium)


def viewer(folder: Path, target: Path, chromium: str) -> None:
    """The viewer at a moment of the blade layer, as a browser shows it."""
    seen = f"#layer={BLADE_LAYER + 1}&t=270&show=planecut,stencil&draw=beads,travel,numbers,curves&color=rank"
    with tempfile.TemporaryDirectory() as temporary:
        page = Path(temporary) / "viewer.html"
        page.write_text(document(of_run(RunFolder(folder))), encoding="utf-8")
        words = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=8000"]
        words += [f"--user-data-dir={temporary}/profile", "--window-size=1240,760", f"--screenshot={target}"]
        subprocess.run([chromium, *words, page.as_uri() + seen], check=True, capture_output=True)


def idea(run: RunData, exact: Layers, stacks: dict[str, Layers], program: NCProgram, texts: Path) -> str:
    """The idea in one row: the part, one layer by every slicer, the verdict, and the program read back."""
    subprogram = sorted(texts.glob("*.SPF"))[BLADE_LAYER]
    blocks = [line for line in subprogram.read_text("utf-8").splitlines() if line.startswith("N")]
    quoted = [line for line in blocks if line.split()[1].startswith(SHOWN_BLOCKS)][2:10]
    path = program_pictures.draw(program, "the same layer, read back from the program", BLADE_LAYER)
    heads = ("one part", 20), (f"{len(stacks)} slicers", 300), ("one verdict", 625), ("one program", 905)
    verdict = "VALIDATED" if run.validated else "NOT VALIDATED"
    agreement = next(gate["text"] for gate in run.gates if gate["name"] == "agreement")
    body = [element("rect", width="1240", height="545", fill="#fff")]
    body += [_words(head, x, 34, size=19, weight="bold") for head, x in heads]
    body += [_words("→", x, 290, size=34) for x in (255, 578, 862)]
    body.append(_placed(str(part_picture.draw(exact, "the part") or ""), 10, 150, 235))
    for row, (name, stack) in enumerate(sorted(stacks.items())):
        svg = layer_svg(stack, 0, width_px=270, title=f"{name}: {METHODS.get(name, name)}")
        body.append(_placed(svg, 295, 60 + 118 * row))
    for row, text in enumerate(agreement.replace(" on ", "\non ").splitlines()):
        body.append(_words(text, 640, 90 + 20 * row, size=15))
    for row, gate in enumerate(run.gates):
        body.append(_words(f"{'✓' if gate['passed'] else '✗'} {gate['name']}", 640, 165 + 28 * row))
    body.append(_words(verdict, 640, 165 + 28 * len(run.gates) + 20, size=22, weight="bold"))
    body += [_words(f"{q:.44}", 905, 75 + 19 * n, size=12, family="monospace") for n, q in enumerate(quoted)]
    body.append(_placed(str(path or ""), 895, 250, 335))
    body.append(_words("the path, read back from such text alone", 905, 360, size=15))
    title = element("title", "One part, cut by several slicers, becomes a program only if one verdict allows it")
    return str(element("svg", title, *body, viewBox="0 0 1240 545", width="1240", height="545", role="img"))


def _placed(picture: str, x: float, y: float, width: float | None = None) -> Markup:
    """A picture at a place of another one, made as wide as asked for."""
    if width is not None:
        picture = re.sub(
            r'(<svg[^>]*?) width="[^"]*" height="[^"]*"',
            rf'\1 width="{width:g}" preserveAspectRatio="xMinYMin"',
            picture,
            count=1,
        )
    return Markup(picture.strip().replace("<svg", f'<svg x="{x:g}" y="{y:g}"', 1))


def _words(text: str, x: float, y: float, *, size: int = 16, weight: str = "normal", family: str = "") -> Markup:
    font = {"font_size": str(size), "font_weight": weight, "font_family": family or FONT}
    return element("text", text, x=f"{x:g}", y=f"{y:g}", **font, fill="#222")


def metal(program: NCProgram, witness: Layers, config: Config, what: str) -> str:
    """The metal of the root layer, laid from the program's text on those below it."""
    z_of = program.layer_heights
    field = deposit(program, witness, z_of, config, keep={ROOT_LAYER}).fields[ROOT_LAYER]
    section = witness.section(ROOT_LAYER)
    thickness_mm = float(z_of[ROOT_LAYER] - z_of[ROOT_LAYER - 1])
    return metal_section.draw(field, section, thickness_mm, config.process.largest_unevenness_mm, what)


def orders(exact: Layers, config: Config, what: str) -> dict[str, str]:
    """Pictures of all orders of the root layer, `random` by its mean as in the table, and of the ranks of `thermal`."""
    height_mm = float(exact.heights[ROOT_LAYER])
    compared = OrderComparison.of(exact.polygons(ROOT_LAYER), config, ROOT_LAYER, height_mm)
    rows = [figures_of(name, compared.results(name, SEEDS)) for name in compared_orders()]
    figures = {row["order"]: (row["travel_mm"], row["entry_max_k"]) for row in rows}
    thermal = next(compared.results("thermal", seeds=1))
    islands = compared.laid.islands
    scene = Scene.of(compared.laid.regions.section, thermal.plan.contours[0], thermal.plan.vectors_of(0))
    return {
        "orders-pareto": pareto_svg(figures, f"{what}: {len(islands)} islands"),
        "orders-rank": islands_svg(
            islands, thermal.rank.astype(float), f"{what}: rank in the order thermal", scene=scene
        ),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="run folder of the demo part")
    draw(parser.parse_args().run, Path(__file__).parent)
