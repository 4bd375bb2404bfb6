"""LinuxCNC and plain G-code: one file."""
