"""The commands of docs/fmus.md do what it says, in the order in which it has them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

from tests.conftest import Outcome

PAGE = Path(__file__).parents[1] / "docs/fmus.md"


def test_the_commands_run(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    (block,) = re.findall(r"<!-- run -->\n```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    commands = [shlex.split(line, comments=True) for line in block.splitlines()]
    assert len(commands) == 7
    for words in commands:
        assert words[0] == "fowt"
        outcome = fowt(*words[1:])
        assert outcome.code == 0, f"{words}: {outcome.err}"
    assert (tmp_path / "runs/decay/results.parquet").is_file()
    assert (tmp_path / "runs/decay-2/results.parquet").is_file()
