"""Geometry in the plane that all rooms share; it knows no setting and no program."""
