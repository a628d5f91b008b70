# SPDX-License-Identifier: GPL-3.0-or-later
"""What bad input has to come to."""

import pytest
from irgspp.core.errors import InputError


def refused(*words: str):
    """The block raises an InputError with all of these expressions in its line."""
    return pytest.raises(InputError, match="".join(f"(?=.*{word})" for word in words))
