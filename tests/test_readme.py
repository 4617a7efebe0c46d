"""The documents' examples, run as they stand."""

from __future__ import annotations

import doctest
import re
import runpy
import shlex
from pathlib import Path

import pytest

import fmus_src.component
import fmus_src.compose
import fmus_src.instance

README = Path(__file__).parent.parent / "README.md"


def test_python_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = re.search(r"```python\n(.*?)```", README.read_text(), re.S)
    assert code
    (tmp_path / "example.py").write_text(code.group(1))
    monkeypatch.chdir(tmp_path)
    runpy.run_path("example.py")
    assert (tmp_path / "fmus/oscillator.fmu").exists()


def test_commands_of_the_documents_exist(capsys: pytest.CaptureFixture[str]) -> None:
    """Every option that the documents show is one that the command knows."""
    from cosim.cli import app

    text = "\n".join(page.read_text() for page in (README, *README.parent.glob("docs/*.md")))
    lines = [line.split("#")[0].strip() for line in text.splitlines() if line.startswith("fowt ")]
    assert len(lines) >= 15
    for line in lines:
        _, command, *words = shlex.split(line)
        app([command, "--help"], standalone_mode=False)
        shown = capsys.readouterr().out
        assert all(w in shown for w in words if w.startswith("--")), line


@pytest.mark.parametrize("module", [fmus_src.component, fmus_src.instance, fmus_src.compose])
def test_docstring_examples(module: object) -> None:
    assert doctest.testmod(module).failed == 0  # type: ignore[arg-type]


def test_links_lead_somewhere() -> None:
    for page in [README, *README.parent.glob("docs/*.md"), *README.parent.glob("fmus_src/*/README.md")]:
        for target in re.findall(r"\]\((?!http)([^)#]+)\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page}: {target}"
