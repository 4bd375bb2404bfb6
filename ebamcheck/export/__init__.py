"""Parts and layers in the formats of other programs: VTK, DXF and slices in 3MF."""
