"""From curves and plan to tracks, and from tracks to the text of a program."""
