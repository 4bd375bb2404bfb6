"""Cases of AdditiveFOAM: OpenFOAM on a block, with heat of fusion and radiation; the melt stands still.

Files and keywords as in its tutorial AMB2018-02-B. AdditiveFOAM lays no metal: the block reaches up to the highest
layer of the path from the start, so that one layer at a time is what it is for. Conductivity and heat capacity are
those of our linear model.
"""

from __future__ import annotations

from ebamcheck.numeric.rings import Floats
from ebamcheck.program.simulators.heat_source import Block, HeatSource
from ebamcheck.settings.config import Config

PATH = "constant/scanPath"

METRES = 1e-3

CELLS = 6.0
"""Cells across a bead, and half as many in a layer."""

PICTURES = 10
"""Results over the time of the path."""

PROCESSES = 4

HEADER = """// @status@
FoamFile
{{
    version 2.0;
    format ascii;
    class {kind};
    object {name};
}}
"""

SOURCE = """sources (beam);
beam
{{
    pathName scanPath;
    absorptionModel constant;
    constantCoeffs
    {{
        eta {absorptivity:.9g};
    }}
    heatSourceModel superGaussian;
    superGaussianCoeffs
    {{
        k 2.0;
        dimensions ({wide:.9g} {wide:.9g} {deep:.9g});
        nPoints (10 10 10);
    }}
}}
"""

TRANSPORT = """solid
{{
    kappa ({conductivity:.9g} 0 0);
    Cp ({capacity:.9g} 0 0);
}}
liquid
{{
    kappa ({conductivity:.9g} 0 0);
    Cp ({capacity:.9g} 0 0);
}}
powder
{{
    kappa ({conductivity:.9g} 0 0);
    Cp ({capacity:.9g} 0 0);
}}
rho [1 -3 0 0 0 0 0] {density:.9g};
Lf [0 2 -2 0 0 0 0] {latent:.9g};
// Of the flow alone, which is off (nOuterCorrectors 0):
mu [1 -1 -1 0 0 0 0] 0.003;
beta [0 0 0 -1 0 0 0] 0;
DAS [0 1 0 0 0 0 0] 10e-6;
"""

MESH = """vertices
(
    ({x0:.9g} {y0:.9g} {z0:.9g})
    ({x1:.9g} {y0:.9g} {z0:.9g})
    ({x1:.9g} {y1:.9g} {z0:.9g})
    ({x0:.9g} {y1:.9g} {z0:.9g})
    ({x0:.9g} {y0:.9g} {z1:.9g})
    ({x1:.9g} {y0:.9g} {z1:.9g})
    ({x1:.9g} {y1:.9g} {z1:.9g})
    ({x0:.9g} {y1:.9g} {z1:.9g})
);
blocks
(
    hex (0 1 2 3 4 5 6 7) ({nx} {ny} {nz}) simpleGrading (1 1 1)
);
edges ();
boundary
(
    bottom
    {{
        type wall;
        faces ((0 3 2 1));
    }}
    top
    {{
        type wall;
        faces ((4 5 6 7));
    }}
    sides
    {{
        type wall;
        faces ((0 4 7 3) (2 6 5 1) (1 5 4 0) (3 7 6 2));
    }}
);
mergePatchPairs ();
"""

CONTROL = """application additiveFoam;
startFrom startTime;
startTime 0;
stopAt endTime;
endTime {end:.9g};
deltaT 1e-4;
writeControl adjustableRunTime;
writeInterval {interval:.9g};
purgeWrite 0;
writeFormat binary;
writePrecision 8;
writeCompression off;
timeFormat general;
timePrecision 8;
runTimeModifiable yes;
adjustTimeStep yes;
maxCo 0.5;
maxDi 1;
maxAlphaCo 1;
"""

SCHEMES = """ddtSchemes { default Euler; }
gradSchemes { default Gauss linear; }
divSchemes { default Gauss upwind; }
laplacianSchemes
{
    default Gauss linear corrected;
    laplacian(kappa,T) Gauss harmonic corrected;
}
interpolationSchemes { default linear; }
snGradSchemes { default corrected; }
"""

SOLUTION = """solvers
{
    p_rgh
    {
        solver GAMG;
        tolerance 1e-06;
        relTol 0.01;
        smoother DIC;
    }
    p_rghFinal
    {
        $p_rgh;
        relTol 0;
    }
    "T.*"
    {
        solver PBiCGStab;
        preconditioner DILU;
        tolerance 1e-15;
        relTol 0;
        minIter 1;
        maxIter 20;
    }
}
PIMPLE
{
    momentumPredictor no;
    nOuterCorrectors 0;
    nCorrectors 1;
    nNonOrthogonalCorrectors 0;
    pRefCell 0;
    pRefValue 0;
    nThermoCorrectors 20;
    thermoTolerance 1e-8;
    explicitSolve true;
}
relaxationFactors { equations { ".*" 1; } }
"""

