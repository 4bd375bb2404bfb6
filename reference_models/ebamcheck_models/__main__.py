"""Write a reference model as STL, or list them.

``python -m ebamcheck_models NAME --tolerance MM -o FILE.stl``; ``python -m ebamcheck_models --list``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from ebamcheck.errors import EbamcheckError
from ebamcheck_models import MODELS, write_stl


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m ebamcheck_models",
        description="Write a reference model as binary STL.",
        epilog="--list tells the models and what they are",
    )
    parser.add_argument("name", nargs="?", choices=sorted(MODELS), metavar="NAME", help=", ".join(MODELS))
    parser.add_argument("--list", action="store_true", help="print names and summaries of all models")
    distance = "greatest distance of the mesh from the surface (default %(default)s)"
    parser.add_argument("--tolerance", type=float, default=0.05, metavar="MM", help=distance)
    parser.add_argument("-o", "--output", metavar="FILE.stl", help="default NAME.stl")
    given = parser.parse_args(arguments)
    if given.list:
        width = max(map(len, MODELS))
        sys.stdout.write("".join(f"{name:{width}}  {model.summary}\n" for name, model in MODELS.items()))
        return 0
    if given.name is None:
        parser.error("give the NAME of a model, or --list")
    output = given.output or f"{given.name}.stl"
    try:
        part = MODELS[given.name].tessellate(given.tolerance)
        write_stl(part, output)
    except EbamcheckError as error:
        sys.stderr.write(f"{error}\n")
        return int(error.exit_code)
    sys.stdout.write(f"{output}: {len(part.faces)} facets, {part.volume:.1f} mm3\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
