"""Files from elsewhere, damaged at random: each is read, or refused in one line; none crashes or hangs the program.

The wind file's own test is in test_turbsim_file.py.
"""

from __future__ import annotations

import itertools
import os
import zipfile
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import fmpy
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from cosim.archive import extract
from cosim.case import read_case, shipped_cases
from cosim.checks import check
from cosim.errors import CosimError
from cosim.fmu import read_fmu
from cosim.ssp import read_package, read_parameters, read_system
from cosim.ssp_parameters import read_mapping
from fmus_src.component import Component

from .cosim_fmus import carried, mass, probe_description
from .foreign_damper import description
from .relay import description as relay_description
from .test_ssp_package import MAP, NESTED, SET

# what has broken parsers before: names, numbers out of range, markup, entities, bytes that are no text
NASTY = (
    *"/\\]'\"<>{=\n\x00\udcff", "", "0", "-1", "1e999", "nan", "INF", "9" * 30, "9" * 400, "true", "x", "a.b.c", "../x",
    "é", "<a/>", "</", "&amp;", "&x;", "<!DOCTYPE x [<!ENTITY x 'y'>]>", "<!--", "]]>", "<?x?>", "[x]", "%00",
    "%2e%2e/", "file:///etc/passwd", "(" * 50, "[" * 2000, "a." * 2000, "1979-05-27", "0x1F", '"""',
)  # fmt: skip
counter = itertools.count()
brief = settings(
    max_examples=int(os.environ.get("FUZZ", "40")),
    deadline=timedelta(seconds=5),  # a hang; the slowest takes 0.1 s on an idle machine
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    phases=[Phase.explicit, Phase.generate],
    derandomize="FUZZ" not in os.environ,
)


def damaged(text: str) -> st.SearchStrategy[str]:
    """The text with a few stretches replaced by something nasty, or by another part of itself."""
    patch = st.tuples(
        st.integers(0, len(text)), st.integers(0, 12), st.sampled_from(NASTY) | st.text(max_size=6), st.booleans()
    )

    def apply(patches: list[tuple[int, int, str, bool]]) -> str:
        result = text
        for at, length, new, from_itself in patches:
            piece = text[(at * 7) % len(text) :][: 40 + length] if from_itself else new
            result = result[:at] + piece + result[at + length :]
        return result

    return st.lists(patch, min_size=1, max_size=4).map(apply)


def values_changed(text: str) -> st.SearchStrategy[str]:
    """The text with one of its attributes' values replaced: markup stays whole, so that damage comes further in."""
    parts = text.split('"')
    return st.tuples(st.integers(0, len(parts) // 2 - 1), st.sampled_from(NASTY) | st.text(max_size=8)).map(
        lambda c: '"'.join([*parts[: 2 * c[0] + 1], c[1], *parts[2 * c[0] + 2 :]])
    )


def both(text: str) -> st.SearchStrategy[str]:
    return damaged(text) | values_changed(text)


def read_or_refuse(read: Callable[[], Any]) -> None:
    """Nothing but a CosimError of one line, of which a terminal can print a reasonable part."""
    words = "read"
    try:
        read()
    except CosimError as error:
        words = str(error)
    assert "\n" not in words
    assert 0 < len(words) < 2001
    assert words.isprintable()


def encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape" if "\udcff" in text else "strict")


@given(text=both(probe_description()) | both(description()) | both(relay_description(intermediate=True)))
@brief
def test_model_descriptions(text: str, tmp_path: Path) -> None:
    path = tmp_path / f"{next(counter)}.fmu"  # read_fmu remembers by name and time
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", encoded(text))
        for name in ("probe", "foreign_damper", "relay"):
            for platform in (fmpy.platform, fmpy.platform_tuple):
                archive.writestr(f"binaries/{platform}/{name}{fmpy.sharedLibraryExtension}", b"")
    read_or_refuse(lambda: read_fmu(path))
    path.unlink()


@pytest.fixture(scope="module")
def folder(built: Callable[[Component], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    (folder / "resources").mkdir()
    (folder / "extra").mkdir()
    for fmu in (built(mass()), built(carried())):
        (folder / "resources" / fmu.name).write_bytes(fmu.read_bytes())
    (folder / "extra/set.ssv").write_text(SET)
    (folder / "extra/map.ssm").write_text(MAP)
    (folder / "x.ssd").write_text(NESTED)
    check(read_system(folder / "x.ssd"))  # whole, it can be used
    return folder


@given(text=both(NESTED))
@brief
def test_system_structures(text: str, folder: Path) -> None:
    (folder / "x.ssd").write_bytes(encoded(text))
    read_or_refuse(lambda: check(read_system(folder / "x.ssd")))


@given(values=both(SET), mapping=both(MAP))
@brief
def test_parameter_sets_and_mappings(values: str, mapping: str, folder: Path) -> None:
    (folder / "x.ssv").write_bytes(encoded(values))
    (folder / "x.ssm").write_bytes(encoded(mapping))
    read_or_refuse(lambda: read_parameters(folder / "x.ssv"))
    read_or_refuse(lambda: read_mapping(folder / "x.ssm"))


@given(text=damaged(shipped_cases()["lc4"].read_text(encoding="utf-8")))
@brief
def test_load_cases(text: str, tmp_path: Path) -> None:
    for name in ("dampers.toml", "channels.toml"):
        (tmp_path / name).write_bytes(shipped_cases()["lc4"].with_name(name).read_bytes())
    (tmp_path / "case.toml").write_bytes(encoded(text))
    read_or_refuse(lambda: read_case(str(tmp_path / "case.toml")))


@given(patches=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8))
@brief
def test_packages(patches: list[tuple[float, int]], folder: Path, tmp_path: Path) -> None:
    """Bytes of the archive itself: its directory, names, sizes, and the packed data."""
    path = tmp_path / "x.ssp"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as package:
        package.writestr("SystemStructure.ssd", NESTED)
        package.writestr("extra/set.ssv", SET)
        package.writestr("extra/map.ssm", MAP)
        for name in ("mass", "carried"):
            package.writestr(f"resources/{name}.fmu", b"not read here")
    data = bytearray(path.read_bytes())
    for at, value in patches:
        data[int(at * len(data))] = value
    path.write_bytes(data)
    out = tmp_path / str(next(counter))
    read_or_refuse(lambda: read_package(path, out))
    read_or_refuse(lambda: extract(path, out))
    assert {p.name for p in tmp_path.iterdir()} <= {"x.ssp"} | {str(n) for n in range(next(counter))}
