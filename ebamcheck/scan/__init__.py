"""Partition, filling and order of the layers (paper, section 4)."""

from ebamcheck.scan.islands.lattice import Rectangle, minimum_rectangle
from ebamcheck.scan.order.orders import LayerIslands
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.scan.plan.comparing import compare_orders
from ebamcheck.scan.plan.stacking import plan_scan, plan_stack, simulate_order

__all__ = [
    "LayerIslands",
    "Rectangle",
    "ScanPlan",
    "compare_orders",
    "minimum_rectangle",
    "plan_scan",
    "plan_stack",
    "simulate_order",
]
