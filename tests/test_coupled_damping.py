"""The default algorithm keeps the analytic damping of the floating tower and of the barge in pitch.

Here the platform's whole restoring (buoyancy, mooring, radiation memory) crosses the coupling.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from cosim.case import read_case
from cosim.cli.run import Changes, prepare
from cosim.run import simulate
from fmus_src.instance import Instance
from fmus_src.library import make

OFF = ("generator", "drivetrain")


def analytic_modes(parts: Mapping[str, Instance]) -> np.ndarray:
    """Eigenvalues of barge, waves and mooring as one linear system, from differences of their joint right-hand side."""
    barge, hydro, mooring = parts["barge"], parts["hydro"], parts["mooring"]
    sizes = [barge.equations.sizes["x"], hydro.equations.sizes["x"]]

    def rate(x: np.ndarray) -> np.ndarray:
        barge.set_states(x[: sizes[0]])
        hydro.set_states(x[sizes[0] :])
        motion = {n: v for n, v in barge.outputs().items() if n.startswith("platform.")}
        loads = {}
        for name, part in (("hydro", hydro), ("mooring", mooring)):
            wanted = [n for v in part.equations.of("input") for n in v.element_names()]
            part.set({n: motion[n] for n in wanted})
            wanted_by_barge = ("force", "moment", "added_mass")
            loads |= {f"{name}.{n}": v for n, v in part.outputs().items() if n.startswith(wanted_by_barge)}
        barge.set(loads)
        return np.concatenate([barge.derivative(), hydro.derivative()])

    def jacobian(x: np.ndarray, step: float = 1e-5) -> np.ndarray:
        return np.array([(rate(x + step * e) - rate(x - step * e)) / (2 * step) for e in np.eye(x.size)]).T

    x = np.zeros(sum(sizes))
    x -= np.linalg.pinv(jacobian(x), rcond=1e-10) @ rate(x)  # the equilibrium lies 0.13 m deeper; locked rows are zero
    return np.linalg.eigvals(jacobian(x))


def identified_modes(signal: np.ndarray, interval: float, order: int) -> np.ndarray:
    """Exponents of a sum of decaying oscillations, by the matrix pencil method (Hua and Sarkar, 1990)."""
    rows = signal.size // 2
    hankel = np.lib.stride_tricks.sliding_window_view(signal, rows).T
    basis = np.linalg.svd(hankel, full_matrices=False)[0][:, :order]
    poles = np.linalg.eigvals(np.linalg.pinv(basis[:-1]) @ basis[1:])
    return np.log(poles.astype(complex)) / interval


def nearest_mode(exponents: np.ndarray, hertz: float) -> complex:
    upper = exponents[exponents.imag > 0]
    return complex(upper[np.abs(upper.imag / (2 * np.pi) - hertz).argmin()])


@pytest.fixture(scope="module")
def analytic() -> np.ndarray:
    parts = {name: Instance(make(name)) for name in ("barge", "hydro", "mooring")}
    parts["barge"].set({f"dof.{name}": 0.0 for name in OFF})
    parts["hydro"].set({"Hs": 0.0})
    for part in parts.values():
        part.initialise()
    return analytic_modes(parts)


@pytest.mark.parametrize(
    ("start", "channel", "span", "every", "order", "hertz"),
    [  # each span leaves the faster modes to die first, each order leaves room for the modes that remain
        ("barge.initial.tower_fore_aft=0.02", "TTDspFA", (2.0, 40.0), 2, 24, 0.543),
        ("barge.initial.pitch=0.002", "PtfmPitch", (200.0, 500.0), 16, 10, 0.084),
    ],
)
def test_modes_keep_their_analytic_damping(
    tmp_path: Path,
    analytic: np.ndarray,
    start: str,
    channel: str,
    span: tuple[float, float],
    every: int,
    order: int,
    hertz: float,
) -> None:
    """Small starts, so that catenaries and quadratic drag stay linear."""
    prepared = prepare(read_case("decay-surge"), None, Changes(set=("barge.initial.surge=0", start)), quiet=True)
    frame = simulate(prepared.system, prepared.settings, tmp_path / "run").frame()
    record = frame.loc[span[0] : span[1], channel].iloc[::every]
    interval = float(record.index[1] - record.index[0])
    found = nearest_mode(identified_modes(record.to_numpy(), interval, order), hertz)
    exact = nearest_mode(analytic, hertz)
    damping = [-e.real / abs(e) for e in (found, exact)]
    assert abs(found) == pytest.approx(abs(exact), rel=1e-3)
    assert damping[0] == pytest.approx(damping[1], abs=1e-4)
