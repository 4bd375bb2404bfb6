"""From text to motions: what a control would do, and the roles of its motions."""
