"""What a library file exports and needs, read from the file: ELF, PE and Mach-O, 64 bits, little-endian."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Library:
    """Processor, exported names (as C knows them), needed libraries; `signed`: a Mach-O file with a signature."""

    processor: str
    exports: set[str]
    needs: set[str]
    signed: bool = False


def read_library(path: Path) -> list[Library]:
    """The libraries in a file: one, or one for each processor of a universal file."""
    data = path.read_bytes()
    if data[:4] == b"\x7fELF":
        return [_elf(data)]
    if data[:2] == b"MZ":
        return [_pe(data)]
    if data[:4] == b"\xca\xfe\xba\xbe":
        count = struct.unpack_from(">I", data, 4)[0]
        places = [struct.unpack_from(">IIIII", data, 8 + 20 * i) for i in range(count)]
        assert all(offset % (1 << align) == 0 for _, _, offset, _, align in places)
        return [_macho(data[offset : offset + size]) for _, _, offset, size, _ in places]
    return [_macho(data)]


def _text(data: bytes, at: int) -> str:
    return data[at : data.index(b"\0", at)].decode()


def _elf(data: bytes) -> Library:
    machine = struct.unpack_from("<H", data, 18)[0]
    first, size, count = (*struct.unpack_from("<Q", data, 40), *struct.unpack_from("<HH", data, 58))
    # name, type, flags, address, offset, size, link, info, alignment, entry size
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, first + i * size) for i in range(count)]
    exports, needs = set(), set()
    for section in sections:
        strings = sections[section[6]][4] if section[6] < count else 0
        if section[1] == 11:  # dynamic symbols
            for at in range(section[4], section[4] + section[5], 24):
                name, info, _, index = struct.unpack_from("<IBBH", data, at)
                if index and info >> 4 in (1, 2):  # defined, global or weak
                    exports.add(_text(data, strings + name))
        if section[1] == 6:  # dynamic
            for at in range(section[4], section[4] + section[5], 16):
                tag, value = struct.unpack_from("<QQ", data, at)
                if tag == 1:
                    needs.add(_text(data, strings + value))
    return Library({62: "x86_64", 183: "aarch64"}[machine], exports, needs)


def _pe(data: bytes) -> Library:
    header = struct.unpack_from("<I", data, 60)[0]
    machine, n_sections = struct.unpack_from("<HH", data, header + 4)
    optional = header + 24
    table = optional + struct.unpack_from("<H", data, header + 20)[0]
    sections = [struct.unpack_from("<IIII", data, table + 40 * i + 8) for i in range(n_sections)]

    def place(address: int) -> int:
        for size, start, raw, offset in sections:
            if start <= address < start + max(size, raw):
                return address - start + offset
        raise ValueError(f"no section has {address}")

    export_at, import_at = (struct.unpack_from("<I", data, optional + 112 + 8 * i)[0] for i in (0, 1))
    count = struct.unpack_from("<I", data, place(export_at) + 24)[0]
    names = place(struct.unpack_from("<I", data, place(export_at) + 32)[0])
    exports = {_text(data, place(struct.unpack_from("<I", data, names + 4 * i)[0])) for i in range(count)}
    needs, at = set(), place(import_at)
    while address := struct.unpack_from("<I", data, at + 12)[0]:
        needs.add(_text(data, place(address)))
        at += 20
    return Library({0x8664: "x86_64", 0xAA64: "aarch64"}[machine], exports, needs)


def _macho(data: bytes) -> Library:
    magic, processor, _, kind, count = struct.unpack_from("<IIIII", data)
    assert magic == 0xFEEDFACF
    assert kind == 6  # a dynamic library
    exports, needs, signed, at = set(), set(), False, 32
    for _ in range(count):
        command, size = struct.unpack_from("<II", data, at)
        if command == 2:  # symbol table
            symbols, n, strings = struct.unpack_from("<III", data, at + 8)
            for i in range(n):
                name, form = struct.unpack_from("<IB", data, symbols + 16 * i)
                if form & 0x01 and form & 0x0E and not form & 0x10:  # external, defined, not private
                    exports.add(_text(data, strings + name).removeprefix("_"))
        elif command == 12:  # load library
            needs.add(_text(data, at + struct.unpack_from("<I", data, at + 8)[0]))
        elif command == 29:
            signed = True
        at += size
    return Library({0x01000007: "x86_64", 0x0100000C: "aarch64"}[processor], exports, needs, signed)
