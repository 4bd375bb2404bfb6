"""How values show themselves: escaped markup, colours, images, short text, notebooks, axes of matplotlib."""
