"""What fills islands: hatch lines, turns, beads along walls and over gaps; what they cover and how long they take."""
