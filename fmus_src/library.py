"""The components that this package holds: every folder here with a `model.py` that defines `component()`."""

from __future__ import annotations

import hashlib
import importlib
import pkgutil
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path

from platformdirs import user_cache_path

from fmus_src.component import Component
from fmus_src.export.build import build_all

ROOT = Path(__file__).parent


def component_names() -> list[str]:
    """Names of all components, in alphabetical order."""
    folders = (m.name for m in pkgutil.iter_modules([str(ROOT)]) if m.ispkg)
    return sorted(name for name in folders if (ROOT / name / "model.py").exists())


def make(name: str) -> Component:
    """Define a component by the name of its folder, with its default arguments."""
    component: Component = importlib.import_module(f"fmus_src.{name}.model").component()
    return component


def build_library(
    names: Sequence[str] | None = None, progress: Callable[[str, Path], None] | None = None
) -> tuple[Path, dict[str, Path]]:
    """Build the named components (default: all) into the user's cache; what is there for these sources is kept.

    Returns:
        the folder, and the FMU of each name.
    """
    folder = user_cache_path("fowt-cosim") / "library" / sources_digest()[:16]
    wanted = component_names() if names is None else list(names)
    missing = {name: _factory(name) for name in wanted if not (folder / f"{name}.fmu").exists()}
    for name in wanted:
        if name not in missing and progress:
            progress(name, folder / f"{name}.fmu")
    if missing:
        build_all(missing, folder, progress)
    return folder, {name: folder / f"{name}.fmu" for name in wanted}


def sources_digest() -> str:
    """Digest of everything an FMU's content follows from: this package's files and the versions of what makes C."""
    digest = hashlib.sha256()
    for package in ("casadi", "ziglang", "fmpy"):
        digest.update(f"{package} {version(package)}\n".encode())
    for path in sorted(ROOT.rglob("*")):
        if path.is_file() and path.suffix not in (".pyc", ".md"):
            digest.update(f"{path.relative_to(ROOT).as_posix()}\n".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _factory(name: str) -> Callable[[], Component]:
    return lambda: make(name)
