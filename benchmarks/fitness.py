"""Benchmark `fitness`: one evaluation of the optimisation's objective on our FMU against plain SciPy."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp, trapezoid

from benchmarks.measure import Result, Settings, spread

Array = npt.NDArray[np.float64]
# Ours integrates with a fixed step of 0.0125 s and forms the mean squares along; SciPy's is adaptive, rtol 1e-6, and
# sampled for the standard deviation.
TOLERANCE = 1e-3
AIM = 50.0


def rate(t: float, y: Array, p: dict[str, float]) -> Array:
    """Tower, barge and two dampers, linear but for the stops, as an engineer would write Wang et al. (2022), eqs. 1-6.

    Args:
        y: tower angle and platform pitch (rad), nacelle and platform damper (m, global frame), then their rates.
        p: parameters, by the names of the simplified model.
    """
    tower, pitch, x_n, x_p, tower_rate, pitch_rate, v_n, v_p = y
    g = p["gravity"]
    hinge = p["k_t"] * (tower - pitch) + p["d_t"] * (tower_rate - pitch_rate)
    tower_moment = -hinge + p["m_t"] * g * p["R_t"] * tower
    pitch_moment = hinge - p["k_p"] * pitch - p["d_p"] * pitch_rate - p["m_p"] * g * p["R_p"] * pitch
    moments, accelerations = [0.0, 0.0], [0.0, 0.0]
    places = (
        ("nacelle_damper.", 1.0, tower, tower_rate, x_n, v_n),
        ("platform_damper.", -1.0, pitch, pitch_rate, x_p, v_p),
    )
    for i, (name, sign, angle, angle_rate, x, v) in enumerate(places):
        height = sign * p[name + "R"]
        travel, speed = x - height * angle, v - height * angle_rate
        over = max(travel - p[name + "stroke"], 0.0) + min(travel + p[name + "stroke"], 0.0)
        outward = speed if over * speed > 0.0 else 0.0
        stop = -p[name + "k_stop"] * over - p[name + "c_stop"] * outward
        spring = p[name + "k"] * travel + p[name + "c"] * speed
        accelerations[i] = (stop - spring) / p[name + "m"] + g * angle
        moments[i] = height * (spring - stop) + p[name + "m"] * g * travel
    return np.array([
        tower_rate, pitch_rate, v_n, v_p,
        (tower_moment + moments[0]) / p["I_t"], (pitch_moment + moments[1]) / p["I_p"], *accelerations,
    ])  # fmt: skip


def scipy_fitness(parameters: dict[str, float], horizon: float) -> float:
    """Standard deviation over time of the tower-top displacement in a free decay from 5 deg, m (eq. 13)."""
    angle = np.deg2rad(5.0)
    start = np.array([angle, angle, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    times = np.linspace(0.0, horizon, round(horizon / 0.0125) + 1)
    solution = solve_ivp(rate, (0.0, horizon), start, t_eval=times, args=(parameters,), rtol=1e-6, atol=1e-9)
    displacement = parameters["hub_height"] * (solution.y[0] - solution.y[1])
    mean = trapezoid(displacement, times) / horizon
    return float(np.sqrt(trapezoid((displacement - mean) ** 2, times) / horizon))


def fitness(settings: Settings) -> Result:
    """Wall time of an evaluation by the FMU with one and two workers and by SciPy, same candidates and parameters."""
    import fmpy

    from fmus_src.export.build import build_fmu
    from fmus_src.simplified.model import component
    from optimisation.objective import TowerTopDeviation, design

    fmu = build_fmu(component(), settings.folder / "fitness")
    horizon, count, many = (20.0, 2, 20) if settings.quick else (100.0, 4, 400)
    task = design("mtmd")
    names = [v.name for v in task.variables]
    upper = np.array([v.upper for v in task.variables])
    candidates = np.random.default_rng(1).uniform(0.1, 1.0, (many, len(names))) * upper
    known = fmpy.read_model_description(str(fmu)).modelVariables
    fixed = {v.name: float(v.start) for v in known if v.causality == "parameter" and v.type == "Real"}

    def by_scipy() -> Array:
        return np.array([scipy_fitness(fixed | dict(zip(names, c, strict=True)), horizon) for c in candidates[:count]])

    with (
        TowerTopDeviation(fmu, names, task.switches, horizon=horizon) as alone,
        TowerTopDeviation(fmu, names, task.switches, horizon=horizon, workers=2) as pair,
    ):
        runs: dict[str, tuple[Callable[[], Array], int]] = {
            "fowt, 2 workers": (lambda: pair(candidates), many),
            "fowt, 1 worker": (lambda: alone(candidates), many),
            "scipy solve_ivp": (by_scipy, count),
        }
        seconds: dict[str, list[float]] = {name: [] for name in runs}
        values: dict[str, Array] = {}
        for repeat in range(settings.repeats):
            for name, (run, evaluations) in runs.items():
                settings.note(f"round {repeat + 1} of {settings.repeats}: {name}")
                began = time.perf_counter()
                values[name] = run()
                seconds[name].append((time.perf_counter() - began) / evaluations)
    exact = values["scipy solve_ivp"]
    worst = float(np.max(np.abs(values["fowt, 2 workers"][:count] / exact - 1.0)))
    ratio = _ratios(seconds, "fowt, 2 workers")
    return {
        "horizon": horizon,
        "contenders": {n: {"evaluation_seconds": spread(s), "ratio": ratio[n]} for n, s in seconds.items()},
        "agreement": {"tolerance": TOLERANCE, "difference": {"scipy solve_ivp": worst},
                      "agrees": {"scipy solve_ivp": worst <= TOLERANCE}},
        "aim": AIM,
        "within_aim": ratio["scipy solve_ivp"]["median"] >= AIM,
    }  # fmt: skip


def _ratios(seconds: dict[str, list[float]], reference: str) -> dict[str, Any]:
    return {n: spread([a / b for a, b in zip(s, seconds[reference], strict=True)]) for n, s in seconds.items()}
