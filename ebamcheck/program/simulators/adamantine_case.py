"""Cases of adamantine: finite elements on a block that grows along the path, with heat of fusion and radiation.

Keywords as its ``validate_input_database.cc`` asks for them. The base of the block lets no heat through: adamantine
has no boundary of given temperature. Conductivity and heat capacity are those of our linear model.
"""

from __future__ import annotations

from collections.abc import Mapping

from ebamcheck.numeric.rings import Floats
from ebamcheck.program.simulators.heat_source import Block, HeatSource
from ebamcheck.settings.config import Config

PATH = "scan_path.txt"

METRES = 1e-3

ENDS = 0.1
"""Intensity over that of the middle at the edge of adamantine's electron beam."""

CELLS = 2.0
"""Cells across a bead; along the depth there is one a layer."""

STABLE = 1.0 / 24.0
"""Time step over h^2 / alpha of the smallest cell: a quarter of what explicit differences bear."""

PICTURES = 100
"""Results over the time of the path."""

Tree = Mapping[str, object]


def adamantine_files(rows: Floats, end_s: float, config: Config) -> dict[str, str]:
    """Return all files of a case but its path, by name."""
    return {
        "input.info": "@status@\n" + _tree(_input(rows, end_s, config)),
        "run.sh": '#!/bin/sh\n# @status@\ncd "$(dirname "$0")" && exec "${ADAMANTINE:-adamantine}" --input-file=input.info\n',
    }


def _input(rows: Floats, end_s: float, config: Config) -> Tree:
    process, source = config.process, HeatSource.of(config)
    step_s = _step_s(config)
    between = max(1, round(end_s / step_s / PICTURES))
    return {
        "physics": {"thermal": True, "mechanical": False},
        "geometry": _geometry(rows, config),
        "boundary": {
            "type": "radiative",
            "boundary_4": {"type": "adiabatic"},  # the base
            "printed_surface": {"type": "radiative"},
        },
        "refinement": {"n_refinements": 0, "time_steps_between_refinement": 2_000_000_000},
        "materials": {
            "n_materials": 1,
            "property_format": "polynomial",
            "initial_temperature": process.ambient_temperature_k,
            "new_material_temperature": process.ambient_temperature_k,
            "material_0": _material(config),
        },
        "sources": {
            "n_beams": 1,
            "beam_0": {
                "type": "electron_beam",
                "depth": METRES * source.depth_mm,
                "diameter": 2.0 * METRES * source.radius_mm(ENDS),
                "scan_path_file": PATH,
                "scan_path_file_format": "segment",
                "absorption_efficiency": source.absorptivity,
                "max_power": source.power_w,
            },
        },
        "time_stepping": {"method": "rk_fourth_order", "duration": end_s, "time_step": step_s},
        "post_processor": {"filename_prefix": "output", "time_steps_between_output": between},
        "discretization": {"thermal": {"fe_degree": 1, "quadrature": "gauss"}},
        "memory_space": "host",
    }


def _geometry(rows: Floats, config: Config) -> Tree:
    """Block whose cells come alive in boxes along the path; lengths count from the origin."""
    process, block = config.process, Block.around(rows, config)
    cells = block.cells(process.bead_width_mm / CELLS, config.layer_height_mm)
    sides: dict[str, object] = {}
    for name, low, high, count in zip(
        ("length", "width", "height"), block.low, block.high, cells, strict=True
    ):
        sides |= {name: METRES * (high - low), f"{name}_origin": METRES * low, f"{name}_divisions": count}
    first_mm = block.low[2] + process.base_plate_mm
    return {
        "import_mesh": False,
        "dim": 3,
        **sides,
        "material_height": METRES * first_mm,
        "material_deposition": True,
        "material_deposition_method": "scan_paths",
        "deposition_length": METRES * process.bead_width_mm,
        "deposition_width": METRES * process.bead_width_mm,
        "deposition_height": METRES * config.layer_height_mm,
        "deposition_lead_time": process.bead_width_mm / process.travel_speed_mm_s,
    }


def _material(config: Config) -> Tree:
    material = config.material
    state = {
        "density": material.density_kg_m3,
        "specific_heat": material.heat_capacity_j_kgk,
        **{f"thermal_conductivity_{axis}": material.conductivity_w_mk for axis in "xyz"},
        "emissivity": material.emissivity,
    }
    return {
        "solid": state,
        "liquid": state,
        "solidus": material.solidus_k,
        "liquidus": material.liquidus_k,
        "latent_heat": material.latent_heat_j_kg,
        "radiation_temperature_infty": config.process.ambient_temperature_k,
    }


def _step_s(config: Config) -> float:
    """Longest time step that is stable, and in which the beam stays on a cell."""
    material, process = config.material, config.process
    diffusivity_mm2_s = (
        1e6 * material.conductivity_w_mk / (material.density_kg_m3 * material.heat_capacity_j_kgk)
    )
    cell_mm = process.bead_width_mm / CELLS
    smallest_mm = min(cell_mm, config.layer_height_mm)
    return min(STABLE * smallest_mm**2 / diffusivity_mm2_s, 0.5 * cell_mm / process.travel_speed_mm_s)


def _tree(tree: Tree, indent: str = "") -> str:
    """Write a tree in the INFO format of Boost."""
    lines = []
    for name, value in tree.items():
        if isinstance(value, Mapping):
            lines.append(f"{indent}{name}\n{indent}{{\n{_tree(value, indent + '  ')}{indent}}}\n")
        else:
            lines.append(f"{indent}{name} {_word(value)}\n")
    return "".join(lines)


def _word(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.9g}" if isinstance(value, float) else str(value)
