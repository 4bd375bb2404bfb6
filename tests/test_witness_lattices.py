"""Heights and places that outside slicers are asked for: lattices, blocks of a stack, scales."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ebamcheck.errors import BackendFailed
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.mesh.stl import read_triangles, write_triangles
from ebamcheck.slicers.outside.lattices import Lattice, LatticeStack, Placement, lattices_of, scale_to
from ebamcheck.testing.solids import box, mapped, simple, sphere

# -- heights and lattices ------------------------------------------------------------------------------


def test_even_heights_are_one_lattice_that_goes_on_to_both_ends() -> None:
    (lattice,) = lattices_of(np.arange(40, 60) * 0.2 + 0.1, 0.0, 900.0)
    assert lattice.count == 4500
    assert lattice.first_mm == pytest.approx(0.1, abs=1e-12)
    assert lattice.heights[-1] < 900.0


@pytest.mark.parametrize("seed", range(20))
def test_every_height_lies_in_a_lattice_and_lattices_stay_in_the_part(seed: int) -> None:
    rng = np.random.default_rng(seed)
    steps = rng.choice([0.1, 0.25, 0.3], 30).repeat(rng.integers(1, 6, 30))
    heights = 3.0 + np.cumsum(steps + rng.choice([0.0, 1e-3], steps.size) * rng.random(steps.size))
    low, high = 2.9, float(heights[-1]) + 0.05
    found = lattices_of(heights, low, high)
    assert (np.stack([lattice.indices(heights) for lattice in found]) >= 0).any(axis=0).all()
    for lattice in found:
        assert low <= lattice.first_mm
        assert lattice.heights[-1] <= high
    assert sum(lattice.count == 1 for lattice in found) <= heights.size


def test_a_few_planes_of_a_fine_step_are_cut_alone() -> None:
    found = lattices_of(np.array([5.0, 5.001, 5.002]), 0.0, 900.0)
    assert [lattice.count for lattice in found] == [1, 1, 1]


class Counted:
    """Cuts squares whose side is the height, and counts its runs."""

    def __init__(self) -> None:
        self.runs: list[Lattice] = []

    def __call__(self, lattice: Lattice) -> Layers:
        self.runs.append(lattice)
        return from_rings(
            lattice.heights, [[[(0, 0), (z, 0), (z, z), (0, z)]] for z in lattice.heights.tolist()]
        )


def test_blocks_of_a_stack_are_cut_once_and_come_back_in_order() -> None:
    counted = Counted()
    part = box((0, 0, 1), (3, 3, 9))
    heights = 1.0 + (np.arange(40) + 0.5) * 0.2
    done: list[int] = []
    with LatticeStack(part, {"backend": "counted"}, counted) as stack:
        first = stack.slice(heights[:10], done.append)
        stack.slice(heights[10:])
        single = stack.slice(heights[7:8])
    assert len(counted.runs) == 1
    assert sum(done) == 10
    assert np.array_equal(first.heights, heights[:10])
    assert np.array_equal(single.points, first.block(7, 8).points)
    assert first.areas() == pytest.approx(heights[:10] ** 2)
    assert first.backend == "counted"


def test_heights_outside_the_part_are_empty_and_run_nothing() -> None:
    counted = Counted()
    with LatticeStack(box((0, 0, 1), (3, 3, 9)), {}, counted) as stack:
        layers = stack.slice(np.array([-5.0, 0.9, 9.1, 1e5]))
        mixed = stack.slice(np.array([0.0, 2.5, 20.0]))
    assert layers.ring_counts().tolist() == [0, 0, 0, 0]
    assert mixed.ring_counts().tolist() == [0, 1, 0]
    assert len(counted.runs) == 1


def test_a_released_stack_says_so() -> None:
    with LatticeStack(box((0, 0, 1), (3, 3, 9)), {}, Counted()) as stack:
        pass
    with pytest.raises(BackendFailed, match="released"):
        stack.slice(np.array([2.0]))


# -- placement -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 3, 17])
def test_planes_lie_in_the_middles_of_layers_and_marks_are_cut_in_layer_0_only(count: int) -> None:
    part = mapped(sphere(), shift=(1000.0, -70.0, 33.3))
    low, high = part.bounds[:, 2].tolist()
    step = (high - low) / count
    lattice = Lattice(low + 0.31 * step, step, count)
    placement = Placement(part, lattice, scale_to(part, 512.0), 0.5)
    placed = placement.triangles()
    assert placed.min() >= 0.0
    assert 256.0 < placed[:, :, :2].max() <= 512.0
    z = placed[:, :, 2]
    planes = (placement.first_layer + np.arange(count) + 0.5) * 0.5
    wanted = part.triangles[:, :, 2]
    for k, plane in enumerate(planes):
        assert np.array_equal(z[:-8] > plane, wanted > lattice.heights[k])
        assert not ((z[-8:] > plane).any(axis=1) & (z[-8:] < plane).any(axis=1)).any()
    assert (z[:-8] > 0.25).all()
    assert ((z[-8:-4] > 0.25).any(axis=1) & (z[-8:-4] < 0.25).any(axis=1)).any()
    assert z.max() >= 0.5 * placement.layer_count


@pytest.mark.parametrize("side", [1e-6, 0.99, 1.0, 63.9999, 64.0, 64.1, 1e7])
def test_scales_are_powers_of_two(side: float) -> None:
    scale = scale_to(box((0, 0, 0), (side, 0.1 * side, 1)), 64.0)
    assert np.frexp(scale)[0] == 0.5
    assert 32.0 <= side * scale <= 64.0


def test_written_triangles_are_read_again(tmp_path: Path) -> None:
    part = simple("tilted plate")
    write_triangles(part.triangles, tmp_path / "part.stl")
    data = (tmp_path / "part.stl").read_bytes()
    found, notes = read_triangles(data, "part.stl")
    assert np.array_equal(found, part.triangles.astype(np.float32))
    assert not notes
    normals = np.frombuffer(data, np.dtype("<f4, <f4, <f4, 38V"), offset=84)
    assert normals[0][0] ** 2 + normals[0][1] ** 2 + normals[0][2] ** 2 == pytest.approx(1.0, abs=1e-6)
