"""FMUs and systems for the tests of the master."""

from __future__ import annotations

import zipfile
from pathlib import Path

import fmpy

from cosim.system import ComponentInstance, Connection, StartValue, System
from fmus_src.component import Component
from fmus_src.export.compiler import compile_shared


def mass() -> Component:
    """m x'' = force."""
    c = Component("mass", "Mass driven by a force", internal_step=1e-3)
    m = c.parameter("m", 1.0, unit="kg", description="mass", min=1e-6, max=1e6)
    x_0 = c.parameter("x_0", 0.0, unit="m", description="position at the start")
    f = c.input("force", unit="N", description="force")
    x = c.state("x", unit="m", description="position", start=x_0)
    v = c.state("v", unit="m/s", description="velocity")
    c.derivative(x, v)
    c.derivative(v, f / m)
    c.output("position", x, unit="m", description="position")
    c.output("velocity", v, unit="m/s", description="velocity")
    return c


def carried() -> Component:
    """m x'' = -k (x - point), with the spring's force on the point as output (direct feed-through)."""
    c = Component("carried", "Mass on a spring to a moving point", internal_step=1e-3)
    m = c.parameter("m", 1.0, unit="kg", description="mass", min=1e-6)
    k = c.parameter("k", 1.0, unit="N/m", description="stiffness")
    x_0 = c.parameter("x_0", 0.0, unit="m", description="position at the start")
    p = c.input("point", unit="m", description="position of the spring's other end")
    x = c.state("x", unit="m", description="position", start=x_0)
    v = c.state("v", unit="m/s", description="velocity")
    c.derivative(x, v)
    c.derivative(v, k / m * (p - x))
    c.output("position", x, unit="m", description="position")
    c.output("velocity", v, unit="m/s", description="velocity")
    c.output("force", k * (x - p), unit="N", description="force on the point")
    return c


def two_masses(mass_fmu: Path, carried_fmu: Path, m_2: float = 0.5, stretch: float = 1.0) -> System:
    """A free mass of 1 kg and one of `m_2` joined by a spring of 1 N/m, released with the spring stretched."""
    return System(
        "two masses",
        (
            ComponentInstance("structure", mass_fmu),
            ComponentInstance("damper", carried_fmu, {"m": StartValue(m_2), "x_0": StartValue(stretch)}),
        ),
        (
            Connection("structure", "position", "damper", "point"),
            Connection("damper", "force", "structure", "force"),
        ),
    )


# name, value reference, causality, variability, initial, element; indices in ModelStructure count from one
PROBE_VARIABLES = (
    ("u", 0, "input", "continuous", "", '<Real unit="deg" start="0"/>'),
    ("integral", 1, "output", "continuous", "exact", '<Real start="0"/>'),
    ("through", 2, "output", "continuous", "calculated", '<Real unit="rad"/>'),
    ("slope", 3, "parameter", "fixed", "exact", '<Real start="0"/>'),
    ("intercept", 4, "parameter", "fixed", "exact", '<Real start="0"/>'),
    ("fail_at", 5, "parameter", "fixed", "exact", '<Real start="1e9"/>'),
    ("mass", 6, "parameter", "fixed", "exact", '<Real unit="kg" min="0" max="10" start="0"/>'),
    ("count", 0, "input", "discrete", "", '<Integer start="0"/>'),
    ("number", 1, "output", "discrete", "exact", '<Integer start="0"/>'),
    ("fail_status", 2, "parameter", "fixed", "exact", '<Integer start="3"/>'),
    ("gate", 0, "input", "discrete", "", '<Boolean start="false"/>'),
    ("open", 1, "output", "discrete", "exact", '<Boolean start="false"/>'),
    ("label", 0, "parameter", "fixed", "exact", '<String start=""/>'),
)
PROBE_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="probe" guid="probe">
<CoSimulation modelIdentifier="probe" canHandleVariableCommunicationStepSize="true"/>
<UnitDefinitions>
<Unit name="deg"><BaseUnit rad="1" factor="0.017453292519943295"/></Unit>
<Unit name="rad"><BaseUnit rad="1"/></Unit><Unit name="kg"><BaseUnit kg="1"/></Unit>
</UnitDefinitions>
<ModelVariables>{variables}</ModelVariables>
<ModelStructure>
<Outputs>
<Unknown index="2" dependencies=""/><Unknown index="3" dependencies="1"/>
<Unknown index="9" dependencies=""/><Unknown index="12" dependencies=""/>
</Outputs>
<InitialUnknowns><Unknown index="3" dependencies="1"/></InitialUnknowns>
</ModelStructure>
</fmiModelDescription>
"""


def probe_description() -> str:
    """modelDescription.xml of the probe."""
    variables = "".join(
        f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}"'
        f' variability="{variability}"{f" initial={initial!r}" if initial else ""}>{element}</ScalarVariable>'
        for name, reference, causality, variability, initial, element in PROBE_VARIABLES
    )
    return PROBE_XML.format(variables=variables)


def probe(folder: Path) -> Path:
    """The foreign FMU of cosim_probe.c, compiled; `through` (rad) = slope * u (deg, as a number) + intercept."""
    name = f"probe{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).parent / "c-code"
    library = compile_shared([Path(__file__).with_name("cosim_probe.c")], folder / name, [headers])
    path = folder / "probe.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", probe_description())
        archive.write(library, f"binaries/{fmpy.platform}/{name}")
    return path
