"""The part: a welded triangle mesh, the readers of mesh files, and the inspection before slicing."""

from ebamcheck.mesh.part import Part as Part
