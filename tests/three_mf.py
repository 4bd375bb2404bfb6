"""3MF files written by hand, for tests: packages of boxes, with whatever the test puts around them."""

from __future__ import annotations

import io
import zipfile

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = 'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06" requiredextensions="p"'
KIND = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
QUADS = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))


def mesh(*boxes: tuple[tuple[float, float, float], tuple[float, float, float]]) -> str:
    """Mesh of boxes, each by its lowest corner and its size."""
    points, facets = [], []
    for at, size in boxes:
        first = len(points)
        points += [[a + s * (k >> n & 1) for n, (a, s) in enumerate(zip(at, size, strict=True))] for k in range(8)]
        facets += [[first + q[i] for i in t] for q in QUADS for t in ((0, 1, 2), (0, 2, 3))]
    vertices = "".join(f'<vertex x="{x:g}" y="{y:g}" z="{z:g}"/>' for x, y, z in points)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in facets)
    return f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>"


def box(
    number: int | str,
    size: tuple[float, float, float],
    at: tuple[float, float, float] = (0, 0, 0),
    more: str = 'type="model"',
) -> str:
    """Object that is a box."""
    return f'<object id="{number}" {more}>{mesh((at, size))}</object>'


def components(number: int, *inner: str) -> str:
    """Object that is made of others, each by the attributes of its component."""
    return f'<object id="{number}" type="model"><components>{"".join(f"<component {c}/>" for c in inner)}</components></object>'


def model(objects: str, *items: str, unit: str = 'unit="millimeter"', more: str = "") -> str:
    """Text of a model part; without items of a part that the build of another one uses."""
    build = f"<build>{''.join(f'<item {item}/>' for item in items)}</build>"
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><model {unit} xml:lang="en-US" xmlns="{CORE}" {more}>'
        f"<resources>{objects}</resources>{build}</model>"
    )


def package(
    root: str | bytes, at: str = "3D/3dmodel.model", starts: tuple[str, ...] = (), **others: str | bytes
) -> bytes:
    """Bytes of a package; `others` are further files, by names in which ``__`` stands for a slash and ``_model`` for the suffix.

    `starts` are the models that the package names to start from, if not the root alone.
    """
    out, named = (
        io.BytesIO(),
        {k.replace("__", "/").replace("_model", ".model"): v for k, v in others.items()},
    )
    ways = [
        f'<Relationship Id="r{k}" Target="/{name}" Type="{KIND}"/>'
        for k, name in enumerate(named)
        if name.endswith(".model")
    ]
    space = "http://schemas.openxmlformats.org/package/2006/"
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(
            "[Content_Types].xml",
            f'<Types xmlns="{space}content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-'
            'package.relationships+xml"/><Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-'
            '3dmodel+xml"/><Default Extension="config" ContentType="text/xml"/></Types>',
        )  # fmt: skip
        archive.writestr(
            "_rels/.rels",
            f'<Relationships xmlns="{space}relationships">'
            + "".join(
                f'<Relationship Id="s{k}" Target="/{start}" Type="{KIND}"/>' for k, start in enumerate(starts or (at,))
            )
            + "</Relationships>",
        )
        if ways:
            folder, _, file = at.rpartition("/")
            archive.writestr(
                f"{folder}/_rels/{file}.rels",
                f'<Relationships xmlns="{space}relationships">{"".join(ways)}</Relationships>',
            )
        archive.writestr(at, root)
        for name, text in named.items():
            archive.writestr(name, text)
    return out.getvalue()
