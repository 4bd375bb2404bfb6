"""Pictures of islands, orders and regions, as SVG and HTML that need nothing else."""
