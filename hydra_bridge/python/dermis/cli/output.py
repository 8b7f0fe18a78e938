"""Files that are there whole or not at all: written under a temporary name, then renamed."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class OutputError(Exception):
    """A file or folder that cannot be written; the text names it."""


def prepare_folder(file: str | Path) -> None:
    """Makes the folder of `file` if it is missing, as usdrecord does, and checks that it can be written.

    Called before the render: hours of work are not to end at a mistyped path. Raises OutputError.
    """
    folder = Path(file).absolute().parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _made(folder, "dermis", ".tmp").unlink()
    except OSError as error:
        raise OutputError(f"Cannot write to folder {folder}: {error.strerror or error}") from error
    if Path(file).is_dir():
        raise OutputError(f"Cannot write {file}: it is a folder")


@contextmanager
def replacing(file: str | Path) -> Iterator[Path]:
    """A temporary name beside `file`, with its ending; renamed to `file` at the end, removed on failure."""
    file = Path(file)
    temporary = _made(file.absolute().parent, file.stem, file.suffix)
    try:
        yield temporary
        os.replace(temporary, file)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_json(file: str | Path, value: Any) -> None:
    """Writes `value` as JSON; numbers that are not finite, which JSON lacks, become null."""
    with replacing(file) as temporary:
        temporary.write_text(json.dumps(_finite(value), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value


def _made(folder: Path, stem: str, suffix: str) -> Path:
    """An empty file of a new name. (`tempfile` takes longer to load than the image of a small stage to write.)"""
    file = folder / f".{stem}.{os.urandom(8).hex()}{suffix}"
    os.close(os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return file
