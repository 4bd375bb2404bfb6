"""The partition of a layer: regions, lattice, islands, and which of them touch."""
