# SPDX-License-Identifier: GPL-3.0-or-later
"""Records of measurements in one file, written after each, so that an interrupted benchmark goes on where it was."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from irgspp.core.errors import InputError
from irgspp.core.run_folder import write_atomic

Key = tuple[str, str, str]
EVERYWHERE = "-"  # in the place of a scene's name where no scene has a say


@dataclass(frozen=True)
class Record:
    """One measurement.

    Attributes:
        status: "done" or "failed"; error: why it failed, one line.
        figures, counted: see `section.Measurement`. images: name to a file's path in the store's folder.
        seconds: of the whole measurement, wall clock, reconstructions that had to be made for it included.
        environment: which of the store's environments (machine and versions) it was made in.
    """

    section: str
    scene: str
    configuration: str
    status: str = "done"
    error: str = ""
    figures: dict[str, Any] = field(default_factory=dict)
    counted: dict[str, int] = field(default_factory=dict)
    images: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    environment: str = ""

    @property
    def key(self) -> Key:
        """Section, scene and configuration."""
        return (self.section, self.scene, self.configuration)


class Store:
    """`results.json` of a folder.

    Args:
        folder: made where there is none. environment: machine and versions of this process. fresh: forget what is there.

    Raises InputError where the file is there and is no benchmark's.
    """

    def __init__(self, folder: Path, environment: dict[str, Any] | None = None, fresh: bool = False) -> None:
        self.folder, self.path = folder, folder / "results.json"
        self.records: dict[Key, Record] = {}
        self.environments: dict[str, dict[str, Any]] = {}
        self.scenes: dict[str, dict[str, Any]] = {}  # what is known of each, for tables
        if self.path.is_file() and not fresh:
            self._read()
        self.current = ""
        if environment is not None:
            self.current = hashlib.sha256(json.dumps(environment, sort_keys=True).encode()).hexdigest()[:8]
            self.environments[self.current] = environment

    def _read(self) -> None:
        try:
            data = json.loads(self.path.read_text(encoding="utf-8"))
            records = [Record(**record) for record in data["records"]]
            self.environments, self.scenes = dict(data["environments"]), dict(data["scenes"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(self.path, f"is no benchmark's results ({error})", "name another folder with -o, or start anew") from error
        self.records = {record.key: record for record in records}

    def done(self, key: Key) -> bool:
        """True where that was measured; what failed is tried again."""
        return key in self.records and self.records[key].status == "done"

    def add(self, record: Record) -> None:
        """Put a record in, in the place of an older one of its key, and write the file."""
        self.records[record.key] = record
        self.write()

    def write(self) -> None:
        """Bring results.json up to date, in one step."""
        data = {"environments": self.environments, "scenes": self.scenes, "records": [asdict(r) for r in self.records.values()]}
        self.folder.mkdir(parents=True, exist_ok=True)
        write_atomic(self.path, (json.dumps(data, indent=1, allow_nan=False) + "\n").encode())

    def write_tables(self) -> None:
        """One CSV for each section: a row for each record, a column for each figure and each count."""
        for section in {record.section for record in self.records.values()}:
            rows = [_row(r) for r in self.records.values() if r.section == section]
            columns = list(dict.fromkeys(name for row in rows for name in row))
            text = io.StringIO()
            writer = csv.DictWriter(text, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
            write_atomic(self.folder / f"{section}.csv", text.getvalue().encode())


def _row(record: Record) -> dict[str, Any]:
    about = {"scene": record.scene, "configuration": record.configuration, "status": record.status, "seconds_in_all": record.seconds}
    return about | record.figures | {f"counted_{n}": v for n, v in record.counted.items()} | {"environment": record.environment}


class Results:
    """The records of one section, for its part of the report."""

    def __init__(self, store: Store, section: str) -> None:
        self.section, self.store = section, store
        self._records = [r for r in store.records.values() if r.section == section]

    @property
    def scenes(self) -> list[str]:
        """Names of the scenes that have records that are done."""
        return list(dict.fromkeys(r.scene for r in self._records if r.status == "done"))

    def records(self, scene: str | None = None, prefix: str = "") -> Iterator[Record]:
        """Those that are done, of one scene or of all, whose configuration begins so."""
        found = (r for r in self._records if r.status == "done" and r.configuration.startswith(prefix))
        return (r for r in found if scene in (None, r.scene))

    def get(self, scene: str, configuration: str) -> Record | None:
        """One that is done, or None."""
        return next((r for r in self.records(scene) if r.configuration == configuration), None)

    def figure(self, scene: str, configuration: str, name: str) -> Any:
        """A figure, or None where it was not measured."""
        record = self.get(scene, configuration)
        return None if record is None else record.figures.get(name)

    def failed(self) -> list[Record]:
        """Those that failed."""
        return [r for r in self._records if r.status == "failed"]
