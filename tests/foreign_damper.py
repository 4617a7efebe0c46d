"""A damper FMU from elsewhere, written by hand in C: its description, and the names by which it maps onto ours."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import fmpy

from fmus_src.export.compiler import compile_shared

AXES = "xyz"
SPECIFIC = [f"a_{a}" for a in AXES]
RATES, SPINS = [f"w_{a}" for a in AXES], [f"dw_{a}" for a in AXES]
FORCES, MOMENTS = [f"F_{a}" for a in AXES], [f"M_{a}" for a in AXES]
INPUTS = [*((n, "mm/s2") for n in SPECIFIC), *((n, "deg/s") for n in RATES), *((n, "deg/s2") for n in SPINS)]
OUTPUTS = [
    *((n, "kN") for n in FORCES),
    *((n, "kN.m") for n in MOMENTS),
    ("travel", "mm"),
    ("speed", "mm/s"),
    ("heat", "kJ"),
]
PARAMETERS = [
    ("mass", "t", 20.0), ("stiffness", "kN/m", 6.302), ("damping", "kN.s/m", 1.598), ("stroke", "mm", 8000.0),
    ("stop_stiffness", "kN/m", 500.0), ("stop_damping", "kN.s/m", 500.0),
]  # fmt: skip
UNITS = {
    "mm": 'm="1" factor="1e-3"', "mm/s": 'm="1" s="-1" factor="1e-3"', "mm/s2": 'm="1" s="-2" factor="1e-3"',
    "deg/s": 'rad="1" s="-1" factor="0.017453292519943295"', "deg/s2": 'rad="1" s="-2" factor="0.017453292519943295"',
    "kN": 'kg="1" m="1" s="-2" factor="1e3"', "kN.m": 'kg="1" m="2" s="-2" factor="1e3"',
    "kJ": 'kg="1" m="2" s="-2" factor="1e3"', "t": 'kg="1" factor="1e3"', "kN/m": 'kg="1" s="-2" factor="1e3"',
    "kN.s/m": 'kg="1" s="-1" factor="1e3"',
}  # fmt: skip
# what the system calls a variable -> what this FMU calls it
NAMES = (
    {f"attachment.specific_force[{i + 1}]": n for i, n in enumerate(SPECIFIC)}
    | {f"attachment.angular_velocity[{i + 1}]": n for i, n in enumerate(RATES)}
    | {f"attachment.angular_acceleration[{i + 1}]": n for i, n in enumerate(SPINS)}
    | {f"force[{i + 1}]": n for i, n in enumerate(FORCES)}
    | {f"moment[{i + 1}]": n for i, n in enumerate(MOMENTS)}
    | {"displacement": "travel", "velocity": "speed", "m": "mass", "k": "stiffness", "c": "damping"}
)


def description() -> str:
    """modelDescription.xml; value references as in foreign_damper.c."""
    variables, reference = [], 0

    def add(name: str, attributes: str, unit: str, start: str = "") -> None:
        nonlocal reference
        variables.append(
            f'<ScalarVariable name="{name}" valueReference="{reference}" {attributes}><Real unit="{unit}"{start}/>'
            "</ScalarVariable>"
        )
        reference += 1

    for name, unit in INPUTS:
        add(name, 'causality="input" variability="continuous"', unit, f' start="{9806.65 if name == "a_z" else 0.0}"')
    for name, unit in OUTPUTS:
        add(name, 'causality="output" variability="continuous" initial="calculated"', unit)
    for name, unit, value in PARAMETERS:
        add(name, 'causality="parameter" variability="tunable" initial="exact"', unit, f' start="{value}"')
    depends = {n: " ".join(map(str, range(1, 10))) for n in (*FORCES[1:], *MOMENTS)}
    outputs = "".join(
        f'<Unknown index="{len(INPUTS) + 1 + i}" dependencies="{depends.get(n, "")}"/>'
        for i, (n, _) in enumerate(OUTPUTS)
    )
    initial = "".join(f'<Unknown index="{len(INPUTS) + 1 + i}"/>' for i in range(len(OUTPUTS)))
    units = "".join(f'<Unit name="{n}"><BaseUnit {base}/></Unit>' for n, base in UNITS.items())
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="2.0" modelName="foreign_damper"'
        ' guid="{by hand}" generationTool="a colleague">'
        '<CoSimulation modelIdentifier="foreign_damper" canHandleVariableCommunicationStepSize="true"'
        ' canGetAndSetFMUstate="true" canNotUseMemoryManagementFunctions="true"/>'
        f"<UnitDefinitions>{units}</UnitDefinitions><ModelVariables>{''.join(variables)}</ModelVariables>"
        f"<ModelStructure><Outputs>{outputs}</Outputs><InitialUnknowns>{initial}</InitialUnknowns></ModelStructure>"
        "</fmiModelDescription>"
    )


def foreign_damper(folder: Path, changes: Mapping[str, str] | None = None) -> Path:
    """The FMU, compiled and packed; `changes` are texts of the source and what to put in their place."""
    folder.mkdir(parents=True, exist_ok=True)
    source = folder / "foreign_damper.c"
    text = Path(__file__).with_name("foreign_damper.c").read_text(encoding="utf-8")
    for old, new in (changes or {}).items():
        assert old in text
        text = text.replace(old, new)
    source.write_text(text, encoding="utf-8")
    name = f"foreign_damper{fmpy.sharedLibraryExtension}"
    library = compile_shared([source], folder / name, [Path(fmpy.__file__).parent / "c-code"])
    path = folder / "foreign_damper.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description())
        archive.write(library, f"binaries/{fmpy.platform}/{name}")
    return path
