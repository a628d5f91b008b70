# SPDX-License-Identifier: GPL-3.0-or-later
"""Coverage-guided fuzzer of one reader, with the package atheris: `python scripts/faulting/guided.py READER [RUNS]`.

The engine's code is instrumented, C libraries are not. Files that crash a reader are kept as crash-* in the current folder.
"""

# pyright: reportMissingImports=false, reportMissingModuleSource=false, reportAttributeAccessIssue=false
# (atheris is not among the requirements)

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
ROOMS = ("capture", "datasets", "io", "scene", "batch", "settings")
with atheris.instrument_imports(include=[f"irgspp.core.{room}" for room in ROOMS]):
    from faulting.fuzz_child import fault_of
    from faulting.readers import READERS


def main(name: str, runs: int) -> None:
    """Fuzz a reader; each of its files in turn is broken.

    Args:
        name: name of the reader.
        runs: number of files.
    """
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
            """Read one broken file."""
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
