"""The part: a welded triangle mesh, the files it is read from, and what is looked at before it is sliced."""

from ebamcheck.mesh.part import Part as Part
