"""Files that an FMU brings itself: copies of FMUs with files put into their resources/.

Only of FMUs that say where they look for files, by an entry `NOTE` in their archive: they find a relative path in their
resources/ first, wherever the importer was started, and take a guid that is lengthened by '+' and more.
"""

from __future__ import annotations

import hashlib
import io
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path

from cosim.archive import entry_names, open_archive
from cosim.errors import CosimError

NOTE = "extra/org.fowt-cosim.resources/README.txt"
FOLDER = "resources/"
_DESCRIPTION = "modelDescription.xml"
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same files give the same bytes
_GUID = re.compile(rb'(<fmiModelDescription\b[^>]*?\s(?:guid|instantiationToken)="[^"]*)"')


def finds_resources(fmu: Path) -> bool:
    """Whether an FMU looks for files among its own resources.

    Raises:
        BadArchive: it cannot be read.
    """
    return NOTE in entry_names(fmu)


def with_resources(fmu: Path, files: Mapping[str, Path]) -> bytes:
    """The archive of an FMU with files added to its resources/, by name.

    Its guid is lengthened by a digest of the files, since some importers unpack only one FMU of a guid.

    Raises:
        CosimError: a file cannot be read, or the FMU is not such a one.
    """
    digest, added = hashlib.sha256(), {}
    for name, path in sorted(files.items()):
        try:
            added[FOLDER + name] = path.read_bytes()
        except OSError as error:
            raise CosimError(f"{path}: cannot be read ({error.strerror or error})") from error
        digest.update(f"{name}\0{len(added[FOLDER + name])}\0".encode() + added[FOLDER + name])
    with open_archive(fmu) as archive:
        content = {e.filename: archive.read(e) for e in archive.infolist() if not e.is_dir()}
    mark = f"+{digest.hexdigest()[:16]}".encode()
    text, found = _GUID.subn(rb"\g<1>" + mark + b'"', content[_DESCRIPTION], count=1)
    if NOTE not in content or not found:
        raise CosimError(f"{fmu}: does not look for files in its resources; name them by their full paths")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as copy:
        for name, data in sorted((content | added | {_DESCRIPTION: text}).items()):
            info = zipfile.ZipInfo(name, _EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            copy.writestr(info, data)
    return packed.getvalue()
