"""Partition, filling and order of the layers (paper, section 4)."""

from ebamcheck.scan.islands.lattice import Rectangle as Rectangle
from ebamcheck.scan.islands.lattice import minimum_rectangle as minimum_rectangle
from ebamcheck.scan.order.orders import LayerIslands as LayerIslands
from ebamcheck.scan.plan.columns import ScanPlan as ScanPlan
from ebamcheck.scan.plan.comparing import compare_orders as compare_orders
from ebamcheck.scan.plan.stacking import plan_scan as plan_scan
from ebamcheck.scan.plan.stacking import plan_stack as plan_stack
from ebamcheck.scan.plan.stacking import simulate_order as simulate_order
