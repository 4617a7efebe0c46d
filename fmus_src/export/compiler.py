"""The C compiler that pip installs: `zig cc` from the `ziglang` wheel, so that no system compiler is needed."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

FLAGS = ("-std=c99", "-O2", "-fno-math-errno", "-ffp-contract=off", "-fvisibility=hidden", "-Wall", "-Wextra")
GENERATED_CODE_FLAGS = ("-Wno-unused-parameter", "-Wno-unused-variable", "-Wno-unused-function")


class CompileError(RuntimeError):
    """The C compiler refused the sources."""


def compile_shared(
    sources: Sequence[Path],
    output: Path,
    include_dirs: Sequence[Path] = (),
    *,
    target: str | None = None,
    working_dir: Path | None = None,
) -> Path:
    """Compile C sources into a shared library with no dependency beyond libc and libm.

    Args:
        sources: C files; give them relative to `working_dir` for output that does not depend on where it is built.
        target: zig target such as "x86_64-linux-gnu.2.17"; the machine's own by default.

    Raises:
        CompileError: with the compiler's first error line.
    """
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=output.parent) as scratch:
        built = Path(scratch) / output.name
        command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, *GENERATED_CODE_FLAGS, "-shared", "-fPIC", "-s"]
        command += ["-target", target] if target else []
        command += [f"-I{d}" for d in include_dirs] + [str(s) for s in sources]
        command += ["-lm", "-o", str(built.resolve())]
        done = subprocess.run(command, cwd=working_dir, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            lines = [line for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines()
            raise CompileError(f"compiling {output.name} failed: {(lines or ['no message'])[0]}")
        built.replace(output)
    return output
