"""Preheating: the scans before layers, the temperature that they reach by the program's text, and the path of the beam."""

from __future__ import annotations

from typing import Any

from ebamcheck.errors import InputError
from ebamcheck.nc.files import layer_of_preheat
from ebamcheck.program import read_program
from ebamcheck_reports import program_picture
from ebamcheck_reports.figures import counted
from ebamcheck_reports.markup import Markup, element, facts, paragraph, picture
from ebamcheck_reports.run_data import RunData

SAID = {
    "preheat count": "passes",
    "preheat temperature": "temperature",
    "preheat evenness": "evenness",
    "preheat melting": "under the beam",
}
"""Checks about preheating, with their names in this section."""


def render(run: RunData) -> list[Markup]:
    """Figures of the scans and the picture of the first; nothing for a run without preheating."""
    settings, record = run.config.preheat, run.part_of("program")
    if settings.when == "off" or not record:
        return []
    stem = run.config.machine.program_name
    scans: list[tuple[int, str]] = []
    for file in record["files"]:
        layer = layer_of_preheat(stem, str(file["name"]).rpartition(".")[0])
        if layer is not None:
            scans.append((layer, str(file["name"])))
    checks: dict[str, Any] = {check["name"]: check for check in record["checks"]}
    told = [(name, str(checks[key]["text"])) for key, name in SAID.items() if key in checks]
    before = ", ".join(str(layer + 1) for layer, _ in scans) or "none"
    return [
        element("h3", "Preheating"),
        facts(
            [
                ("scans", f"{counted(len(scans), 'subprogram')}, before layer {before}"),
                (
                    "beam",
                    f"{settings.current_ma:g} mA at {run.config.process.voltage_kv:g} kV, {settings.spot_mm:g} mm wide, {settings.speed_mm_s:g} mm/s",
                ),
                (
                    "lines",
                    f"{settings.pattern}, {settings.spacing_mm:g} mm apart; then a wait of {settings.soak_s:g} s",
                ),
                *told,
            ]
        ),
        *(_picture(run, scans[0][1]) if scans else []),
    ]


def _picture(run: RunData, file: str) -> list[Markup]:
    try:
        program = read_program(run.folder.program_folder / file, run.config)
    except InputError as error:
        return [paragraph(f"{file} cannot be read back: {error}", class_="note bad")]
    svg = program_picture.draw(program, f"way of the beam in {file}")
    return (
        []
        if svg is None
        else [
            element(
                "div",
                picture(svg, f"{file}: the beam preheats, as read back from the text."),
                class_="together",
            )
        ]
    )
