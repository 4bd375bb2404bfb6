"""Draw the pictures of README.md from a finished run of the demo part: ``python reports/pictures/draw.py demo/run``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ebamcheck.drawing.islands import islands_svg
from ebamcheck.drawing.orders import pareto_svg
from ebamcheck.drawing.scene import Scene
from ebamcheck.layers.stack import Layers
from ebamcheck.layers.svg import overlay_svg, sheet_svg
from ebamcheck.pipeline.run_folder import RunFolder
from ebamcheck.program import NCProgram, read_program
from ebamcheck.program.checking.deposit import deposit
from ebamcheck.scan import ScanPlan
from ebamcheck.scan.islands.regions import layer_section
from ebamcheck.scan.plan.comparing import COMPARED, SEEDS, OrderComparison, figures_of
from ebamcheck.settings.config import Config
from ebamcheck_reports import metal_picture, overlays, program_picture, scan_picture
from ebamcheck_reports.run_data import RunData, layer_name

ROOT_LAYER, BLADE_LAYER = 20, 57
"""A layer of the root, which is partitioned into hexagons, and one through the hollow blade."""

WORST_LIMITS = 1.0
"""Half the height of the enlarged place, which is three times as wide, over the limit of the pair."""

NAMESPACE = ' xmlns="http://www.w3.org/2000/svg"'


def draw(folder: Path, target: Path) -> None:
    """Write every picture of the README into `target`."""
    run = RunData(RunFolder(folder))
    exact = RunFolder(folder).read_layers(run.manifest["primary"])
    stacks = run.layer(BLADE_LAYER)
    worst = overlays.worst_places(run)[BLADE_LAYER]
    reach = WORST_LIMITS * worst.limit_mm
    plan = ScanPlan.from_parquet(folder / "scan.parquet")
    program = read_program(folder / "program", run.config)
    bead_mm = run.config.process.bead_width_mm
    root, blade = (layer_name(k, float(exact.heights[k])) for k in (ROOT_LAYER, BLADE_LAYER))
    pictures = {
        "layers": sheet_svg(exact, width_px=1200, columns=4, most=8),
        "overlay": overlay_svg(
            stacks, 0, width_px=720, title=f"layer {BLADE_LAYER}, z = {exact.heights[BLADE_LAYER]:.3f} mm"
        ),
        "overlay-worst": overlay_svg(
            stacks,
            0,
            width_px=720,
            box=(worst.x_mm - 3 * reach, worst.y_mm - reach, worst.x_mm + 3 * reach, worst.y_mm + reach),
            title=f"layer {BLADE_LAYER}, enlarged: {worst.pair}, {worst.depth_mm:.3f} mm deep",
        ),
        "partition-root": scan_picture.draw(plan, exact, ROOT_LAYER, bead_mm, root),
        "partition-blade": scan_picture.draw(plan, exact, BLADE_LAYER, bead_mm, blade),
        "program-blade": program_picture.draw(program, f"{blade}, read back from the program", BLADE_LAYER),
        "metal-root": metal(
            program, RunFolder(folder).read_layers(run.manifest["program"]["witness"]), run.config, root
        ),
        **orders(exact, run.config, root),
    }
    for name, picture in pictures.items():
        text = str(picture)
        if NAMESPACE not in text:
            text = text.replace("<svg ", f"<svg{NAMESPACE} ", 1)
        (target / f"{name}.svg").write_text(text + "\n", encoding="utf-8")


def metal(program: NCProgram, witness: Layers, config: Config, what: str) -> str:
    """The metal of the root layer, laid from the program's text on those below it."""
    z_of = program.layer_heights
    field = deposit(program, witness, z_of, config, keep={ROOT_LAYER}).fields[ROOT_LAYER]
    section = layer_section(witness.polygons(ROOT_LAYER))
    thickness_mm = float(z_of[ROOT_LAYER] - z_of[ROOT_LAYER - 1])
    return metal_picture.draw(field, section, thickness_mm, config.process.largest_unevenness_mm, what)


def orders(exact: Layers, config: Config, what: str) -> dict[str, str]:
    """All orders of the root layer, `random` as in the table by its mean, and the ranks of the default one."""
    height_mm = float(exact.heights[ROOT_LAYER])
    compared = OrderComparison.of(exact.polygons(ROOT_LAYER), config, ROOT_LAYER, height_mm)
    rows = [figures_of(name, compared.results(name, SEEDS)) for name in COMPARED]
    figures = {row["order"]: (row["travel_mm"], row["entry_max_k"]) for row in rows}
    thermal = next(compared.results("thermal", seeds=1))
    islands = compared.laid.islands
    scene = Scene.of(compared.laid.regions.section, thermal.plan)
    return {
        "orders-pareto": pareto_svg(figures, f"{what}: {len(islands)} islands"),
        "orders-rank": islands_svg(
            islands,
            thermal.rank.astype(float),
            f"{what}: rank in the order thermal",
            labels=True,
            scene=scene,
        ),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="run folder of the demo part")
    draw(parser.parse_args().run, Path(__file__).parent)
