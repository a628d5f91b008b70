# SPDX-License-Identifier: GPL-3.0-or-later
"""Check that bad input is rejected with an InputError."""

import pytest
from irgspp.core.errors import InputError


def refused(*words: str):
    """Expect the block to raise an InputError whose message matches all these regular expressions."""
    return pytest.raises(InputError, match="".join(f"(?=.*{word})" for word in words))
