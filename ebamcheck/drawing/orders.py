"""Scan orders as self-contained SVG: greatest entry temperature over travel; cooler orders travel farther."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ebamcheck.showing.markup import element, svg_file, text

WIDTH_PX, HEIGHT_PX, LEFT_PX, RIGHT_PX, TOP_PX, FOOT_PX = 760, 460, 70, 110, 40, 52

BEST, OTHER = "#1b4f82", "#9aa5b1"
"""Colours of the orders that no other one beats in both, and of those that one does."""

LABEL_PX = 13.0
"""Least distance of two labels one over the other."""


TICKS = 5
"""Steps of each axis."""


def _round_step(most: float) -> float:
    """Least of 1, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten whose steps reach a value."""
    wanted = max(most, 1.0) * 1.02 / TICKS
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(m * power for m in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0) if m * power >= wanted)


def pareto_svg(figures: Mapping[str, tuple[float, float]], title: str) -> str:
    """Draw orders by travel (mm, to the right) and greatest entry temperature (K, upwards).

    Parameters
    ----------
    figures
        Travel and temperature by order.
    """
    step_x = _round_step(max((x for x, _ in figures.values()), default=1.0))
    step_y = _round_step(max((y for _, y in figures.values()), default=1.0))
    most_x, most_y = TICKS * step_x, TICKS * step_y
    wide, tall = WIDTH_PX - LEFT_PX - RIGHT_PX, HEIGHT_PX - TOP_PX - FOOT_PX

    def place(x: float, y: float) -> tuple[float, float]:
        return LEFT_PX + wide * x / most_x, TOP_PX + tall * (1.0 - y / most_y)

    body = [text(LEFT_PX, 22, title, 14)]
    base = TOP_PX + tall
    for n in range(TICKS + 1):
        x, y = place(step_x * n, step_y * n)
        grid = f"M{x:.1f},{TOP_PX}V{base}M{LEFT_PX},{y:.1f}H{LEFT_PX + wide}"
        body += [
            element("path", d=grid, stroke="#e3e7eb", fill="none"),
            text(x, base + 16, f"{step_x * n:g}", text_anchor="middle"),
            text(LEFT_PX - 8, y + 4, f"{step_y * n:g}", text_anchor="end"),
        ]
    best = frontier(figures)
    front = " ".join("{:.1f},{:.1f}".format(*place(*figures[name])) for name in best)
    body.append(element("polyline", points=front, fill="none", stroke=BEST, stroke_dasharray="4 4"))
    last_y = -LABEL_PX
    for name, (x, y) in sorted(figures.items(), key=lambda item: -item[1][1]):
        px, py = place(x, y)
        colour = BEST if name in best else OTHER
        last_y = max(py + 4.0, last_y + LABEL_PX)
        body += [
            element("circle", cx=f"{px:.1f}", cy=f"{py:.1f}", r=5, fill=colour),
            text(px + 9, last_y, name, 12, fill=colour),
        ]
    body += [
        text(LEFT_PX + wide / 2, HEIGHT_PX - 12, "travel between islands, mm", 12, text_anchor="middle"),
        text(
            *(0, 0, "greatest entry temperature rise, K", 12),
            text_anchor="middle",
            transform=f"translate(18,{TOP_PX + tall / 2:.0f}) rotate(-90)",
        ),
    ]
    return svg_file(WIDTH_PX, HEIGHT_PX, body)


def frontier(figures: Mapping[str, tuple[float, float]]) -> list[str]:
    """Orders that no other one beats in both figures, by rising travel."""
    found: list[str] = []
    coolest = float("inf")
    for name, (_, y) in sorted(figures.items(), key=lambda item: item[1]):
        if y < coolest:
            found.append(name)
            coolest = y
    return found
