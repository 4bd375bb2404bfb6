"""Where islands are entered, how far the gun jumps between them, and when each is scanned.

An island has up to four ends at which it may be entered; the nearest is often the one beside what was laid a minute ago. So the
rise at every end is worked out, and ends are chosen for all islands at once, by dynamic programming over the order: the least sum
of the powers of the rises (:func:`high_mean`) plus a price on travel, the least that keeps the travel allowed. Heat changes little
by the ends chosen before: a few rounds settle it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.heat.field import Field
from ebamcheck.heat.island_heat import IslandHeat, old_at_entries, young_at_entries
from ebamcheck.heat.near_field import OPTIONS
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.scan.filling.schedule import JOINED_MM, IslandSchedule, gaps_mm, island_ends

NEAREST = -1  # entry option of an island that is entered from its corner nearest to where the last one ended
HIGH = 12  # exponent of :func:`high_mean`: a maximum alone would see no gain until the very hottest island is cooler
ROUNDS = 3  # rounds of choosing ends, each with the heat of islands as driven by those of the round before
TIE = 1e-12  # sums closer than this share are equal: rounding must not decide between ends that mirror each other

# -- The way from island to island.


class EntryOptions(NamedTuple):
    """The way from an island that was entered by one of its options to another one, (I, 4, I) each."""

    jump_mm: Floats  # to the nearest option of the other
    option: NDArray[np.int8]  # the nearest option


def entry_options(schedule: IslandSchedule) -> EntryOptions:
    """Tabulate the jumps between all islands of a layer."""
    apart = schedule.leave[:, :, None, None] - schedule.entry
    jump_mm = np.hypot(apart[..., 0], apart[..., 1])
    near = jump_mm < jump_mm.min(axis=-1, keepdims=True) + JOINED_MM
    option = near.argmax(axis=-1)
    found_mm = np.take_along_axis(jump_mm, option[..., None], axis=-1)[..., 0]
    return EntryOptions(found_mm, option.astype(np.int8))


@kernel
def nearest_option(entry: Floats, x: float, y: float) -> tuple[float, int]:
    """Distance to the nearest of the entry options (4, 2) of an island, mm, and which it is: the first of equal ones."""
    nearest, option = np.inf, 0
    for v in range(len(entry)):
        away_x, away_y = entry[v, 0] - x, entry[v, 1] - y
        # No nearer by as much as counts, whatever its square has lost by rounding: the distance itself takes longer.
        if away_x * away_x + away_y * away_y >= nearest * nearest:
            continue
        distance = np.hypot(away_x, away_y)
        if distance < nearest - JOINED_MM:
            nearest, option = distance, v
    return nearest, option


def nearest_options(order: Ints, entry: Floats, leave: Floats) -> Ints:
    """Entry option of each island, by island (I,): the nearest one."""
    return completed_options(np.full(len(entry), NEAREST), order, entry, leave)


@kernel
def completed_options(chosen: Ints, order: Ints, entry: Floats, leave: Floats) -> Ints:
    """Entry options (I,) by island: those that are chosen, and the nearest one where there is none (-1)."""
    options = chosen.copy()
    for n in range(len(order)):
        if n > 0 and options[order[n]] < 0:
            x, y = leave[order[n - 1], options[order[n - 1]]]
            options[order[n]] = nearest_option(entry[order[n]], x, y)[1]
        options[order[n]] = max(options[order[n]], 0)
    return np.maximum(options, 0)


def clocked(
    schedule: IslandSchedule, order: Ints, rapid_mm_s: float, options: Ints | None = None
) -> tuple[Floats, Floats, float]:
    """Start and end of each island (I,), s, and the travel between them, mm, entering each by its option; None: the nearest."""
    if options is None:
        options = nearest_options(order, schedule.entry, schedule.leave)
    entry, leave = schedule.entry[order, options[order]], schedule.leave[order, options[order]]
    jump_mm = np.hypot(*(entry[1:] - leave[:-1]).T)
    times = np.zeros(2 * len(order))
    times[2::2], times[1::2] = jump_mm / rapid_mm_s, schedule.time_s[order]
    clock = np.cumsum(times)
    start_s, end_s = np.zeros(len(schedule)), np.zeros(len(schedule))
    start_s[order], end_s[order] = clock[::2], clock[1::2]
    return start_s, end_s, float(jump_mm.sum())


def in_sequence(
    start: Floats, end: Floats, first: Ints, order: Ints, chained: Bools, options: Ints
) -> tuple[Ints, Bools]:
    """Rows (V,) of the lines of islands in scan order, and whether each is driven from its end to its start.

    `start` and `end` (V, 2) are sorted by island, `first` (I + 1,) is the first line of each. The lines of an island are driven in
    either sequence and direction, as its entry option says; those of a `chained` one (bent lines along a wall) only forwards, or
    all backwards."""
    order = order[np.diff(first)[order] > 0]
    if not len(order):
        return np.zeros(0, np.int64), np.zeros(0, np.bool_)
    options = completed_options(options, order, *island_ends(start, end, first, chained))
    lines, option = np.diff(first)[order], options[order]
    place = np.arange(lines.sum()) - np.repeat(np.cumsum(lines) - lines, lines)
    onward, back = np.repeat(first[order], lines) + place, np.repeat(first[order + 1] - 1, lines) - place
    rows = np.where(np.repeat(option >= 2, lines), back, onward)
    return rows, np.repeat((option == 1) | (option == 2), lines)


def jumps_mm(start: Floats, end: Floats, new_layer: Bools) -> Floats:
    """Jump before each line (V,), mm: 0 for the first of a layer and for lines that go on."""
    jumps = gaps_mm(start, end)
    jumps[new_layer | (jumps <= JOINED_MM)] = 0.0
    return jumps


def high_mean(entry_k: Floats) -> float:
    """Mean of the twelfth powers of the entry temperatures, as a temperature: near the greatest, yet all count."""
    return float(np.mean(np.maximum(entry_k, 0.0) ** HIGH) ** (1.0 / HIGH))


# -- The coolest ends.


def cool_options(heat: IslandHeat, schedule: IslandSchedule, order: Ints, rapid_mm_s: float, longest_mm: float) -> Ints:
    """Choose the entry option (I,) of each island of an order.

    Travel, and :func:`high_mean` of the rises at the entries, are no more than by the nearest options, but for travel up to
    `longest_mm`, which is allowed."""
    best = options = nearest_options(order, schedule.entry, schedule.leave)
    if len(order) < 2:
        return best
    start_s, end_s, travel_mm = clocked(schedule, order, rapid_mm_s, options)
    allowed_mm = max(longest_mm, travel_mm)
    # Other ends change the times by a fraction of a second: old heat, which is most of the work, does not see it.
    old_k = old_at_entries(heat, order, start_s, end_s, modes_at_entries(heat, schedule))
    least_k, every = np.inf, np.arange(len(order))
    for n in range(ROUNDS + 1):
        start_s, end_s, _ = clocked(schedule, order, rapid_mm_s, options)
        rise_k = old_k + _young_k(heat, order, start_s, end_s, options)
        found_k = high_mean(rise_k[every, options])
        if found_k < least_k * (1.0 - TIE):
            best, least_k = options, found_k
        if n < ROUNDS:
            options = affordable(rise_k, order, schedule.entry, schedule.leave, allowed_mm)
    return best


def modes_at_entries(heat: IslandHeat, schedule: IslandSchedule) -> Floats:
    """Modes of the section at all ends of the islands, (I, 4, K)."""
    places = np.ascontiguousarray(schedule.entry).reshape(-1, 2)
    return np.ascontiguousarray(heat.model.plane.at(places)).reshape(len(schedule), OPTIONS, -1)


def rises_at_entries(
    heat: IslandHeat, at: Floats, order: Ints, start_s: Floats, end_s: Floats, options: Ints
) -> Floats:
    """Temperature rises (I, 4) K at all ends of each island, whose modes are `at` (I, 4, K), when the beam enters it."""
    old_k = old_at_entries(heat, order, start_s, end_s, at)
    return np.asarray(old_k + _young_k(heat, order, start_s, end_s, options), np.float64)


def _young_k(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats, options: Ints) -> Floats:
    return young_at_entries(heat.fresh, heat.modes.source_k_s, order, start_s, end_s, options, True)[1]


def affordable(rise_k: Floats, order: Ints, entry: Floats, leave: Floats, longest_mm: float) -> Ints:
    """Entry options (I,) of the least high mean of rises (I, 4) whose travel is allowed; those of the least travel if none is."""
    top_k = float(rise_k.min(axis=1).max())
    share = np.maximum(rise_k, 0.0) / (top_k if top_k > 0.0 else 1.0)
    # Prices of a millimetre, in powers of the greatest rise: by the cheapest heat alone counts, by the dearest travel.
    cheapest, dearest = 1e-15, 1e15
    options, travel_mm = options_by_price(share, order, entry, leave, cheapest)
    if travel_mm <= longest_mm:
        return options
    options, _ = options_by_price(share, order, entry, leave, dearest)
    low, high = np.log(cheapest), np.log(dearest)
    # On a scale of decades, to 4 %.
    for _ in range(50):
        middle = 0.5 * (low + high)
        tried, travel_mm = options_by_price(share, order, entry, leave, float(np.exp(middle)))
        if travel_mm <= longest_mm:
            options, high = tried, middle
        else:
            low = middle
    return options


@kernel
def options_by_price(share: Floats, order: Ints, entry: Floats, leave: Floats, price: float) -> tuple[Ints, float]:
    """Entry options (I,) by island of the least sum of powers of shares (I, 4) and of travel at a price, and their travel, mm."""
    count = len(order)
    came_by = np.zeros((count, OPTIONS), np.int64)
    total, following = np.empty(OPTIONS), np.empty(OPTIONS)
    for w in range(OPTIONS):
        total[w] = max(share[order[0], w], 0.0) ** HIGH
    for n in range(1, count):
        last, island = order[n - 1], order[n]
        for w in range(OPTIONS):
            least, by = np.inf, 0
            for v in range(OPTIONS):
                x, y = leave[last, v]
                spent = total[v] + price * np.hypot(entry[island, w, 0] - x, entry[island, w, 1] - y)
                if spent < least * (1.0 - TIE):
                    least, by = spent, v
            following[w], came_by[n, w] = least + max(share[island, w], 0.0) ** HIGH, by
        total[:] = following
    options = np.zeros(count, np.int64)
    option = 0
    for w in range(1, OPTIONS):
        if total[w] < total[option] * (1.0 - TIE):
            option = w
    travel = 0.0
    for n in range(count - 1, -1, -1):
        options[order[n]] = option
        if n > 0:
            by = came_by[n, option]
            x, y = leave[order[n - 1], by]
            jump = np.hypot(entry[order[n], option, 0] - x, entry[order[n], option, 1] - y)
            travel += jump if jump > JOINED_MM else 0.0
            option = by
    return options, travel


# -- Simulation of an order: how warm each island is when the beam enters it.


def entry_temperatures(
    heat: IslandHeat, area_mm2: Floats, order: Ints, start_s: Floats, end_s: Floats
) -> tuple[Floats, Floats]:
    """Simulate an order with times (I,) by island: the mean temperature rise (I,) of each island when the beam enters it, K, and
    its excess uniformity (I,): the spread of the temperature over the layer when the beam leaves it, without its own heat, over the
    mean temperature."""
    mean, share = heat.modes.mean, area_mm2 / area_mm2.sum()
    entry_k, excess = np.zeros(len(start_s)), np.zeros(len(start_s))
    for island, before, after in _steps(heat, order, start_s, end_s):
        entry_k[island] = before.surface() @ mean[:, island]
        before.age(end_s[island] - start_s[island])
        others, average = before.surface() @ mean, share @ (after.surface() @ mean)
        spread = np.sqrt(share @ (others - share @ others) ** 2)
        excess[island] = spread / average if average > 0.0 else 0.0
    return (entry_k if heat.near is None else _entered_k(heat, order, start_s, end_s)), excess


def entered(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats) -> tuple[Floats, Floats]:
    """Entry temperatures (I,) by island alone, K, and the amplitudes (K, N) at the end."""
    entry_k, state = np.zeros(len(start_s)), heat.start_k
    for island, before, after in _steps(heat, order, start_s, end_s):
        entry_k[island] = before.surface() @ heat.modes.mean[:, island]
        state = after.state
    return (entry_k if heat.near is None else _entered_k(heat, order, start_s, end_s)), state


def entry_points(
    heat: IslandHeat, schedule: IslandSchedule, order: Ints, start_s: Floats, end_s: Floats
) -> tuple[Floats, Floats]:
    """Mean temperature rise of each island, and that under the beam, when the beam enters it by the nearest end, (I,) K."""
    options = nearest_options(order, schedule.entry, schedule.leave)
    old_k = old_at_entries(heat, order, start_s, end_s)
    columns = heat.fresh, heat.modes.source_k_s, order, start_s, end_s, options
    means_k, points_k = young_at_entries(*columns, False)
    return old_k + means_k, old_k + points_k[np.arange(len(options)), options]


def _entered_k(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats) -> Floats:
    options = np.zeros(len(start_s), np.int64)
    young = young_at_entries(heat.fresh, heat.modes.source_k_s, order, start_s, end_s, options, False)
    return old_at_entries(heat, order, start_s, end_s) + young[0]


def _steps(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats) -> Iterator[tuple[int, Field, Field]]:
    """Go through an order: island, the heat when it is entered, and when it is left."""
    modes, clock = heat.modes, 0.0
    field = Field(heat.start_k.copy(), modes.plane_rate, modes.depth_rate, modes.in_layer)
    for island in order.tolist():
        field.age(start_s[island] - clock)
        before = field.copy()
        field.add(modes.mean[:, [island]], modes.source_k_s[[island]], end_s[[island]] - start_s[[island]])
        clock = end_s[island]
        yield island, before, field
