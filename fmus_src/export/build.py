"""Component -> FMU file, with a cache by content, several at a time."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from importlib.metadata import version
from pathlib import Path

from platformdirs import user_cache_path

from fmus_src.component import Component
from fmus_src.equations import derive
from fmus_src.export.compiler import FLAGS, compile_shared
from fmus_src.export.documentation import documentation, licence
from fmus_src.export.exported import Exports
from fmus_src.export.icon import png, port, svg, turbine
from fmus_src.export.model_description import model_description
from fmus_src.export.model_description3 import build_description, model_description3
from fmus_src.export.platforms import Platform, native_platform
from fmus_src.export.sources import COMPILED, source_files
from fmus_src.export.terminals import terminals_and_icons
from fmus_src.export.universal import universal

_EPOCH = (1980, 1, 1, 0, 0, 0)  # zip's own, so that the same content makes the same bytes
# Tells importers where the FMU looks for files; cosim/resources.py puts files there on its word.
RESOURCES_NOTE = "extra/org.fowt-cosim.resources/README.txt"
_RESOURCES = """A file that a text parameter names by a relative path is looked for in this FMU's resources/ first, then
as the path says. A copy of this FMU with files added to resources/ may lengthen its guid (instantiationToken) by '+'
and any text, so that importers that keep FMUs by guid tell the copies apart.
"""
_IMAGES = {"icon": turbine, "port": port}


def build_fmu(
    component: Component,
    folder: Path,
    *,
    fmi: str = "2",
    platforms: Sequence[Platform] = (),
) -> Path:
    """Export a component to `folder/NAME.fmu` (`NAME-fmi3.fmu`); unchanged content is taken from the cache.

    Args:
        fmi: "2" or "3": FMI 2.0 or 3.0, each for co-simulation and model exchange.
        platforms: to compile for; none: the one this runs on.

    Raises:
        ValueError: the component is incomplete, or there is no such version of FMI.
        CompileError: the compiler refused the generated code.
    """
    if fmi not in COMPILED:
        raise ValueError(f"no FMI version '{fmi}': there are {' and '.join(COMPILED)}")
    chosen = tuple(platforms) or (native_platform(),)
    content = _content(component, fmi)
    settings = {"platforms": repr(chosen), "flags": repr(FLAGS), "compiler": version("ziglang")}
    key = _digest(content | {name: text.encode() for name, text in settings.items()})
    cached = user_cache_path("fowt-cosim") / "fmus" / f"{component.name}-{key}.fmu"
    if not cached.exists():
        cached.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cached.parent) as scratch:
            made = _archive(component.name, content, fmi, chosen, Path(scratch))
            made.replace(cached)
    folder.mkdir(parents=True, exist_ok=True)
    result = folder / fmu_name(component.name, fmi)
    with tempfile.NamedTemporaryFile(dir=folder, delete=False) as copy:
        copy.write(cached.read_bytes())
    Path(copy.name).chmod(0o644)
    Path(copy.name).replace(result)
    return result


def fmu_name(component: str, fmi: str = "2") -> str:
    """File name of a component's FMU: that of FMI 3.0 can stand beside that of FMI 2.0."""
    return f"{component}.fmu" if fmi == "2" else f"{component}-fmi{fmi}.fmu"


def build_all(
    components: Mapping[str, Callable[[], Component]],
    folder: Path,
    progress: Callable[[str, Path], None] | None = None,
    *,
    fmi: str = "2",
    platforms: Sequence[Platform] = (),
) -> dict[str, Path]:
    """Build several components, in parallel; `progress(name, path)` is called as each is done."""

    def make_and_build(make: Callable[[], Component]) -> Path:
        return build_fmu(make(), folder, fmi=fmi, platforms=platforms)

    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        jobs = {pool.submit(make_and_build, make): name for name, make in components.items()}
        built: dict[str, Path] = {}
        for job in as_completed(jobs):
            built[jobs[job]] = job.result()
            if progress:
                progress(jobs[job], built[jobs[job]])
    return {name: built[name] for name in components}


def _content(component: Component, fmi: str = "2") -> dict[str, bytes]:
    """Files of the FMU by path in the archive, but binaries; the guid is a digest of all of them."""
    exports = Exports(derive(component))
    placeholder = "{GUID}"
    texts = {f"sources/{name}": text for name, text in source_files(exports, placeholder, fmi).items()}
    texts["documentation/index.html"] = documentation(exports.equations, fmi)
    texts["documentation/licenses/license.txt"] = licence(component)
    if exports.equations.strings:
        texts[RESOURCES_NOTE] = _RESOURCES
    images = {"model.png": png(turbine())}
    if fmi == "2":
        texts["modelDescription.xml"] = model_description(exports, placeholder, COMPILED["2"])
    else:
        texts["modelDescription.xml"] = model_description3(exports, placeholder)
        texts["sources/buildDescription.xml"] = build_description(component.name, COMPILED["3"])
        texts["terminalsAndIcons/terminalsAndIcons.xml"] = terminals_and_icons(exports.equations)
        texts |= {f"terminalsAndIcons/{name}.svg": svg(shapes()) for name, shapes in _IMAGES.items()}
        images = {f"terminalsAndIcons/{name}.png": png(shapes()) for name, shapes in _IMAGES.items()}
    files = {path: text.encode() for path, text in texts.items()} | images
    digest = _digest(files)
    guid = f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"
    for name in ("sources/model.c", "modelDescription.xml"):
        files[name] = files[name].replace(placeholder.encode(), guid.encode())
    return files


def _digest(files: Mapping[str, bytes]) -> str:
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(f"{name}\0{len(files[name])}\0".encode() + files[name])
    return digest.hexdigest()


def _archive(name: str, content: Mapping[str, bytes], fmi: str, platforms: Sequence[Platform], scratch: Path) -> Path:
    for path, data in content.items():
        (scratch / path).parent.mkdir(parents=True, exist_ok=True)
        (scratch / path).write_bytes(data)
    sources = [Path(s) for s in COMPILED[fmi]]
    made: dict[Path, list[Path]] = {}  # what goes into each file of the archive
    for p in platforms:
        library = scratch / "compiled" / p.name / f"{name}{p.suffix}"
        compile_shared(sources, library, target=p.compiler_target, working_dir=scratch / "sources")
        place = scratch / "binaries" / (p.fmi2 if fmi == "2" else p.fmi3) / library.name
        made.setdefault(place, []).append(library)
    for place, libraries in made.items():
        place.parent.mkdir(parents=True, exist_ok=True)
        parts = [library.read_bytes() for library in libraries]
        place.write_bytes(parts[0] if len(parts) == 1 else universal(parts))
    archive = scratch / f"{name}.fmu"
    _pack(archive, scratch, [*content, *(str(place.relative_to(scratch)) for place in made)])
    shutil.rmtree(scratch / "sources")
    return archive


def _pack(archive: Path, root: Path, names: Iterable[str]) -> None:
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as package:
        for name in sorted(Path(n).as_posix() for n in names):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            package.writestr(entry, (root / name).read_bytes())
