"""Unit strings as FMI writes them ("N.m/rad", "kg.m2"), resolved with pint.

The radian is a base dimension here, as in FMI's `BaseUnit`, so that an angle never connects to a pure number.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import Any

BASE_DIMENSIONS = {
    "[mass]": "kg",
    "[length]": "m",
    "[time]": "s",
    "[current]": "A",
    "[temperature]": "K",
    "[substance]": "mol",
    "[luminosity]": "cd",
    "[angle]": "rad",
}


@dataclass(frozen=True)
class Unit:
    """A unit in terms of SI base units: value_SI = factor * value + offset.

    Attributes:
        name: the unit string.
        factor: scale to SI.
        offset: offset to SI (0 for all but temperatures).
        exponents: (base unit, exponent) pairs, sorted, zero exponents left out.
    """

    name: str
    factor: float
    offset: float
    exponents: tuple[tuple[str, int], ...]


# The radian as a base dimension cannot be added to pint's own registry, whose degree is already a number.
DEFINITIONS = """
kilo- = 1e3 = k-
mega- = 1e6 = M-
giga- = 1e9 = G-
centi- = 1e-2 = c-
milli- = 1e-3 = m-
micro- = 1e-6 = u-
metre = [length] = m = meter
second = [time] = s
gram = [mass] = g
ampere = [current] = A
kelvin = [temperature]; offset: 0 = K
mole = [substance] = mol
candela = [luminosity] = cd
radian = [angle] = rad
degree = 0.017453292519943295 * radian = deg
revolution = 6.283185307179586 * radian = rev
minute = 60 * second = min
hour = 3600 * second = h
rpm = revolution / minute
hertz = 1 / second = Hz
newton = kilogram * metre / second ** 2 = N
joule = newton * metre = J
watt = joule / second = W
pascal = newton / metre ** 2 = Pa
bar = 1e5 * pascal
tonne = 1e3 * kilogram = t
volt = watt / ampere = V
percent = 0.01
degree_Celsius = kelvin; offset: 273.15 = degC
knot = 0.5144444444444445 * metre / second = kn
"""


@cache
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(None)
    registry.load_definitions(DEFINITIONS.strip().splitlines())
    return registry


@cache
def unit(name: str) -> Unit:
    """Resolve a unit string: factors joined by '.', '*' or '/', powers as trailing integers ("m/s2").

    Raises:
        ValueError: the string is no unit.
    """
    if name in ("", "1"):
        return Unit(name or "1", 1.0, 0.0, ())
    text = re.sub(r"\s+", ".", name.strip().replace("*", ".").replace("%", "percent"))
    text = re.sub(r"(?<=[A-Za-z)])\^?(-?\d+)", r"**\1", text).replace(".", "*")
    try:
        base = "*".join(f"{b}**{e}" for b, e in _exponents(text)) or "dimensionless"
        offset = float(_registry().Quantity(0.0, text).to(base).magnitude)
        factor = float(_registry().Quantity(1.0, text).to(base).magnitude) - offset
    except Exception as error:
        raise ValueError(f"unknown unit '{name}': write it as in 'kg.m2', 'N.m/rad', 'm/s2'") from error
    return Unit(name, factor, offset, _exponents(text))


def _exponents(text: str) -> tuple[tuple[str, int], ...]:
    dimensions = _registry().Quantity(1.0, text).dimensionality.items()
    return tuple(sorted((BASE_DIMENSIONS[d], round(e)) for d, e in dimensions))


def conversion(source: Unit, target: Unit) -> tuple[float, float]:
    """Factor and offset with value_target = factor * value_source + offset.

    Raises:
        ValueError: the units measure different things.
    """
    if source.exponents != target.exponents:
        raise ValueError(f"'{source.name}' cannot be converted to '{target.name}'")
    return source.factor / target.factor, (source.offset - target.offset) / target.factor
