"""Files in AeroDyn's form, written for tests: the package's own rotor, and sections of closed form."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmus_src.aero.geometry import Rotor
from fmus_src.aero.polars import Polar, StallConstants

DEFAULT = '"Default"'
CONSTANTS = (
    "alpha0", "alpha1", "alpha2", "eta_e", "C_nalpha", "T_f0", "T_V0", "T_p", "T_VL", "b1", "b2", "b5", "A1", "A2",
    "A5", "S1", "S2", "S3", "S4", "Cn1", "Cn2", "St_sh", "Cd0", "Cm0", "k0", "k1", "k2", "k3", "k1_hat", "x_cp_bar",
    "UACutout", "filtCutOff",
)  # fmt: skip


def constants(u: StallConstants | None, **other: str) -> str:
    """The lines of the unsteady constants: those of `u` (None: none known), the rest left to the reader."""
    known: dict[str, str] = {}
    if u is not None:
        known = {
            "alpha0": f"{np.degrees(u.alpha_0):.12g}", "C_nalpha": f"{u.slope:.12g}", "Cn1": f"{u.stall:.12g}",
            "Cn2": f"{u.negative_stall:.12g}", "Cd0": f"{u.drag_0:.12g}",
        }  # fmt: skip
    values = dict.fromkeys(CONSTANTS, DEFAULT) | known | other
    return "".join(f"{value:>14} {name:14} ! a constant\n" for name, value in values.items())


def table(p: Polar, unsteady: str, reynolds: float = 0.75, user_property: float = 0.0) -> str:
    rows = zip(np.degrees(p.alpha), p.lift, p.drag, p.moment, strict=True)
    return (
        f"{reynolds:g} Re ! Reynolds number in millions\n{user_property:g} UserProp ! a setting\n"
        f"{'True' if unsteady else 'False'} InclUAdata ! are there constants\n{unsteady}{p.alpha.size} NumAlf ! rows\n"
        "!  Alpha  Cl  Cd  Cm\n" + "".join("{:.10g} {:.10g} {:.10g} {:.10g}\n".format(*row) for row in rows)
    )


def polar_file(tables: Iterable[str], interpolation: str = DEFAULT) -> str:
    whole = list(tables)
    return (
        "! ------------ AirfoilInfo v1.01.x Input File ------------\n! a section\n"
        f"{interpolation} InterpOrd ! order\n1 NonDimArea ! area\n0 NumCoords ! no shape\n"
        f"{len(whole)} NumTabs ! tables\n" + "".join(whole)
    )


def blade_file(r: Rotor) -> str:
    rows = zip(
        r.span, *r.offset.T, np.degrees(r.prebend), np.degrees(r.twist), r.chord, r.section + 1, strict=True
    )  # fmt: skip
    return (
        "------- AERODYN v15.00.* BLADE DEFINITION INPUT FILE -------\na blade\n======  Blade Properties ======\n"
        f"{r.span.size} NumBlNds - Number of blade nodes\n"
        "  BlSpn  BlCrvAC  BlSwpAC  BlCrvAng  BlTwist  BlChord  BlAFID\n  (m)  (m)  (m)  (deg)  (deg)  (m)  (-)\n"
        + "".join(" ".join(f"{v:.12g}" for v in row) + "\n" for row in rows)
    )


def primary_file(names: list[str], blade: str = "blade.dat", **lines: object) -> str:
    settings = {"AFTabMod": 1, "InCol_Alfa": 1, "InCol_Cl": 2, "InCol_Cd": 3, "InCol_Cm": 4} | lines
    return (
        "------- AERODYN v15.03.* INPUT FILE -------\na rotor\n======  General Options  ======\n"
        "False Echo - Echo the input? (flag)\n1 Wake_Mod - Wake model {0=none, 1=BEMT} (switch)\n"
        + "".join(f"{value} {name} - a setting\n" for name, value in settings.items())
        + f"{len(names)} NumAFfiles - Number of airfoil files\n"
        + f'"{names[0]}" AFNames - Airfoil file names (NumAFfiles lines)\n'
        + "".join(f'"{name}"\n' for name in names[1:])
        + "True UseBlCm - Include pitching moment? (flag)\n"
        + "".join(f'"{blade}" ADBlFile({k}) - Blade #{k}\n' for k in (1, 2, 3))
        + "END of input file\n"
    )


def write_rotor(r: Rotor, folder: Path, **lines: object) -> Path:
    """The rotor in AeroDyn's form; returns the primary file."""
    (folder / "Airfoils").mkdir(parents=True, exist_ok=True)
    for p in r.polars:
        text = polar_file([table(p, constants(p.unsteady))])
        (folder / "Airfoils" / f"{p.name}.dat").write_text(text)
    (folder / "blade.dat").write_text(blade_file(r))
    (folder / "rotor.dat").write_text(primary_file([f"Airfoils/{p.name}.dat" for p in r.polars], **lines))
    return folder / "rotor.dat"


@dataclass(frozen=True)
class Kirchhoff:
    """A symmetric section whose flow separates linearly over the angle of attack (rad) between two angles."""

    slope: float = 6.0
    begin: float = np.radians(8.0)
    end: float = np.radians(20.0)

    def factor(self, alpha: np.ndarray) -> np.ndarray:
        return np.clip((self.end - np.abs(alpha)) / (self.end - self.begin), 0.0, 1.0)

    def normal(self, alpha: np.ndarray) -> np.ndarray:
        inner = np.clip(alpha, -self.end, self.end)
        force = self.slope * inner * (0.5 * (1.0 + np.sqrt(self.factor(alpha)))) ** 2
        return force * np.where(np.abs(alpha) > 0.5 * np.pi, np.sin(np.abs(alpha)), 1.0)

    def polar(self, step: float = 0.25, drag: float = 0.01) -> Polar:
        """Its normal force as lift and drag, to which constant drag at no lift is added."""
        alpha = np.radians(np.arange(-180.0, 180.0 + step / 2, step))
        normal = self.normal(alpha)
        lift = normal * np.cos(alpha)
        return Polar("kirchhoff", alpha, lift, drag + normal * np.sin(alpha), np.zeros_like(alpha))
