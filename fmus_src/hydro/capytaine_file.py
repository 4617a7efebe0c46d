"""A database computed with Capytaine and kept as NetCDF (`capytaine.export_dataset("barge.nc", dataset)`).

Capytaine's time factor is exp(-i w t): complex values are conjugated. Its hydrostatic stiffness holds the weight at the
centre of mass, m g z_G in roll and pitch: this is taken off again. Needs xarray, and for files of NetCDF-4 a package
that reads them (the extra `hydro` brings both).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fmus_src.hydro.database import HydroDatabase, stated

Array = npt.NDArray[np.float64]

DOFS = ("Surge", "Sway", "Heave", "Roll", "Pitch", "Yaw")


def read_capytaine(path: Path, given: dict[str, float | None]) -> HydroDatabase:
    """Read a dataset of one rigid body with the six modes about the PRP.

    Args:
        given: volume, depth, density and gravity where the file has none (depth also where it is infinite).

    Returns:
        the database; its added mass at infinite frequency is nan if the file has none.

    Raises:
        ValueError: no package reads the file, or it lacks what a database needs.
    """
    data = _open(path)
    for name in ("added_mass", "radiation_damping", "hydrostatic_stiffness", "omega"):
        if name not in data:
            hint = "; assemble it with hydrostatics=True" if name == "hydrostatic_stiffness" else ""
            raise ValueError(f"hydro: {path.name} lacks {name}{hint}")
    dofs = _dof_names(path, data)
    frequency = data["omega"].dims[0] if data["omega"].dims else "omega"
    data = data.sortby("omega")
    radiation = [
        np.asarray(data[name].transpose(frequency, "influenced_dof", "radiating_dof").sel(
            influenced_dof=dofs, radiating_dof=dofs).values, dtype=float)
        for name in ("added_mass", "radiation_damping")
    ]  # fmt: skip
    force = _excitation(path, data).transpose(frequency, "wave_direction", "influenced_dof").sel(influenced_dof=dofs)
    omega = np.asarray(data["omega"].values, dtype=float)
    finite = np.isfinite(omega) & (omega > 0.0)
    infinite = np.isinf(omega)
    figures = stated(path.name, _figures(data), given)
    stiffness = np.asarray(
        data["hydrostatic_stiffness"].transpose("influenced_dof", "radiating_dof").sel(
            influenced_dof=dofs, radiating_dof=dofs).values, dtype=float
    )  # fmt: skip
    return HydroDatabase(
        name=path.name,
        omega=omega[finite],
        heading=np.asarray(data["wave_direction"].values, dtype=float),
        added_mass=radiation[0][finite],
        added_mass_infinite=radiation[0][infinite][0] if infinite.any() else np.full((6, 6), np.nan),
        damping=radiation[1][finite],
        excitation=np.conj(force.values[finite]),
        stiffness=_without_weight(path, data, stiffness, figures),
        provenance=(
            f"Capytaine {data.attrs.get('capytaine_version', '')} file {path.name}, "
            + ", ".join(f"{key} {value:g}" for key, value in figures.items()),
        ),
        **figures,
    )


def _open(path: Path) -> Any:
    try:
        import xarray
    except ImportError:
        raise ValueError(f"hydro: {path.name} needs xarray: pip install fowt-cosim[hydro]") from None
    try:
        with xarray.open_dataset(path) as data:
            return data.load()
    except Exception as error:  # whatever the reader of a broken file stumbles over
        reason = str(error).split(".", 1)[0].split("\n", 1)[0]
        raise ValueError(f"hydro: {path.name} cannot be read ({reason}); pip install fowt-cosim[hydro]") from None


def _dof_names(path: Path, data: Any) -> list[str]:
    """The file's names of surge to yaw: these words, or NAME__Surge and so on."""
    names = [str(name) for name in data["influenced_dof"].values]
    result = []
    for dof in DOFS:
        matches = [name for name in names if name.split("__")[-1] == dof]
        if len(matches) != 1 or matches[0] not in [str(name) for name in data["radiating_dof"].values]:
            raise ValueError(f"hydro: {path.name} needs one mode {dof} of one body; it has {', '.join(names)}")
        result += matches
    center = data.get("rotation_center", data.coords.get("rotation_center"))
    if center is not None and np.abs(np.asarray(center.values, dtype=float)).max() > 1e-6:
        raise ValueError(f"hydro: {path.name}: modes turn about {center.values.tolist()}; compute them about (0, 0, 0)")
    return result


def _excitation(path: Path, data: Any) -> Any:
    """Froude-Krylov plus diffraction force, complex."""

    def whole(name: str) -> Any:
        values = data[name]
        if "complex" in values.dims:
            return values.sel(complex="re", drop=True) + 1j * values.sel(complex="im", drop=True)
        return values

    if "excitation_force" in data:
        return whole("excitation_force")
    for name in ("Froude_Krylov_force", "diffraction_force"):
        if name not in data:
            raise ValueError(f"hydro: {path.name} lacks excitation_force (or {name}): solve the diffraction problems")
    return whole("Froude_Krylov_force") + whole("diffraction_force")


def _figures(data: Any) -> dict[str, float]:
    """What the file states of volume, depth, density and gravity."""
    found = {}
    for key, name in (("depth", "water_depth"), ("density", "rho"), ("gravity", "g")):
        if name in data.coords and np.isfinite(float(data[name])):
            found[key] = float(data[name])
    if "disp_mass" in data and "density" in found:
        found["volume"] = float(data["disp_mass"]) / found["density"]
    return found


def _without_weight(path: Path, data: Any, stiffness: Array, figures: dict[str, float]) -> Array:
    if "center_of_mass" not in data and "center_of_mass" not in data.coords:
        raise ValueError(
            f"hydro: {path.name} lacks center_of_mass, of which its hydrostatic stiffness holds the weight"
        )
    arm = np.asarray(data["center_of_mass"].values, dtype=float).ravel()
    weight = figures["density"] * figures["gravity"] * figures["volume"]
    result = stiffness.copy()
    result[3, 3] += weight * arm[2]
    result[4, 4] += weight * arm[2]
    result[3, 5] -= weight * arm[0]
    result[4, 5] -= weight * arm[1]
    return result
