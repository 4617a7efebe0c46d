"""Archives from elsewhere: nothing of one that could do harm is unpacked, and the reason is one line."""

from __future__ import annotations

import stat
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from cosim.archive import BadArchive, Limits, extract, open_archive, parse_xml, read_entry, safe_name
from cosim.errors import CosimError


def pack(path: Path, *names: str, content: bytes = b"x", **attributes: int) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            entry = zipfile.ZipInfo("placeholder")
            entry.filename = name  # as it is: ZipInfo would cut at a zero byte
            entry.compress_type = zipfile.ZIP_DEFLATED
            for attribute, value in attributes.items():
                setattr(entry, attribute, value)
            archive.writestr(entry, content)
    return path


BAD_NAMES = [
    ("../escape", "leads out of the folder"),
    ("a/../../escape", "leads out of the folder"),
    ("/etc/escape", "is no path within the archive"),
    ("C:/escape", "is no path within the archive"),
    ("file:stream", "is no path within the archive"),
    ("a\\..\\escape", "has a backslash"),
    ("a//b", "is empty or ends with a dot or blank"),
    ("a/./b", "is empty or ends with a dot or blank"),
    ("binaries /x", "is empty or ends with a dot or blank"),
    ("x.", "is empty or ends with a dot or blank"),
    ("CON", "device on Windows"),
    ("resources/nul.txt", "device on Windows"),
    ("com1.tar.gz", "device on Windows"),
    ("a\x1b[2Jb", "control character"),
    ("n" * 300, "too long a name"),
]


@pytest.mark.parametrize(("name", "words"), BAD_NAMES)
def test_names_that_lead_elsewhere_are_refused(tmp_path: Path, name: str, words: str) -> None:
    path = pack(tmp_path / "bad.fmu", "modelDescription.xml", name)
    with pytest.raises(BadArchive, match=words) as refused:
        extract(path, tmp_path / "out")
    assert str(path) in str(refused.value)
    assert str(refused.value).isprintable()
    assert [p.name for p in tmp_path.rglob("*") if p.is_file()] == ["bad.fmu"]


@pytest.mark.parametrize(
    "names",
    [("a/File", "a/file"), ("Lib/x", "lib/y"), ("a", "a/b"), ("a/b", "a"), ("same", "same"), ("\u00e9", "e\u0301")],
)
def test_names_that_are_one_file_elsewhere_are_refused(tmp_path: Path, names: tuple[str, ...]) -> None:
    """By case, by Unicode form, a file that is also a folder, or the same name twice."""
    with pytest.warns(UserWarning, match="Duplicate name") if names == ("same", "same") else _nothing():
        path = pack(tmp_path / "bad.fmu", *names)
    with pytest.raises(BadArchive, match="are one file on some systems"):
        extract(path, tmp_path / "out")


class _nothing:
    def __enter__(self) -> None: ...

    def __exit__(self, *details: object) -> None: ...


@pytest.mark.parametrize(("kind", "words"), [(stat.S_IFLNK, "is a link"), (stat.S_IFCHR, "is no file")])
def test_links_and_devices_are_refused(tmp_path: Path, kind: int, words: str) -> None:
    path = pack(tmp_path / "bad.fmu", "x", content=b"/etc/passwd", external_attr=(kind | 0o777) << 16)
    with pytest.raises(BadArchive, match=words):
        extract(path, tmp_path / "out")


def test_a_link_in_the_folder_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/sub").symlink_to(tmp_path)
    path = pack(tmp_path / "x.fmu", "sub/escape")
    with pytest.raises(BadArchive, match="leads out of the folder"):
        extract(path, tmp_path / "out")
    assert not (tmp_path / "escape").exists()


def test_the_name_that_is_unpacked_is_the_one_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Later versions of zipfile take a name from an extra field; Windows has another separator."""
    usual = zipfile.ZipFile.infolist

    def renamed(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
        entries = usual(archive)
        entries[0].filename = "../escape"
        return entries

    path = pack(tmp_path / "x.fmu", "harmless")
    with monkeypatch.context() as patched:
        patched.setattr(zipfile.ZipFile, "infolist", renamed)
        with pytest.raises(BadArchive, match=r"entry 'harmless', unpacked as '\.\./escape', leads out of the folder"):
            extract(path, tmp_path / "out")
    assert not (tmp_path / "escape").exists()
    unicode_path = b"\x01" + struct.pack("<L", zlib.crc32(b"harmless")) + b"../escape"
    extra = struct.pack("<HH", 0x7075, len(unicode_path)) + unicode_path
    field = pack(tmp_path / "field.fmu", "harmless", extra=extra)
    if sys.version_info >= (3, 12):
        with pytest.raises(BadArchive, match=r"leads out of the folder|cannot be read"):
            extract(field, tmp_path / "out")
    else:
        extract(field, tmp_path / "out")
    assert not (tmp_path / "escape").exists()


def test_a_name_with_a_zero_byte_is_refused(tmp_path: Path) -> None:
    """zipfile cuts it there: the archive's list shows another name than what is unpacked."""
    path = pack(tmp_path / "x.fmu", "modelDescription.xml\x00.png")
    with pytest.raises(BadArchive, match="has a control character"):
        extract(path, tmp_path / "out")
    with pytest.raises(BadArchive, match="has a control character"):
        read_entry(path, "modelDescription.xml")


