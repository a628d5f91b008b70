# SPDX-License-Identifier: GPL-3.0-or-later
"""One reader against files that coverage leads to: `python scripts/faulting/guided.py READER [RUNS]`, with the package atheris.

Code of ours is instrumented, libraries of C are not. What brings a reader down is kept as crash-*, in the present folder.
"""

# pyright: reportMissingImports=false, reportMissingModuleSource=false, reportAttributeAccessIssue=false
# (atheris is no requirement of anything else)

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
ROOMS = ("datasets", "io", "scene", "batch", "settings")
with atheris.instrument_imports(include=[f"irgspp.core.{room}" for room in ROOMS]):
    from faulting.fuzz_child import fault_of
    from faulting.readers import READERS


def main(name: str, runs: int) -> None:
    """Fuzz the reader of that name; each of its files in turn is what the data is written to."""
    reader = next(reader for reader in READERS if reader.name == name)
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as place:
        folder, corpus = Path(place, "scene"), Path(place, "corpus")
        folder.mkdir()
        corpus.mkdir()
        reader.make(folder)
        right = [(folder / file).read_bytes() for file in reader.files]
        for number, data in enumerate(right):
            (corpus / str(number)).write_bytes(bytes([number]) + data)

        def once(data: bytes) -> None:
            which = data[0] % len(right) if data else 0
            file = folder / reader.files[which]
            file.write_bytes(data[1:])
            fault = fault_of(reader, folder, file)
            file.write_bytes(right[which])
            if fault is not None:
                raise RuntimeError(fault)

        longest = 2 * max(map(len, right)) + 64
        options = [f"-runs={runs}", f"-max_len={longest}", "-rss_limit_mb=0", "-timeout=60", "-print_final_stats=1", str(corpus)]
        atheris.Setup([sys.argv[0], *options], once)
        atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 100_000)
