"""The platforms that FMUs are built for, and what FMI calls them."""

from __future__ import annotations

import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Platform:
    """A platform to compile for.

    Attributes:
        name: ours, "linux-x86_64".
        fmi2, fmi3: folder of its binaries in an FMU. FMI 2.0 has no name for 64-bit ARM on Linux: FMI 3.0's stands in.
        suffix: of its libraries.
        compiler_target: zig's name, with the oldest system that it is to run on.
    """

    name: str
    fmi2: str
    fmi3: str
    suffix: str
    compiler_target: str


PLATFORMS = {
    p.name: p
    for p in (
        Platform("linux-x86_64", "linux64", "x86_64-linux", ".so", "x86_64-linux-gnu.2.17"),
        Platform("linux-aarch64", "aarch64-linux", "aarch64-linux", ".so", "aarch64-linux-gnu.2.17"),
        Platform("windows-x86_64", "win64", "x86_64-windows", ".dll", "x86_64-windows-gnu"),
        Platform("macos-x86_64", "darwin64", "x86_64-darwin", ".dylib", "x86_64-macos.11.0"),
        Platform("macos-aarch64", "darwin64", "aarch64-darwin", ".dylib", "aarch64-macos.11.0"),
    )
}


def native_platform() -> Platform:
    """The platform this runs on.

    Raises:
        RuntimeError: FMUs cannot be built for it.
    """
    system = {"linux": "linux", "darwin": "macos", "win32": "windows"}.get(sys.platform, sys.platform)
    machine = platform.machine().lower()
    name = f"{system}-{ {'amd64': 'x86_64', 'arm64': 'aarch64'}.get(machine, machine) }"
    if name not in PLATFORMS:
        raise RuntimeError(f"no FMU platform for {sys.platform} on {machine}")
    return PLATFORMS[name]


def platforms_named(names: Sequence[str]) -> tuple[Platform, ...]:
    """Platforms by name, in the order of `PLATFORMS`; "all" and "native" are names too, and none means native.

    Raises:
        ValueError: no such platform.
    """
    chosen: set[str] = set()
    for name in names or ("native",):
        if name not in (*PLATFORMS, "all", "native"):
            raise ValueError(f"no platform '{name}': there are {', '.join(PLATFORMS)}, native and all")
        chosen |= set(PLATFORMS) if name == "all" else {native_platform().name if name == "native" else name}
    return tuple(p for name, p in PLATFORMS.items() if name in chosen)
