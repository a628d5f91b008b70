# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the settings that let idle threads of the libraries sleep."""

import os
import subprocess
import sys

import pytest

QUESTION = "import irgspp.core, os; print(os.environ['OMP_WAIT_POLICY'], os.environ['OPENBLAS_THREAD_TIMEOUT'])"
NAMES = ("OMP_WAIT_POLICY", "OPENBLAS_THREAD_TIMEOUT")


@pytest.mark.parametrize("own", [(), ("ACTIVE", "20")])
def test_idle_threads_sleep_unless_the_user_chose_otherwise(own):
    """The engine sets both variables before a library reads them, and keeps what the user set."""
    bare = {name: value for name, value in os.environ.items() if name not in NAMES}
    environment = bare | dict(zip(NAMES, own, strict=False))
    result = subprocess.run([sys.executable, "-c", QUESTION], env=environment, capture_output=True, text=True, check=True)
    assert result.stdout.split() == list(own or ("PASSIVE", "4"))
