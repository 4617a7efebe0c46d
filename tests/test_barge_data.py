"""The barge's data files: quadrature over the tower's table, and bad files."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fmus_src.barge.turbine import DATA, load, nrel_5mw_barge


def test_tower_integrals_match_fine_integration():
    tower = nrel_5mw_barge().tower
    table = np.loadtxt(DATA / "tower.csv", delimiter=",", skiprows=2)
    # The line mass is linear between stations, so that the trapezoidal rule gives the mass exactly.
    assert tower.integrals.mass == pytest.approx(np.trapezoid(table[:, 1], table[:, 0] * 87.6), rel=1e-12)
    modal = np.asarray(ca.DM(tower.integrals.modal))
    for i, bending in enumerate((tower.fore_aft, tower.side)):
        columns = slice(2 * i, 2 * i + 2)
        np.testing.assert_allclose(modal[columns, columns], bending.mass, rtol=1e-9)
        # Every shape has unit deflection at the top to the four digits published.
        np.testing.assert_allclose(bending.shape, 1.0, atol=2e-4)
    # Fore-aft and side-to-side do not couple.
    assert np.all(modal[:2, 2:] == 0.0)


def test_bad_data_is_named(tmp_path):
    text = (DATA / "turbine.toml").read_text(encoding="utf-8")
    for name in ("tower.csv", "blade.csv"):
        (tmp_path / name).write_text((DATA / name).read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "turbine.toml").write_text(text.replace("[blade]", "[blades]"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"section \[blade\] is missing"):
        load(tmp_path)
    (tmp_path / "turbine.toml").write_text(text, encoding="utf-8")
    (tmp_path / "blade.csv").write_text("span_fraction,mass_density\n0,1\n0.5,1\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"blade\.csv: column 'span_fraction' must increase from 0 to 1"):
        load(tmp_path)
