"""Surfaces of a layer of a box of 42 x 36 mm, as scanners measure them."""

from __future__ import annotations

import numpy as np

from ebamcheck.checks.metal_rules import MetalBelow
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.map_files import HeightMap
from ebamcheck.live.metal_so_far import MetalSoFar

SIZE = (42, 36, 7)


def level_metal(maker: LayerMaker) -> MetalSoFar:
    """Metal of a layer that was laid, level as far as is known."""
    return MetalSoFar.on(MetalBelow(), maker.section_at(1.0), maker.part, maker.config)


def surface_of(base, hump=0.0, at=(12.0, 18.0), width=4.0, slope=(0.0, 0.0)):
    def z(x, y):
        bump = hump * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2.0 * width**2))
        return base + bump + slope[0] * (x - 21.0) + slope[1] * (y - 18.0)

    return z


def grid_of(z, step=0.5):
    x, y = np.meshgrid(np.arange(-3.0, 45.5, step), np.arange(-3.0, 39.5, step))
    return x, y, z(x, y)


def map_of(z, step=0.5):
    x, y, height = grid_of(z, step)
    return HeightMap(x.reshape(-1), y.reshape(-1), height.reshape(-1), step)


def write_csv(path, z, holes=None):
    x, y, height = grid_of(z)
    rows = [
        f"{a:g},{b:g},{'' if holes is not None and holes(a, b) else f'{c:.6f}'}"
        for a, b, c in zip(x.reshape(-1), y.reshape(-1), height.reshape(-1), strict=True)
    ]
    path.write_text("\n".join(["x_mm,y_mm,height_mm", *rows, ""]))
    return path
