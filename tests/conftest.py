# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine before torch: it settles how torch's threads wait."""

import irgspp.core  # noqa: F401
