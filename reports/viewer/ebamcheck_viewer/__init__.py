"""The viewer: one page that scrubs through every layer, slicer, bead and block of a run, without a network."""
