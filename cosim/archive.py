"""Archives from anywhere (FMU, SSP): looked through before a byte of them is used, unpacked to one folder only.

An archive is refused if a name leads out of the folder or means something else on another system, if an entry is a
link or encrypted, or if it unpacks to more than `Limits`. XML is read without document types, so without entities.
"""

from __future__ import annotations

import errno
import hashlib
import lzma
import re
import stat
import unicodedata
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from xml.parsers import expat

from lxml import etree

from cosim.errors import CosimError

CHUNK = 1 << 20
XML_BYTES = 100_000_000
NAME_BYTES, NAME_SUFFIX = 150, 20  # of a file's name that we choose: bytes before the suffix, letters of that
# Windows opens devices by these names in every folder, whatever follows a dot
DEVICES = {"CON", "PRN", "AUX", "NUL", "CONIN$", "CONOUT$", "CLOCK$"} | {
    f"{port}{n}" for port in ("COM", "LPT") for n in "0123456789¹²³"
}


@dataclass(frozen=True)
class Limits:
    """What an archive may unpack to.

    Attributes:
        size: bytes in all. entries: files and folders.
        ratio: unpacked over packed bytes; `free` bytes are not looked at for that (small texts pack well).
    """

    size: int = 4 << 30
    entries: int = 20_000
    ratio: float = 200.0
    free: int = 64 << 20


LIMITS = Limits()
# what zipfile raises for entries that are encrypted, compressed in an unknown way, cut off or corrupt
_BROKEN = (zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, lzma.LZMAError, RuntimeError, EOFError)


class BadArchive(CosimError):
    """An archive that cannot be read or must not be unpacked; one line with the entry and the reason."""


@contextmanager
def open_archive(path: Path, limits: Limits = LIMITS) -> Iterator[zipfile.ZipFile]:
    """An archive whose names and sizes have been looked through.

    Raises:
        BadArchive: it cannot be read, or must not be unpacked.
    """
    try:
        archive = zipfile.ZipFile(path)
    except (OSError, ValueError, *_BROKEN) as error:
        raise BadArchive(f"{path}: cannot be read ({_line(error)})") from error
    with archive:
        try:
            _check(archive.infolist(), limits)
            yield archive
        except BadArchive as error:
            raise BadArchive(f"{path}: {error}") from error
        except OSError as error:
            if error.errno not in (None, errno.EINVAL):  # those stand for broken bzip2 data, and for a bad offset
                raise
            raise BadArchive(f"{path}: cannot be read ({_line(error)})") from error
        except _BROKEN as error:
            raise BadArchive(f"{path}: cannot be read ({_line(error)})") from error


def extract(path: Path, folder: Path, limits: Limits = LIMITS) -> Path:
    """Unpack an archive into a folder, which is created; returns the folder.

    Raises:
        BadArchive: it cannot be read, or must not be unpacked; nothing outside the folder has been touched.
    """
    root = folder.resolve()
    root.mkdir(parents=True, exist_ok=True)
    with open_archive(path, limits) as archive:
        for entry in archive.infolist():
            target = root / entry.filename
            if not target.resolve().is_relative_to(root):  # a link that was in the folder before
                raise BadArchive(f"entry '{_shown(entry.filename)}' leads out of the folder")
            if entry.is_dir():
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            left = entry.file_size
            with archive.open(entry) as source, target.open("wb") as copy:
                while part := source.read(CHUNK):
                    left -= len(part)
                    if left < 0:
                        raise BadArchive(f"entry '{_shown(entry.filename)}' is longer than it says")
                    copy.write(part)
    return folder


def read_entry(path: Path, name: str, limit: int = XML_BYTES) -> bytes:
    """Content of one entry.

    Raises:
        BadArchive: no such entry, it is larger than `limit` bytes, or the archive must not be unpacked.
    """
    with open_archive(path) as archive:
        try:
            entry = archive.getinfo(name)
        except KeyError:
            raise BadArchive(f"has no {name}") from None
        if entry.file_size > limit:
            raise BadArchive(f"{name} is {entry.file_size} bytes long, more than {limit}")
        return archive.read(entry)


def entry_names(path: Path) -> tuple[str, ...]:
    """Names of the files in an archive.

    Raises:
        BadArchive: it cannot be read, or must not be unpacked.
    """
    with open_archive(path) as archive:
        return tuple(entry.filename for entry in archive.infolist() if not entry.is_dir())


