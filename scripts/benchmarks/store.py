# SPDX-License-Identifier: GPL-3.0-or-later
"""Store of a benchmark's records: one file, written after each measurement, so that an interrupted benchmark can continue."""

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
EVERYWHERE = "-"  # in place of a scene's name, for measurements that do not depend on a scene


@dataclass(frozen=True)
class Record:
    """Measurement that was made.

    Attributes:
        section: name of the section.
        scene: name of the scene, or EVERYWHERE.
        configuration: name of the task within its section and scene.
        status: "done" or "failed".
        error: reason of a failure, one line.
        figures: see `section.Measurement`.
        counted: see `section.Measurement`.
        images: name to a file's path in the store's folder.
        seconds: wall clock of the whole measurement, with the reconstructions that were made for it.
        environment: key of the machine and versions among the store's environments.
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
    """Records of a benchmark in `results.json` of a folder."""

    def __init__(self, folder: Path, environment: dict[str, Any] | None = None, fresh: bool = False) -> None:
        """Open a store.

        Args:
            folder: folder of results.json; made with the first record where it does not exist.
            environment: machine and versions of this process.
            fresh: True to ignore existing records.

        Raises:
            InputError: where results.json is not a benchmark's.
        """
        self.folder, self.path = folder, folder / "results.json"
        self.records: dict[Key, Record] = {}
        self.environments: dict[str, dict[str, Any]] = {}
        self.scenes: dict[str, dict[str, Any]] = {}  # facts about each scene, for tables
        if self.path.is_file() and not fresh:
            self._read()
        self.current = ""
        if environment is not None:
            self.current = hashlib.sha256(json.dumps(environment, sort_keys=True).encode()).hexdigest()[:8]
            self.environments[self.current] = environment

    def _read(self) -> None:
        """Read results.json."""
        try:
            data = json.loads(self.path.read_text(encoding="utf-8"))
            records = [Record(**record) for record in data["records"]]
            self.environments, self.scenes = dict(data["environments"]), dict(data["scenes"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(
                self.path, f"does not hold results of a benchmark ({error})", "name another folder with -o, or remove the file"
            ) from error
        self.records = {record.key: record for record in records}

    def done(self, key: Key) -> bool:
        """Return True where a key was measured; failed measurements are repeated."""
        return key in self.records and self.records[key].status == "done"

    def add(self, record: Record) -> None:
        """Add a record, in place of an older one of its key, and write the file."""
        self.records[record.key] = record
        self.write()

    def write(self) -> None:
        """Write results.json atomically."""
        data = {"environments": self.environments, "scenes": self.scenes, "records": [asdict(r) for r in self.records.values()]}
        self.folder.mkdir(parents=True, exist_ok=True)
        write_atomic(self.path, (json.dumps(data, indent=1, allow_nan=False) + "\n").encode())

    def write_tables(self) -> None:
        """Write one CSV file for each section: a row for each record, a column for each metric and each count."""
        for section in {record.section for record in self.records.values()}:
            rows = [_row(r) for r in self.records.values() if r.section == section]
            columns = list(dict.fromkeys(name for row in rows for name in row))
            text = io.StringIO()
            writer = csv.DictWriter(text, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
            write_atomic(self.folder / f"{section}.csv", text.getvalue().encode())


def _row(record: Record) -> dict[str, Any]:
    """Return a record as a CSV row."""
    about = {"scene": record.scene, "configuration": record.configuration, "status": record.status, "seconds_in_all": record.seconds}
    return about | record.figures | {f"counted_{n}": v for n, v in record.counted.items()} | {"environment": record.environment}


class Results:
    """Records of one section, for its part of the report."""

    def __init__(self, store: Store, section: str) -> None:
        self.section, self.store = section, store
        self._records = [r for r in store.records.values() if r.section == section]

    @property
    def scenes(self) -> list[str]:
        """Names of the scenes with finished records."""
        return list(dict.fromkeys(r.scene for r in self._records if r.status == "done"))

    def records(self, scene: str | None = None, prefix: str = "") -> Iterator[Record]:
        """Return finished records.

        Args:
            scene: name of a scene; None: of all.
            prefix: beginning of the configuration.
        """
        found = (r for r in self._records if r.status == "done" and r.configuration.startswith(prefix))
        return (r for r in found if scene in (None, r.scene))

    def get(self, scene: str, configuration: str) -> Record | None:
        """Return a finished record, or None.

        Args:
            scene: name of the scene.
            configuration: name of the configuration.
        """
        return next((r for r in self.records(scene) if r.configuration == configuration), None)

    def figure(self, scene: str, configuration: str, name: str) -> Any:
        """Return a metric, or None where it was not measured.

        Args:
            scene: name of the scene.
            configuration: name of the configuration.
            name: name of the metric.
        """
        record = self.get(scene, configuration)
        return None if record is None else record.figures.get(name)

    def failed(self) -> list[Record]:
        """Return the failed records."""
        return [r for r in self._records if r.status == "failed"]
