"""The SINUMERIK 840D sl: one main program, one subprogram a layer."""