def parse_xml(content: bytes, where: str) -> Any:
    """Root element of an XML text; one that declares a document type is refused before any entity is looked at.

    Raises:
        CosimError: it is no XML, or declares a document type.
    """

    def refuse(*declaration: object) -> None:
        raise CosimError(f"{where}: declares a document type; remove it (entities are not read)")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    safe = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, remove_comments=True)
    try:
        parser.Parse(content, True)
        return etree.fromstring(content, safe)
    except (expat.ExpatError, etree.XMLSyntaxError, ValueError, LookupError) as error:
        if isinstance(error, CosimError):
            raise
        raise CosimError(f"{where}: cannot be read ({_line(error)})") from error


def safe_name(name: str) -> str:
    """A file name like the one given that every system can unpack; no folder in it."""
    whole = PurePosixPath(re.sub(r"[^\w.\-+]", "_", name).strip("."))
    suffix = whole.suffix[:NAME_SUFFIX]
    plain = (whole.stem.encode()[:NAME_BYTES].decode(errors="ignore") + suffix).rstrip(".") or "file"
    return f"_{plain}" if _bad_name(plain) else plain


def folded(path: str) -> str:
    """A path as a system without upper and lower case sees it: what folds alike is one file there."""
    return unicodedata.normalize("NFC", path.casefold())


def sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check(entries: list[zipfile.ZipInfo], limits: Limits) -> None:
    if len(entries) > limits.entries:
        raise BadArchive(f"has {len(entries)} entries, more than {limits.entries}")
    unpacked, packed = sum(e.file_size for e in entries), sum(e.compress_size for e in entries)
    if unpacked > limits.size:
        raise BadArchive(f"unpacks to {unpacked / 1e9:.1f} GB, more than {limits.size / 1e9:.1f} GB")
    if unpacked > limits.free and unpacked > limits.ratio * max(packed, 1):
        raise BadArchive(f"unpacks to {unpacked / max(packed, 1):.0f} times its size, more than {limits.ratio:g} times")
    seen: dict[str, tuple[str, bool]] = {}  # as a system without upper and lower case sees it: name, whether a file
    for entry in entries:
        name = entry.filename  # what is unpacked; zipfile may have made it of the one in the list
        if reason := _bad_name(name) or _bad_name(entry.orig_filename) or _bad_kind(entry):
            other = "" if name == entry.orig_filename else f", unpacked as '{_shown(name)}',"
            raise BadArchive(f"entry '{_shown(entry.orig_filename)}'{other} {reason}")
        parts = name.rstrip("/").split("/")
        for depth in range(1, len(parts) + 1):
            path, file = "/".join(parts[:depth]), depth == len(parts) and not name.endswith("/")
            known, is_file = seen.get(folded(path), (path, False))
            if known != path or is_file or (file and folded(path) in seen):
                raise BadArchive(f"entries '{_shown(known)}' and '{_shown(path)}' are one file on some systems")
            seen[folded(path)] = path, file


def _bad_name(name: str) -> str:
    """Why a name cannot be unpacked everywhere, or ""."""
    parts = name.removesuffix("/").split("/")
    if not name or name.startswith("/") or ":" in name:
        return "is no path within the archive"
    if "\\" in name:
        return "has a backslash; FMI and SSP want '/'"
    if any(unicodedata.category(c) in ("Cc", "Cs") for c in name):
        return "has a control character"
    if ".." in parts:
        return "leads out of the folder"
    for part in parts:
        if part != part.rstrip(". ") or not part:
            return "has a part that is empty or ends with a dot or blank"
        if part.split(".")[0].rstrip().upper() in DEVICES:
            return "is the name of a device on Windows"
        if len(part.encode()) > 255 or len(name) > 1000:
            return "has too long a name"
    return ""


def _bad_kind(entry: zipfile.ZipInfo) -> str:
    mode = entry.external_attr >> 16
    if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "is a link" if stat.S_ISLNK(mode) else "is no file"
    return "is encrypted; pack it without password" if entry.flag_bits & 0x1 else ""


def _shown(name: str) -> str:
    """A name as it can be printed: nothing of it moves the cursor."""
    return ascii(name)[1:-1][:120]


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
