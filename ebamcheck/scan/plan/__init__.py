"""Plans: layers laid out, put in order, stacked and compared."""
