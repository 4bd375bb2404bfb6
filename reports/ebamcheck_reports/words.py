"""What the short words of a run mean, in sentences for someone who has never seen the tool."""

from __future__ import annotations

BLANK_LINE = "\u00a0"  # Room to write by hand, over a drawn line

GATE_QUESTIONS = {
    "input": "Is the part a closed solid with an inside and an outside?",
    "agreement": "Do independent slicing methods find the same contours on every layer?",
    "fit": "Do the fitted curves stay near the contours?",
    "coverage": "Do the beads fill the section of every layer?",
    "deposit": "Is the metal laid that of the sections, in all and at every place within its tolerances, by a model of the melt pool?",
    "heat": "Is no bead entered above the interpass limit, and does the wire still melt?",
    "program": "Is the NC program, read back from its text, still the part?",
    "entry": "Is the program that begins at a layer the end of the whole one, with a safe start of its own?",
}

EXIT_CODES = {0: "every gate passed", 1: "at least one gate did not pass", 5: "nothing could be compared"}

FAULTS = {
    "sound": "The mesh encloses its volume completely.",
    "open": "The surface has holes: some edges belong to one facet only, so that inside and outside are not separated. "
    "Close the holes in the CAD system or with a mesh repair tool and export the part again.",
    "inconsistent": "Neighbouring facets face opposite ways, so that the mesh does not say on which side the metal is. "
    "Make the facet normals consistent, or run again with --fix-orientation.",
    "non-manifold": "At some edges an odd number of facets meet, or facets that do not pair up: there is no telling inside from "
    "outside there. Separate or unite the bodies in the CAD system and export the part again.",
    "flat": "The mesh has no volume: there is nothing to build.",
    "overlapping": "The mesh encloses more than its box: bodies or walls stand in one another. Unite them in the model.",
    "inside-out": "The mesh is closed but its facets face inwards, so that the metal would lie outside of it.",
}

STATUS = {
    "done": "ran to its end",
    "unavailable": "not available on this machine",
    "refused": "refused this part",
    "crashed": "CRASHED",
    "timed out": "TIMED OUT: stopped at its time limit",
    "out of memory": "OUT OF MEMORY: stopped at its memory limit",
    "killed": "KILLED",
}

# What must not happen to a method; the others (a part it cannot take, a missing driver) are its declared limits
LOST = frozenset({"crashed", "timed out", "out of memory", "killed"})

METRICS = {
    "depth": "contours differ in depth",
    "topology": "numbers of rings or holes differ",
    "empty": "no contour although the part is there",
}

CAUSES = {
    "coplanar face": "a face of the part lies in the plane of the layer, where a section is a matter of convention",
    "vertex on plane": "a vertex of the mesh lies in the plane of the layer",
    "open edge": "the mesh has a hole at this place",
    "non-manifold edge": "more than two facets meet at an edge at this place",
    "inconsistent orientation": "facets at this place face opposite ways",
    "overlapping shells": "bodies of the mesh overlap at this place",
    "self-intersection": "the surface of the part crosses itself at this place",
    "touching shells": "bodies of the mesh touch at this place",
    "open surface": "the mesh is open, so that inside and outside are not certain here",
    "open path": "a contour at this place does not close",
    "thin feature": "the part is thinner here than the methods can tell apart",
    "thin gap": "a gap is narrower here than the methods can tell apart",
    "shallow slope": "the surface is nearly level here, so that a small error in height moves the contour far",
    "constant offset": "all contours lie outward or inward by the same distance",
    "translation": "all contours are moved in the plane by the same way",
    "wrong height": "all layers are sections of another height of the part",
    "scale": "all contours are larger or smaller by the same factor",
    "wrong unit": "the part was read in another unit",
    "rotation": "all contours are turned by the same angle",
    "mirrored": "the contours are those of the mirrored part",
    "missing outer rings": "outer rings of the other method are not there",
    "missing holes": "holes of the other method are not there",
    "extra outer rings": "there are outer rings that the other method has not",
    "extra holes": "there are holes that the other method has not",
    "wrong nesting": "rings nested in holes run the wrong way round, so that solid and void are exchanged there",
    "wrong ring direction": "rings run the wrong way round, so that solid and void are exchanged",
    "other winding rule": "where bodies overlap, solid and void are told by another rule",
    "quantised coordinates": "coordinates are rounded to a grid that is coarser than the limit",
    "dropped layers": "layers are empty in which the other method has contours",
    "duplicated layers": "layers are their neighbours again",
    "shifted layers": "layers are those of another place in the stack",
    "unknown": "no flaw of the mesh is near; the fault is likely in the method named",
}

CLASSES = {
    "generic": "ordinary layers",
    "vertex-on-plane": "layers through a vertex of the mesh",
    "face-on-plane": "layers through a face of the mesh",
    "unknown": "layers of unknown kind",
}

VERDICTS = {
    "agree": "all methods agree",
    "outlier": "one or more methods differ from the others",
    "undecided": "methods differ and none is in the majority",
    "not-compared": "not compared",
    "empty": "empty although the part is there",
}


def meaning(words: dict[str, str], key: str) -> str:
    """Sentence of a word, or the word itself where a plugin brought a new one."""
    return words.get(key, key)
