"""Checkpoint of a search: one compressed NumPy file without pickles, replaced as a whole after each generation."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from optimisation.search import Record

CHECKPOINT = "checkpoint.npz"


def write_checkpoint(path: Path, problem: Mapping[str, Any], record: Record) -> None:
    """Write a checkpoint; whenever the process ends, the file is the former one or this one."""
    about = {
        "problem": problem,
        "random_state": record.random_state,
        "library": record.library,
        "seconds": record.seconds,
        "first_failure": record.first_failure,
    }
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        np.savez(
            file,
            about=np.array(json.dumps(about)),
            sizes=np.array([len(x) for x in record.candidates]),
            candidates=np.concatenate(record.candidates) if record.candidates else np.empty((0, 0)),
            values=np.concatenate(record.values) if record.values else np.empty((0, 0)),
        )
        file.flush()
        os.fsync(file.fileno())
    os.replace(partial, path)


def write_atomically(path: Path, text: str) -> Path:
    """Write a text file as a whole or not at all."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)
    return path


def read_checkpoint(path: Path) -> tuple[dict[str, Any], Record]:
    """The problem that a checkpoint belongs to, and its record.

    Raises:
        ValueError: no such file, or it is no checkpoint.
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            about = json.loads(str(content["about"]))
            sizes = content["sizes"]
            ends = np.cumsum(sizes)[:-1]
            candidates, values = content["candidates"], content["values"]
        record = Record(
            tuple(np.split(candidates, ends)) if len(sizes) else (),
            tuple(np.split(values, ends)) if len(sizes) else (),
            about["random_state"],
            about["library"],
            about["seconds"],
            about["first_failure"],
        )
        return dict(about["problem"]), record
    except FileNotFoundError as error:
        raise ValueError(f"nothing to resume: {path} does not exist") from error
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is no checkpoint of an optimisation: {error}") from error


def resumed_record(path: Path, problem: Mapping[str, Any]) -> Record:
    """The record of a checkpoint of the same problem.

    Raises:
        ValueError: as `read_checkpoint`, or the problem is another one; names what differs.
    """
    saved, record = read_checkpoint(path)
    refuse_another(path, saved, problem)
    return record


def refuse_another(path: Path, saved: Mapping[str, Any], problem: Mapping[str, Any]) -> None:
    """Compare a checkpoint's problem with another.

    Raises:
        ValueError: they differ; names what.
    """
    saved, wanted = (json.loads(json.dumps(p, default=asdict)) for p in (saved, problem))
    differing = [name for name in {**saved, **wanted} if saved.get(name) != wanted.get(name)]
    if differing:
        words = "; ".join(_difference(name, saved.get(name), wanted.get(name)) for name in differing)
        raise ValueError(f"{path} is a checkpoint of another problem: {words}")


def _difference(name: str, saved: Any, wanted: Any) -> str:
    if isinstance(saved, dict) and isinstance(wanted, dict):
        inner = [key for key in {**saved, **wanted} if saved.get(key) != wanted.get(key)]
        return ", ".join(_difference(f"{name} {key}", saved.get(key), wanted.get(key)) for key in inner)
    if name == "fmu" or name.startswith("models"):
        return "the FMU has another content" if name == "fmu" else f"the model of{name[len('models') :]} is another"
    return f"{name} {_words(wanted)}, there {_words(saved)}"


def _words(value: Any) -> str:
    if isinstance(value, list):
        return ":".join(f"{v:g}" if isinstance(v, float) else str(v) for v in value)
    return "by default" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def fmu_digest(fmu: Path) -> str:
    """SHA-256 over the names and contents of an FMU's files: the same however and whenever it was packed."""
    digest = hashlib.sha256()
    with zipfile.ZipFile(fmu) as archive:
        for name in sorted(archive.namelist()):
            digest.update(name.encode() + b"\0" + hashlib.sha256(archive.read(name)).digest())
    return digest.hexdigest()
