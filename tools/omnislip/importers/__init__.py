"""Public measured data sets, turned into logs and model files."""

import os
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[3]


def data_folder() -> Path:
    """Return where tools/fetch-data puts the data sets: $OMNISLIP_DATA or ../shared/data."""
    return Path(os.environ.get("OMNISLIP_DATA") or REPOSITORY.parent / "shared" / "data")
