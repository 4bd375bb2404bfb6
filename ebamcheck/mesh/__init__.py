"""The part: a welded triangle mesh, the files it is read from, and what is looked at before it is sliced."""