NAMES = (
    "aux",
    "CON.ssv",
    "a/b",
    "..",
    "",
    " ",
    "x" * 400,
    "\u00e4" * 300 + ".bts",
    "a" * 148 + ".." + "b" * 40,
    ".x",
    "\x00",
)


@pytest.mark.parametrize("name", NAMES)
def test_safe_names_can_be_unpacked(tmp_path: Path, name: str) -> None:
    safe = safe_name(name)
    assert "/" not in safe
    assert safe_name(safe) == safe
    extract(pack(tmp_path / "x.ssp", f"resources/{safe}"), tmp_path / "out")
    assert (tmp_path / "out/resources" / safe).is_file()


def test_bombs_are_refused_before_they_are_unpacked(tmp_path: Path) -> None:
    zeros = pack(tmp_path / "zeros.fmu", "a", content=bytes(10_000_000))  # packs 1000 to 1
    with pytest.raises(BadArchive, match=r"unpacks to \d+ times its size, more than 200 times"):
        extract(zeros, tmp_path / "out", Limits(free=1_000_000))
    with pytest.raises(BadArchive, match=r"unpacks to 0.0 GB, more than"):
        extract(zeros, tmp_path / "out", Limits(size=9_999_999))
    with pytest.raises(BadArchive, match="has 3 entries, more than 2"):
        extract(pack(tmp_path / "many.fmu", "a", "b", "c"), tmp_path / "out", Limits(entries=2))
    with pytest.raises(BadArchive, match=r"a is 10000000 bytes long, more than 100"):
        read_entry(zeros, "a", limit=100)


def _lie_about_size(data: bytearray) -> None:
    for signature, offset in ((b"PK\x01\x02", 24), (b"PK\x03\x04", 22)):
        data[(at := data.index(signature) + offset) : at + 4] = struct.pack("<I", 10)


def _encrypted(data: bytearray) -> None:
    for signature, offset in ((b"PK\x01\x02", 8), (b"PK\x03\x04", 6)):
        data[data.index(signature) + offset] |= 1


def _unknown_method(data: bytearray) -> None:
    for signature, offset in ((b"PK\x01\x02", 10), (b"PK\x03\x04", 8)):
        data[data.index(signature) + offset] = 77


def _corrupt(data: bytearray) -> None:
    at = data.index(b"PK\x01\x02")
    data[at - 20] ^= 0xFF


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (_lie_about_size, "Bad CRC-32|longer than it says|cannot be read"),
        (_encrypted, "is encrypted; pack it without password"),
        (_unknown_method, "cannot be read"),
        (_corrupt, "cannot be read"),
        (lambda data: data.clear(), "cannot be read"),
        (lambda data: data.__delitem__(slice(len(data) // 2, None)), "cannot be read"),
    ],
)
def test_damaged_archives_get_one_line(tmp_path: Path, harm: Callable[[bytearray], None], words: str) -> None:
    path = pack(tmp_path / "x.fmu", "a", content=b"some text that packs, packs, packs" * 20)
    data = bytearray(path.read_bytes())
    harm(data)
    path.write_bytes(data)
    with pytest.raises(BadArchive, match=words) as refused:
        extract(path, tmp_path / "out")
    assert "\n" not in str(refused.value)


def test_a_good_archive_is_unpacked_whole(tmp_path: Path) -> None:
    path = pack(tmp_path / "x.fmu", "a/b.txt", "a/c/", "d", content=b"")
    extract(path, tmp_path / "out")
    assert {str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*")} == {"a", "a/b.txt", "a/c", "d"}
    with open_archive(path) as archive:
        assert len(archive.namelist()) == 3


BOMB = "<!DOCTYPE x [" + "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12)) + "]>"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f'<?xml version="1.0"?>{BOMB}<x a="&e11;">&e11;</x>', "declares a document type"),
        ('<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/hostname">]><x>&e;</x>', "declares a document type"),
        ('<!DOCTYPE x SYSTEM "http://localhost:1/x.dtd"><x/>', "declares a document type"),
        ("<x>" * 100_000, "cannot be read"),
        ("<x", "cannot be read"),
        ('<?xml version="1.0" encoding="nonsense"?><x/>', "cannot be read"),
        ("", "cannot be read"),
    ],
)
def test_xml_with_entities_is_refused_at_once(text: str, words: str) -> None:
    with pytest.raises(CosimError, match=words) as refused:
        parse_xml(text.encode(), "x.xml")
    assert "\n" not in str(refused.value)
    with pytest.raises(CosimError):
        parse_xml(text.encode("utf-16"), "x.xml")  # a text search would not see it there
