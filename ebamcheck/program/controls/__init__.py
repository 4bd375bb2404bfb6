"""Controls: how the programs of each are written and read."""
