"""What only other people's programs need: finding and running them, lattices of heights, placement."""
