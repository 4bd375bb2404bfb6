"""Orders of islands: by name, by heat, by search; and the simulation of one."""
