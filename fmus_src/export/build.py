"""Component -> FMU file, with a cache by content, several at a time."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from platformdirs import user_cache_path

from fmus_src.component import Component
from fmus_src.equations import derive
from fmus_src.export.compiler import FLAGS, compile_shared
from fmus_src.export.documentation import documentation
from fmus_src.export.model_description import model_description
from fmus_src.export.sources import COMPILED, source_files

_EPOCH = (1980, 1, 1, 0, 0, 0)  # zip's own, so that the same content makes the same bytes
_LICENCE = (
    "MIT License. Sources of this FMU: see the folder 'sources'; FMI headers: BSD 2-Clause (Modelica Association).\n"
)


@dataclass(frozen=True)
class Target:
    """A platform to compile for: its FMI 2.0 folder, library suffix and compiler target."""

    folder: str
    suffix: str
    compiler_target: str


def native_target() -> Target:
    """The platform this runs on.

    Raises:
        RuntimeError: FMI 2.0 has no name for it.
    """
    machine = platform.machine().lower()
    if sys.platform.startswith("linux") and machine in ("x86_64", "amd64"):
        return Target("linux64", ".so", "x86_64-linux-gnu.2.17")
    if sys.platform.startswith("linux") and machine in ("aarch64", "arm64"):
        return Target("aarch64-linux", ".so", "aarch64-linux-gnu.2.17")
    if sys.platform == "darwin":
        return Target("darwin64", ".dylib", "aarch64-macos" if machine == "arm64" else "x86_64-macos")
    if sys.platform == "win32":
        return Target("win64", ".dll", "x86_64-windows-gnu")
    raise RuntimeError(f"no FMU platform for {sys.platform} on {machine}")


def build_fmu(component: Component, folder: Path, target: Target | None = None) -> Path:
    """Export a component to `folder/NAME.fmu`; unchanged content is taken from the cache.

    Raises:
        ValueError: the component is incomplete. CompileError: the compiler refused the generated code.
    """
    target = target or native_target()
    content = _content(component)
    key = _digest(content | {"target": repr(target), "flags": repr(FLAGS), "compiler": version("ziglang")})
    cached = user_cache_path("fowt-cosim") / "fmus" / f"{component.name}-{key}.fmu"
    if not cached.exists():
        cached.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cached.parent) as scratch:
            made = _archive(component.name, content, target, Path(scratch))
            made.replace(cached)
    folder.mkdir(parents=True, exist_ok=True)
    result = folder / f"{component.name}.fmu"
    with tempfile.NamedTemporaryFile(dir=folder, delete=False) as copy:
        copy.write(cached.read_bytes())
    Path(copy.name).chmod(0o644)
    Path(copy.name).replace(result)
    return result


def build_all(
    components: Mapping[str, Callable[[], Component]],
    folder: Path,
    progress: Callable[[str, Path], None] | None = None,
) -> dict[str, Path]:
    """Build several components, in parallel; `progress(name, path)` is called as each is done."""
    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        jobs = {pool.submit(_make_and_build, make, folder): name for name, make in components.items()}
        built: dict[str, Path] = {}
        for job in as_completed(jobs):
            built[jobs[job]] = job.result()
            if progress:
                progress(jobs[job], built[jobs[job]])
    return {name: built[name] for name in components}


def _make_and_build(make: Callable[[], Component], folder: Path) -> Path:
    return build_fmu(make(), folder)


def _content(component: Component) -> dict[str, str]:
    """Text files of the FMU by path in the archive; the guid is a digest of all of them."""
    equations = derive(component)
    placeholder = "{GUID}"
    sources = source_files(equations, placeholder)
    files = {f"sources/{name}": text for name, text in sources.items()}
    files["modelDescription.xml"] = model_description(equations, placeholder, COMPILED)
    files["documentation/index.html"] = documentation(equations)
    files["documentation/licenses/license.txt"] = _LICENCE
    digest = _digest(files)
    guid = f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"
    for name in ("sources/model.c", "modelDescription.xml"):
        files[name] = files[name].replace(placeholder, guid)
    return files


def _digest(files: Mapping[str, str]) -> str:
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(f"{name}\0{len(files[name])}\0{files[name]}".encode())
    return digest.hexdigest()


def _archive(name: str, content: Mapping[str, str], target: Target, scratch: Path) -> Path:
    for path, text in content.items():
        (scratch / path).parent.mkdir(parents=True, exist_ok=True)
        (scratch / path).write_text(text, encoding="utf-8", newline="\n")
    library = scratch / "binaries" / target.folder / f"{name}{target.suffix}"
    compile_shared([Path(s) for s in COMPILED], library, target=target.compiler_target, working_dir=scratch / "sources")
    archive = scratch / f"{name}.fmu"
    _pack(archive, scratch, [*content, str(library.relative_to(scratch))])
    shutil.rmtree(scratch / "sources")
    return archive


def _pack(archive: Path, root: Path, names: Iterable[str]) -> None:
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as package:
        for name in sorted(Path(n).as_posix() for n in names):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            package.writestr(entry, (root / name).read_bytes())
