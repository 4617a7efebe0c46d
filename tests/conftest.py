"""What several tests share: exported FMUs, the command line, and small components with closed-form behaviour."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import pytest

from cosim.cli import main
from fmus_src.component import Component
from fmus_src.equations import Equations, derive
from fmus_src.export.build import build_fmu

from .loaded import Loaded


@pytest.fixture(scope="session")
def fmu_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fmus")


@pytest.fixture(scope="session")
def built(fmu_folder: Path) -> Callable[[Component], Path]:
    """Build a component's FMU into the session's folder (the content cache makes repeats cheap)."""
    return lambda component: build_fmu(component, fmu_folder)


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


@pytest.fixture
def fowt(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[..., Outcome]:
    """Run the command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")

    def run(*words: str) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["fowt", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return Outcome(int(ended.value.code or 0), printed.out, printed.err)

    return run


@pytest.fixture(scope="session")
def aero() -> Equations:
    """The rotor component, for in-process instances."""
    from fmus_src.aero.model import component

    return derive(component())


@pytest.fixture(scope="session")
def aero_fmu(built: Callable[[Component], Path], tmp_path_factory: pytest.TempPathFactory) -> Loaded:
    from fmus_src.aero.model import component

    return Loaded(built(component()), tmp_path_factory.mktemp("aero"))


def every_feature() -> Component:
    """A component that uses each feature of the runtime: kinds, sampled states, table, implicit equation, switch."""
    c = Component("every_feature", "Test component with every feature", sample_time=0.1, internal_step=0.05)
    rate = c.parameter("rate", 2.0, unit="1/s", min=0.0, max=100.0, description="decay rate", tunable=True)
    n = c.parameter("n", 3, kind="integer", min=1, max=9, description="an integer")
    on = c.parameter("on", 1, kind="boolean", description="a switch")
    matrix = c.parameter("matrix", [[1.0, 2.0], [3.0, 4.0]], description="a matrix")
    c.string_parameter("file", description="a wind file")
    scaled = c.calculated("scaled", rate * n, unit="1/s", description="rate times n")
    u = c.input("u", 2, unit="m", description="two inputs")
    x = c.state("x", 2, unit="m", start=ca.vertcat(n, 1), description="states")
    z = c.sampled_state("z", description="a sampled count", start=n)
    before = c.sampled_state("before", 2, internal=True, description="input at the last sample")
    moved = c.intermediate("moved", ca.horzcat(x + u, x - u))
    curve = c.table("curve", _parabola(), -1.0, 0.1, [0, 0], u)
    y, a = ca.SX.sym("y"), ca.SX.sym("a")
    cube = ca.Function("cube", [y, a], [y**3 + y - a])
    root = c.solve("cubic", cube, ca.Function("guess", [a], [a / (1 + a**2)]), ca.vertcat(u[0], u[1] + x[0]))
    beyond = c.switch("beyond", ca.vertcat(x[0] - 2.5, u[1] - 0.2))
    c.derivative(x, -rate * x + ca.if_else(on, u, 0) - ca.vertcat(ca.dot(beyond, 3 * u), 0))
    c.update(z, z + 1)
    c.update(before, u)
    c.output("rotated", ca.mtimes(matrix, x), unit="m", description="matrix times x")
    c.output("feedthrough", curve[:, 0] + u[1] * z, description="table and product")
    c.output("root", root, description="solutions of y^3 + y = a")
    c.output("product", moved[:, 0] * moved[:, 1], unit="m2", description="of an intermediate result")
    c.output("held", before, unit="m", description="input at the last sample")
    c.output("scaled_again", scaled, unit="1/s", description="a calculated parameter")
    return c


def _parabola():  # type: ignore[no-untyped-def]
    import numpy as np

    grid = np.linspace(-1.0, 1.0, 21)
    return (grid**2)[None, :, None]
