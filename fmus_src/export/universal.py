"""Universal (fat) Mach-O files: libraries for several processors of macOS in one file."""

from __future__ import annotations

import struct
from collections.abc import Sequence

_FAT_MAGIC, _MACHO_64 = 0xCAFEBABE, 0xFEEDFACF
_ALIGNMENT = 14  # slices start at multiples of 2^14 bytes, the page of Apple's processors


def universal(libraries: Sequence[bytes]) -> bytes:
    """One file with these 64-bit Mach-O libraries (mach-o/fat.h: a big-endian header, then the files, aligned).

    Raises:
        ValueError: one is no 64-bit Mach-O file.
    """
    step = 1 << _ALIGNMENT
    entries, body, offset = [], b"", step
    for library in libraries:
        magic, processor, subtype = struct.unpack_from("<III", library)
        if magic != _MACHO_64:
            raise ValueError("universal: not a 64-bit Mach-O library")
        entries.append(struct.pack(">IIIII", processor, subtype, offset, len(library), _ALIGNMENT))
        padded = library + bytes(-len(library) % step)
        body += padded
        offset += len(padded)
    header = struct.pack(">II", _FAT_MAGIC, len(entries)) + b"".join(entries)
    return header + bytes(step - len(header)) + body
