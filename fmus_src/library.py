"""The components that this package holds: every folder here with a `model.py` that defines `component()`."""

from __future__ import annotations

import difflib
import hashlib
import importlib
import inspect
import json
import pkgutil
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from platformdirs import user_cache_path

from fmus_src.aero.machine import rotor_files
from fmus_src.barge.turbine import FILES
from fmus_src.component import Component
from fmus_src.compose import Connection, compose
from fmus_src.export.build import build_all, build_fmu, fmu_name
from fmus_src.export.platforms import Platform
from fmus_src.hydro.database import PACKAGED

ROOT = Path(__file__).parent
WAMIT = (".1", ".3", ".hst")


def component_names() -> list[str]:
    """Names of all components, in alphabetical order."""
    folders = (m.name for m in pkgutil.iter_modules([str(ROOT)]) if m.ispkg)
    return sorted(name for name in folders if (ROOT / name / "model.py").exists())


def make(name: str, options: Mapping[str, Any] | None = None) -> Component:
    """Define a component by the name of its folder.

    Args:
        options: keyword arguments of its `component()`, as text or as what `str` makes text of (default: none, its
            default arguments). The component's description then says what it was built from.

    Raises:
        ValueError: no such component or option, a value that is none of its type, or what `component()` objects to.
    """
    factory = _defining(name)
    arguments = _arguments(name, factory, options or {})
    component = factory(**arguments)
    if arguments:
        component.description += f". Built with {'; '.join(_labels(arguments))}"
    return component


def build_library(
    names: Sequence[str] | None = None,
    progress: Callable[[str, Path], None] | None = None,
    *,
    fmi: str = "2",
    platforms: Sequence[Platform] = (),
) -> tuple[Path, dict[str, Path]]:
    """Build the named components (default: all) into the user's cache; what is there for these sources is kept.

    Args:
        fmi, platforms: see `build_fmu`.

    Returns:
        the folder, and the FMU of each name.

    Raises:
        ValueError: no such component.
    """
    folder = _folder(platforms)
    wanted = component_names() if names is None else list(names)
    for name in wanted:
        _check_name(name)
    paths = {name: folder / fmu_name(name, fmi) for name in wanted}
    missing = {name: _factory(name) for name in wanted if not paths[name].exists()}
    for name in wanted:
        if name not in missing and progress:
            progress(name, paths[name])
    if missing:
        build_all(missing, folder, progress, fmi=fmi, platforms=platforms)
    return folder, paths


def build_variant(name: str, options: Mapping[str, Any], *, fmi: str = "2", platforms: Sequence[Platform] = ()) -> Path:
    """Build one component with options into the user's cache; what is there for these sources and files is kept.

    Args:
        name: folder of the component.
        options: see `make`. A path may be that of a file or of a set of files ("DIR/Barge" for Barge.1, Barge.3, ...):
            their content is part of the cache's key.
        fmi, platforms: see `build_fmu`.

    Returns:
        the FMU `name.fmu` in a folder of its own.

    Raises:
        ValueError: as `make`.
    """
    if not options:
        return build_library([name], fmi=fmi, platforms=platforms)[1][name]
    arguments = _arguments(name, _defining(name), options)
    key = hashlib.sha256("\n".join([name, *_labels(arguments, 64)]).encode()).hexdigest()
    folder = _folder(platforms) / f"{name}-{key[:16]}"
    path = folder / fmu_name(name, fmi)
    return path if path.exists() else build_fmu(make(name, options), folder, fmi=fmi, platforms=platforms)


def build_system(
    name: str, parts: Mapping[str, str], connections: Sequence[Connection], internal_step: float | None = None
) -> Path:
    """Build components as one FMU into the user's cache; what is there for these sources is kept.

    Args:
        parts: folder of the component by its name in the system.
        connections, internal_step: see `compose`.

    Returns:
        the FMU `name.fmu` in a folder of its own.

    Raises:
        ValueError: no such component, or what `compose` objects to.
    """
    folder = _cache() / f"{name}-{_digest(parts, list(connections), internal_step)[:16]}"
    path = folder / f"{name}.fmu"
    if path.exists():
        return path
    components = {part: make(component) for part, component in parts.items()}
    return build_fmu(compose(name, components, connections, internal_step=internal_step), folder)


def _digest(*values: Any) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()


def option_names(name: str) -> list[str]:
    """Options that a component takes.

    Raises:
        ValueError: no such component.
    """
    return list(inspect.signature(_defining(name)).parameters)


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


def _folder(platforms: Sequence[Platform]) -> Path:
    return _cache() / "+".join(p.name for p in platforms)


def _factory(name: str) -> Callable[[], Component]:
    return lambda: make(name)


def _check_name(name: str) -> None:
    known = component_names()
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
        some = ", ".join(f"'{n}'" for n in known[:6]) + (", ..." if len(known) > 6 else "")
        hint = f"did you mean '{close[0]}'?" if close else f"there are {some}"
        raise ValueError(f"no component '{name}'; {hint}")


def _defining(name: str) -> Callable[..., Component]:
    """The function `component()` of a component's folder."""
    _check_name(name)
    factory: Callable[..., Component] = importlib.import_module(f"fmus_src.{name}.model").component
    return factory


def _arguments(name: str, factory: Callable[..., Component], options: Mapping[str, Any]) -> dict[str, Any]:
    """Options, given as text, in the types of the factory's arguments."""
    hints = typing.get_type_hints(factory)
    known = inspect.signature(factory).parameters
    for option in options:
        if option not in known:
            has = f"its options are {', '.join(known)}" if known else "it has none"
            raise ValueError(f"{name}: no option '{option}'; {has}")
    return {option: _convert(name, option, str(value), hints[option]) for option, value in options.items()}


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
    words = {bool: "true or false", int: "whole number", float: "number"}
    wanted = " or ".join(dict.fromkeys(words[kind] for kind in kinds if kind in words))
    raise ValueError(
        f"{name}: option {option}='{text}' " + (f"is no {wanted}" if wanted else "cannot be given as text")
    )


def _labels(arguments: Mapping[str, Any], digits: int = 8) -> list[str]:
    """Each argument as `name=value`; of files the name and the head of their SHA-256, wherever they are."""
    labels = []
    for option, value in sorted(arguments.items()):
        files = _named_files(option, value)
        digest = hashlib.sha256()
        for file in files:
            digest.update(f"{file.name} {file.stat().st_size}\n".encode())
            digest.update(file.read_bytes())
        label = f"{Path(value).name} (sha256 {digest.hexdigest()[:digits]})" if files else str(value)
        labels.append(f"{option}={label}")
    return labels


def _named_files(option: str, value: Any) -> list[Path]:
    """The files that an argument names: one, WAMIT's set by its root (`DIR/Barge`) or one of its files, or those of a
    rotor or turbine."""
    # A number is none, nor is the name of a packaged database, whatever lies in the working folder.
    if not isinstance(value, str | Path) or (option == "database" and str(value) in PACKAGED):
        return []
    path = Path(value)
    if option in ("rotor", "turbine"):
        files = rotor_files(path) if option == "rotor" else [path / name for name in FILES]
        return sorted({file for file in files if file.is_file()})
    root = path.with_suffix("") if path.suffix in WAMIT else path
    candidates = {path, *(root.with_name(root.name + suffix) for suffix in WAMIT if root.name)}
    return sorted(p for p in candidates if p.is_file())
