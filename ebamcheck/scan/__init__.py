"""Partition, filling and order of the layers (paper, section 4)."""

from ebamcheck.scan.comparing import compare_orders
from ebamcheck.scan.order import ORDERS, LayerIslands
from ebamcheck.scan.plan import ScanPlan
from ebamcheck.scan.planning import plan_scan, plan_stack
from ebamcheck.scan.rectangle import Rectangle, minimum_rectangle
from ebamcheck.scan.regions import contour_paths
from ebamcheck.scan.simulate import simulate_order

__all__ = [
    "ORDERS",
    "LayerIslands",
    "Rectangle",
    "ScanPlan",
    "compare_orders",
    "contour_paths",
    "minimum_rectangle",
    "plan_scan",
    "plan_stack",
    "simulate_order",
]
