"""Write a reference model as STL: ``python -m ebamcheck_models NAME --tolerance MM -o FILE.stl``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from ebamcheck.errors import EbamcheckError
from ebamcheck_models import MODELS, write_stl

DEFAULT_TOLERANCE_MM = 0.05


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m ebamcheck_models",
        description="Write a reference model as binary STL.",
        epilog="models: " + "; ".join(f"{m.name}: {m.summary}" for m in MODELS.values()),
    )
    parser.add_argument("name", choices=sorted(MODELS), metavar="NAME", help=", ".join(MODELS))
    parser.add_argument(
        "--tolerance",
        type=float,
        default=DEFAULT_TOLERANCE_MM,
        metavar="MM",
        help="greatest distance of the mesh from the surface (default %(default)s)",
    )
    parser.add_argument("-o", "--output", metavar="FILE.stl", help="default NAME.stl")
    given = parser.parse_args(arguments)
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
