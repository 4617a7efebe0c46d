"""The API reference builds from the docstrings by the command that CONTRIBUTING.md gives."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
STRICT = ("-W", "error::UserWarning", "-W", "error::RuntimeWarning")  # what pdoc objects to


def build(folder: Path, *modules: str) -> None:
    """Run the documented command, for some modules or those that it names."""
    pytest.importorskip("pdoc", reason="the extra 'docs' is not installed")
    line = re.search(r"python -m (pdoc .*)", (ROOT / "CONTRIBUTING.md").read_text())
    assert line
    words = shlex.split(line.group(1).split(" #")[0])
    words[words.index("-o") + 1] = str(folder)
    if modules:
        words = [w for w in words if w not in ("fmus_src", "cosim", "optimisation")] + list(modules)
    done = subprocess.run(
        [sys.executable, *STRICT, "-m", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "arn" not in done.stderr, done.stderr


def test_pages_hold_units_shapes_and_errors(tmp_path: Path) -> None:
    build(tmp_path, "fmus_src.component", "fmus_src.tlcd", "cosim.case")
    page = re.sub(r"<[^>]+>", "", (tmp_path / "fmus_src/component.html").read_text())
    assert "largest sub-step of the Runge-Kutta integrator, s." in page
    assert "Inertia tensor about the attachment, body frame" in (tmp_path / "fmus_src/tlcd/model.html").read_text()
    assert "Raises:" in (tmp_path / "cosim/case.html").read_text()


@pytest.mark.slow
def test_the_whole_reference_builds(tmp_path: Path) -> None:
    build(tmp_path)
    for package in ("fmus_src", "cosim", "optimisation"):
        sources = {p.relative_to(ROOT).with_suffix(".html") for p in (ROOT / package).glob("*.py")} - {
            Path(package) / "__init__.html"
        }
        assert sources <= {p.relative_to(tmp_path) for p in tmp_path.rglob("*.html")}