FIELD = """dimensions {dimensions};
internalField uniform {value};
boundaryField
{{
    bottom {{ {bottom} }}
    top {{ {top} }}
    sides {{ {sides} }}
}}
"""

ALLRUN = """#!/bin/sh
# @status@
cd "${0%/*}" || exit 1
. "$WM_PROJECT_DIR/bin/tools/RunFunctions"
runApplication blockMesh
runApplication decomposePar
runParallel $(getApplication)
runApplication reconstructPar
"""


def additivefoam_files(rows: Floats, end_s: float, config: Config) -> dict[str, str]:
    """Return all files of a case but its path, by name."""
    material, source, block = config.material, HeatSource.of(config), Block.around(rows, config)
    nx, ny, nz = block.cells(config.process.bead_width_mm / CELLS, 2.0 * config.layer_height_mm / CELLS)
    (x0, y0, z0), (x1, y1, z1) = (tuple(METRES * v for v in corner) for corner in (block.low, block.high))
    dictionaries = {
        "constant/heatSourceDict": SOURCE.format(
            absorptivity=source.absorptivity,
            wide=2.0 * METRES * source.sigma_mm,
            deep=2.0 * METRES * source.sigma_z_mm,
        ),
        "constant/transportProperties": TRANSPORT.format(
            conductivity=material.conductivity_w_mk,
            capacity=material.heat_capacity_j_kgk,
            density=material.density_kg_m3,
            latent=material.latent_heat_j_kg,
        ),
        "system/blockMeshDict": MESH.format(x0=x0, y0=y0, z0=z0, x1=x1, y1=y1, z1=z1, nx=nx, ny=ny, nz=nz),
        "system/controlDict": CONTROL.format(end=end_s, interval=end_s / PICTURES),
        "system/decomposeParDict": f"numberOfSubdomains {PROCESSES};\nmethod scotch;\n",
        "system/fvSchemes": SCHEMES,
        "system/fvSolution": SOLUTION,
    }
    gravity = "dimensions [0 1 -2 0 0 0 0];\nvalue (0 0 -9.81);\n"
    fusion = f"// @status@\n(\n{material.solidus_k:.9g} 1\n{material.liquidus_k:.9g} 0\n)\n"
    return {
        **{name: _file(name, "dictionary", text) for name, text in dictionaries.items()},
        **_fields(config),
        "constant/g": _file("constant/g", "uniformDimensionedVectorField", gravity),
        "constant/thermoPath": fusion,
        "Allrun": ALLRUN,
    }


def _fields(config: Config) -> dict[str, str]:
    """Temperature, and the fields of a flow that is off."""
    process, still = config.process, "type zeroGradient;"
    ambient = f"{process.ambient_temperature_k:.9g}"
    kept = f"type fixedValue; value uniform {ambient};"
    radiates = (
        f"type mixedTemperature; h 0; emissivity {config.material.emissivity:.9g}; "
        f"Tinf uniform {ambient}; value uniform {ambient};"
    )
    no_flow, rests = "type noSlip;", "type fixedFluxPressure; rho rhok; value uniform 0;"
    base = kept if process.base == "cooled" else still
    scalar, vector = "volScalarField", "volVectorField"
    return {
        "0/T": _field("0/T", scalar, "[0 0 0 1 0 0 0]", ambient, base, radiates, still),
        "0/U": _field("0/U", vector, "[0 1 -1 0 0 0 0]", "(0 0 0)", no_flow, "type slip;", no_flow),
        "0/alpha.solid": _field("0/alpha.solid", scalar, "[0 0 0 0 0 0 0]", "1", still, still, still),
        "0/p_rgh": _field("0/p_rgh", scalar, "[0 2 -2 0 0 0 0]", "0", rests, rests, rests),
    }


def _field(name: str, kind: str, dimensions: str, value: str, bottom: str, top: str, sides: str) -> str:
    text = FIELD.format(dimensions=dimensions, value=value, bottom=bottom, top=top, sides=sides)
    return _file(name, kind, text)


def _file(name: str, kind: str, text: str) -> str:
    return HEADER.format(kind=kind, name=name.rpartition("/")[2]) + text
