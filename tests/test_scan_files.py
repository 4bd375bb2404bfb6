"""Files of scan plans: every bit comes back, and what is no plan, of another version or contradictory is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import shapely
from planned_sections import PROFILE, equal_plans, stack

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers.stack import from_rings
from ebamcheck.scan import ScanPlan, plan_scan, plan_stack
from ebamcheck.scan.plan.columns import METRICS, PlanOfLayers


@pytest.fixture(scope="module")
def plan():
    return plan_stack(stack(), PROFILE)


@pytest.fixture
def file(plan, tmp_path):
    plan.to_parquet(tmp_path / "scan.parquet")
    return tmp_path / "scan.parquet"


def test_a_plan_survives_its_file(plan, file):
    back = ScanPlan.from_parquet(file)
    equal_plans(plan, back)
    assert back.island_wait_s.tobytes() == plan.island_wait_s.tobytes()
    for name in plan.vectors:
        assert back.vectors[name].to_numpy().tobytes() == plan.vectors[name].to_numpy().tobytes()
    layers = PlanOfLayers.from_parquet(file)
    assert layers.heights.tobytes() == plan.heights.tobytes()
    pd.testing.assert_frame_equal(layers.metrics, plan.metrics, check_exact=True)
    assert np.array_equal(shapely.to_wkb(layers.sections), shapely.to_wkb(plan.sections))


def test_plans_without_islands_or_sections_and_with_further_figures_survive_their_file(plan, tmp_path):
    further = plan.metrics.assign(preheat_passes=np.arange(len(plan)))
    bare = replace(plan, sections=None, metrics=further)
    for other in (bare, plan_scan([], PROFILE), plan_stack(from_rings([], []), PROFILE)):
        other.to_parquet(tmp_path / "scan.parquet")
        equal_plans(other, ScanPlan.from_parquet(tmp_path / "scan.parquet"))


@pytest.mark.parametrize("read", [ScanPlan.from_parquet, PlanOfLayers.from_parquet])
def test_what_is_no_plan_is_refused(read, tmp_path):
    pd.DataFrame({"x": [1]}).to_parquet(tmp_path / "other.parquet")
    with pytest.raises(InputError, match="is not a scan plan"):
        read(tmp_path / "other.parquet")
    (tmp_path / "text.parquet").write_text("hello")
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path / "text.parquet")
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path / "nowhere.parquet")


@pytest.mark.parametrize("read", [ScanPlan.from_parquet, PlanOfLayers.from_parquet])
@pytest.mark.parametrize(("version", "age"), [(2, "an earlier"), (99, "a later")])
def test_a_plan_of_another_version_is_refused_in_one_line(read, version, age, file):
    said = {"format": f"ebamcheck scan plan {version}", "heights": []}
    pq.write_table(pq.read_table(file).replace_schema_metadata({"ebamcheck": json.dumps(said)}), file)
    with pytest.raises(InputError, match=f"scan plan of format {version}, of {age} version") as refused:
        read(file)
    assert "reads format 3" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("header", ["[]", '{"format": 3}', "no JSON", '{"format": "ebamcheck scan plan x"}'])
def test_a_header_that_says_nothing_is_refused(header, file):
    pq.write_table(pq.read_table(file).replace_schema_metadata({"ebamcheck": header}), file)
    with pytest.raises(InputError, match="is not a scan plan"):
        ScanPlan.from_parquet(file)


@pytest.mark.parametrize("place", [0.2, 0.4, 0.6, 0.8])
def test_a_flipped_bit_is_found(place, file):
    content = bytearray(file.read_bytes())
    content[int(place * len(content))] ^= 4
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"scan\.parquet"):
        ScanPlan.from_parquet(file)


def changed(file, name, change):
    """Write the file anew with one list column changed, every list of which becomes what `change` makes of it."""
    table = pq.read_table(file)
    at = table.schema.get_field_index(name)
    lists = [change(list(values)) for values in table.column(name).to_pylist()]
    pq.write_table(table.set_column(at, name, pa.array(lists, table.schema.field(name).type)), file)


@pytest.mark.parametrize(
    ("name", "change", "told"),
    [
        ("island_rank", lambda v: [0 for _ in v], "ranks"),
        ("island_rank", lambda v: [r + 1 for r in v], "ranks"),
        ("island_rank", lambda v: [r - 1 for r in v], "ranks"),
        ("island_x_mm", lambda v: v[1:], "differ in length"),
        ("island_polygon", lambda v: [b"nothing" for _ in v], "region"),
        ("island_wait_s", lambda v: [None for _ in v], "empty items"),
        ("island_lines", lambda v: [n + 1 for n in v], "other lines"),
        ("island_lines", lambda v: [-n for n in v], "other lines"),
        ("angle", lambda v: v[1:], "differ in length"),
        ("border_first", lambda v: [10**6 for _ in v], "does not have"),
        ("border_second", lambda v: [-1 for _ in v], "does not have"),
        ("border_mm", lambda v: [*v, 1.0], "differ in length"),
    ],
)
def test_columns_that_contradict_each_other_are_refused(name, change, told, file):
    changed(file, name, change)
    with pytest.raises(InputError, match=told):
        ScanPlan.from_parquet(file)


@pytest.mark.parametrize("name", ["height_mm", "contour", "metrics", "island_kind", "x0", "border_mm"])
def test_a_missing_column_is_named(name, file):
    table = pq.read_table(file)
    pq.write_table(table.drop_columns([name]), file)
    with pytest.raises(InputError, match=f"{name}|metrics lack {next(iter(METRICS))}"):
        ScanPlan.from_parquet(file)


def test_a_plan_that_cannot_be_written_leaves_nothing(plan, tmp_path):
    with pytest.raises(SettingsError, match="cannot be written"):
        plan.to_parquet(tmp_path / "nowhere" / "scan.parquet")
    assert not list(tmp_path.iterdir())
