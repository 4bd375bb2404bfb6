"""How values show themselves: short text, notebooks, axes of matplotlib."""
