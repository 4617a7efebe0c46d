"""The components that this package holds: every folder here with a `model.py` that defines `component()`."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import pkgutil
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from platformdirs import user_cache_path

from fmus_src.component import Component
from fmus_src.export.build import build_all, build_fmu

ROOT = Path(__file__).parent


def component_names() -> list[str]:
    """Names of all components, in alphabetical order."""
    folders = (m.name for m in pkgutil.iter_modules([str(ROOT)]) if m.ispkg)
    return sorted(name for name in folders if (ROOT / name / "model.py").exists())


def make(name: str, options: Mapping[str, str] | None = None) -> Component:
    """Define a component by the name of its folder.

    Args:
        options: keyword arguments of its `component()` as text (default: none, its default arguments). The
            component's description then says what it was built from.

    Raises:
        ValueError: no such option, a value that is none of its type, or what `component()` objects to.
    """
    factory: Callable[..., Component] = importlib.import_module(f"fmus_src.{name}.model").component
    component = factory(**_arguments(name, factory, options or {}))
    if options:
        component.description += f". Built with {'; '.join(_labels(options))}"
    return component


def build_library(
    names: Sequence[str] | None = None, progress: Callable[[str, Path], None] | None = None
) -> tuple[Path, dict[str, Path]]:
    """Build the named components (default: all) into the user's cache; what is there for these sources is kept.

    Returns:
        the folder, and the FMU of each name.
    """
    folder = _cache()
    wanted = component_names() if names is None else list(names)
    missing = {name: _factory(name) for name in wanted if not (folder / f"{name}.fmu").exists()}
    for name in wanted:
        if name not in missing and progress:
            progress(name, folder / f"{name}.fmu")
    if missing:
        build_all(missing, folder, progress)
    return folder, {name: folder / f"{name}.fmu" for name in wanted}


def build_variant(name: str, options: Mapping[str, str]) -> Path:
    """Build one component with options into the user's cache; what is there for these sources and files is kept.

    Args:
        name: folder of the component.
        options: see `make`. A path may be that of a file or of a set of files ("DIR/Barge" for Barge.1, Barge.3, ...):
            their content is part of the cache's key.

    Returns:
        the FMU `name.fmu` in a folder of its own.

    Raises:
        ValueError: as `make`.
    """
    if not options:
        return build_library([name])[1][name]
    key = hashlib.sha256("\n".join([name, *_labels(options, 64)]).encode()).hexdigest()
    folder = _cache() / f"{name}-{key[:16]}"
    path = folder / f"{name}.fmu"
    return path if path.exists() else build_fmu(make(name, options), folder)


def option_names(name: str) -> list[str]:
    """Options that a component takes."""
    return list(inspect.signature(importlib.import_module(f"fmus_src.{name}.model").component).parameters)


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


def _cache() -> Path:
    return user_cache_path("fowt-cosim") / "library" / sources_digest()[:16]


def _factory(name: str) -> Callable[[], Component]:
    return lambda: make(name)


def _arguments(name: str, factory: Callable[..., Component], options: Mapping[str, str]) -> dict[str, Any]:
    """Options, given as text, in the types of the factory's arguments."""
    hints = typing.get_type_hints(factory)
    known = inspect.signature(factory).parameters
    for option in options:
        if option not in known:
            has = f"its options are {', '.join(known)}" if known else "it has none"
            raise ValueError(f"{name}: no option '{option}'; {has}")
    return {option: _convert(name, option, text, hints[option]) for option, text in options.items()}


def _convert(name: str, option: str, text: str, hint: Any) -> Any:
    """Text as the first of its argument's types that takes it; in `X | str | None` a text that is no number is str."""
    kinds = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    if bool in kinds and text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float, str, Path):
        if kind in kinds:
            try:
                return kind(text)
            except ValueError:
                continue
    wanted = " or ".join(kind.__name__ for kind in kinds if kind in (bool, int, float))
    raise ValueError(
        f"{name}: option {option}='{text}' " + (f"is no {wanted}" if wanted else "cannot be given as text")
    )


def _labels(options: Mapping[str, str], digits: int = 8) -> list[str]:
    """Each option as `name=value`; of files the name and the head of their SHA-256, wherever they are."""
    labels = []
    for option, text in sorted(options.items()):
        files = _named_files(Path(text))
        digest = hashlib.sha256()
        for file in files:
            digest.update(f"{file.name} {file.stat().st_size}\n".encode())
            digest.update(file.read_bytes())
        label = f"{Path(text).name} (sha256 {digest.hexdigest()[:digits]})" if files else text
        labels.append(f"{option}={label}")
    return labels


def _named_files(path: Path) -> list[Path]:
    """The files that an option's text names: a file, all in a folder, or a set such as Barge.1, Barge.3 (`Barge`)."""
    if path.is_dir():
        return sorted(p for p in path.rglob("*") if p.is_file())
    root = path.with_suffix("") if path.suffix[1:].isdigit() else path
    if path.is_file() and root == path:
        return [path]
    if not path.name or not path.parent.is_dir():
        return []
    return sorted(p for p in path.parent.iterdir() if p.is_file() and p.name.startswith(f"{root.name}."))
