"""Files of the user: TOML read strictly, results written whole or not at all."""

import difflib
import os
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omnislip.errors import InputError

MOST_NAMES = 30
"""That a message lists."""


def load_toml(path: Path) -> dict[str, Any]:
    """Return the parsed file. InputError names the file and, for bad syntax, the line."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))  # some editors mark UTF-8
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8") from None
    except ValueError as error:  # of TOML, or of Python for a number of thousands of digits
        what = str(error).replace("Cannot overwrite a value", "a key is given twice")
        raise InputError(f"{path}: not valid TOML: {what}") from None


def nearest(name: str, known: Iterable[str]) -> str:
    """Return '; did you mean ...?' for the known name most like `name`, else what is known.

    Of more names than `MOST_NAMES` the three most alike.
    """
    names = sorted(known)
    matches = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    if not matches and len(names) > MOST_NAMES:
        matches = difflib.get_close_matches(name, names, n=3, cutoff=0.0)
    if matches:
        listed = "', '".join(matches)
        return f"; did you mean '{listed}'?"
    return f"; known: {', '.join(names)}" if names else ""


def check_known(given: Iterable[str], known: Iterable[str], what: str, path: Path) -> None:
    """Raise InputError for the first of `given` that is not `known`. `what` is 'key', ..."""
    known = set(known)
    for name in given:
        if name not in known:
            raise InputError(f"{path}: unknown {what} '{name}'{nearest(name, known)}")


def check_table(value: object, where: str, path: Path) -> dict[str, Any]:
    """Return `value` if it is a TOML table, else raise InputError."""
    if not isinstance(value, dict):
        raise InputError(f"{path}: '{where}' must be a table, written [{where}]")
    return value


def check_number(value: object, where: str, path: Path) -> float:
    """Return `value` as float if it is a finite number, else raise InputError."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{path}: '{where}' must be a number, not {value!r}")
    if not abs(value) <= sys.float_info.max:
        raise InputError(f"{path}: '{where}' must be finite, not {value!r:.40}")
    return float(value)


def check_numbers(value: object, count: int, where: str, path: Path) -> list[float]:
    """Return `value` as a list of `count` floats, else raise InputError."""
    if not isinstance(value, list) or len(value) != count:
        raise InputError(f"{path}: '{where}' must be a list of {count} numbers, not {value!r}")
    return [check_number(item, f"{where}[{index}]", path) for index, item in enumerate(value)]


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path` to write to; on success it becomes `path`.

    A reader never sees a half-written file, and an error leaves what was there before.
    InputError if the folder cannot be made or written.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(suffix=path.suffix, prefix=".tmp-", dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` whole or not at all."""
    with replace_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
