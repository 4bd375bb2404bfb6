"""Attack on the law that no curve is farther from its part than the contour was: forms and meshes that nobody chose."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.chance_curves import chance_case, errors_of, judge
from benchmarks.curve_parts import CAD, heights_of, part_of
from benchmarks.curve_parts_meshes import decimated, irregular_convex, noisy, turned
from benchmarks.curve_parts_solids import Triangles
from ebamcheck.curves import LINE, fit
from ebamcheck.curves.gate import POLYLINE
from ebamcheck.curves.lifting import Lifting
from ebamcheck.layers.stack import from_rings
from ebamcheck.mesh.part import Part
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.surface.lift_limits import AHEAD, judge_bends, plausible_share
from ebamcheck.surface.part_surface import surface_of
from ebamcheck.surface.regions import FREEFORM
from ebamcheck_models import LADDER

FAR_ENDS = (347, 185, 725, 727, 867, 974, 1048, 178, 970, 996, 1032, 466, 739)
"""Seeds that broke the law by lifts of edges far longer than what lies ahead of them: flat sides that run into roundings (347 to
1048), noise (178 to 1032), and by a strip of two facets (466, 739). Seed 318 broke it, too, as 347 did, and is left out: its bore
takes Manifold more than a minute at the chord error of the truth."""

FALSE_FORMS = (21, 53, 104, 162, 181, 213, 230, 281, 512, 688, 691, 1226)
"""Seeds that broke the law while exact surfaces were taken for told that were not: by six or eight vertices of a decimated mesh,
by two rims, by a torus that was a ball, and by segments beside them that took what these would not bend."""

BROKE_ONCE = (
    *(1, 7, 8, 9, 10, 61, 94, 117, 139, 150, 218, 272, 365, 242, 330, 388, 386, 109, 148, 71, 276, 988),
    *FAR_ENDS,
    *FALSE_FORMS,
)
"""Seeds that once broke the law, of a kind each: a long side beside a rounding, a seam, noise in planes and in a turned part,
vertices off their surface, a plate of 38 facets; wedges, a box and turned parts of a few hundred facets that are left by
quadrics (94 to 365); splines by chord length through uneven points (242, 330); a mesh
taken for one of scattered points (388), and one whose noise was not known (386); two whose contours' kinks the measure missed
(109, 148); and long edges on simplified parts (71, 276, 988)."""


@pytest.mark.slow
@pytest.mark.parametrize("seed", BROKE_ONCE)
def test_seeds_that_once_broke_the_law_hold_it(seed: int) -> None:
    verdict = judge(chance_case(seed))
    assert verdict.held, str(verdict)


BREAKING = {
    307: "largest error 1.07 of the contour's",
    341: "largest error 1.07 of the contour's",
    379: "largest error 1.15 of the contour's",
    543: "largest error 1.20 of the contour's",
    707: "RMS 17 % worse",
    1114: "largest error 1.60 of the contour's",
    1239: "RMS 115 % worse",
}
"""Seeds on which the law is broken today: what is left of long edges on simplified parts (307, 341, 1114), a strip of a coarse
rounding (379), bends of a few degrees between rows of coarse turned parts (543, 1239), and a turned part of 450 facets that quadrics left in rows by
chance (707)."""


@pytest.mark.slow
@pytest.mark.parametrize("seed", BREAKING)
@pytest.mark.xfail(reason="the law is broken on some coarse or simplified meshes", strict=True)
def test_seeds_that_break_the_law(seed: int) -> None:
    verdict = judge(chance_case(seed))
    assert verdict.held, str(verdict)


@pytest.mark.parametrize(
    "first",
    [
        *(pytest.param(first, marks=pytest.mark.slow) for first in (100, 110, 120)),
        *(pytest.param(first, marks=pytest.mark.long) for first in (130, 140, 150)),
    ],
)
def test_no_curve_is_farther_from_its_part_than_the_contour(first: int) -> None:
    verdicts = [judge(chance_case(seed)) for seed in range(first, first + 10) if seed not in BREAKING]
    assert not [str(v) for v in verdicts if not v.held]


def ellipsoid() -> Part:
    return part_of(irregular_convex(lambda u: u * np.array([30.0, 20.0, 25.0]), 1500, 5), "ellipsoid")


def lifting(part: Part) -> Lifting:
    return Lifting(surface_of(part, CurveSettings()))


def test_scattered_points_and_noise_are_known_by_the_bends_of_edges() -> None:
    """Noise bends edges to both sides."""
    smooth = ellipsoid()
    assert judge_bends(lifting(smooth).surface) == (True, False)
    rough = noisy(Triangles(smooth.vertices, smooth.faces.astype(np.int64)), 0.3, 1)
    assert judge_bends(lifting(part_of(rough, "noisy")).surface).are_rough
    ring = part_of(turned(decimated(CAD["bearing ring"](0.05), 0.1), 3), "ring")
    assert judge_bends(lifting(ring).surface) == (False, False)


def test_edges_that_stand_out_do_not_make_a_mesh_one_of_scattered_points() -> None:
    """Seed 307 has 118 edges that ask for much among 12,571, and was lifted by up to 87 median sagittas for it."""
    assert not judge_bends(lifting(chance_case(307).part).surface).are_scattered


def test_rings_without_evidence_are_the_polygons_of_their_contours() -> None:
    """The spline by chord length left a ring of seed 330 by 0.17 mm where its contour was right to 0.02 mm."""
    case = chance_case(330)
    layers = slice_part(case.part, heights_of(case.part, 4))
    curves = fit(layers, part=case.part)
    assert curves.evidence is not None
    fallen = np.flatnonzero(curves.evidence.method == POLYLINE)
    assert (curves.kind[np.isin(curves.piece_ring, fallen)] == LINE).all()


def test_the_largest_error_is_taken_at_kinks() -> None:
    """Even steps miss the corner of a square that stands out, and so does their largest distance."""
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    spiked = np.insert(square, 2, [[10.0, 9.9999], [13.0, 10.0]], axis=0)
    layers, truth = (from_rings([1.0], [[ring]]) for ring in (spiked, square))
    assert errors_of(layers, truth)[1] == pytest.approx(3.0)


def test_far_ends_bear_out_a_decimated_body_that_is_curved_all_over() -> None:
    limits = lifting(part_of(decimated(CAD["torus"](0.02), 0.1), "torus")).limits
    assert np.mean(limits.acts == AHEAD) < 0.01


@pytest.mark.parametrize("seed", [185, 341, pytest.param(347, marks=pytest.mark.slow)])
def test_far_ends_contradict_flat_sides_that_run_into_roundings(seed: int) -> None:
    limits = lifting(chance_case(seed).part).limits
    assert np.mean(limits.acts == AHEAD) > 0.1
    assert (limits.most_mm[limits.acts == AHEAD] == 0.0).any()


@pytest.mark.parametrize("seed", [178, 970, 996, 1032])
def test_noise_of_a_mesh_in_rows_is_known_by_its_far_ends(seed: int) -> None:
    """Planes and roundings of under 250 facets keep their rows in noise; curves were up to 16 % worse than contours."""
    assert lifting(chance_case(seed).part).limits.share[FREEFORM] == 0.0


def test_a_tessellators_long_edges_need_no_witness() -> None:
    """On the ladder's coarse mesh far ends bear out a third of its long edges, which are right all the same."""
    limits = lifting(LADDER.tessellate(0.3)).limits
    assert not (limits.acts == AHEAD).any()
    assert (limits.share == 1.0).all()


def test_a_lift_is_left_by_less_the_more_it_asks_for_beyond_what_is_plausible() -> None:
    asked = np.array([0.5, 1.0, 2.0, 4.0])
    left = asked * plausible_share(asked, np.ones(4))
    assert np.allclose(left, [0.5, 1.0, 0.5, 0.25])
