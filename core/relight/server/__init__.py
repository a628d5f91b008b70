# SPDX-License-Identifier: GPL-3.0-or-later
"""Request server of `irgspp serve`: a loaded run that renders images on request through the files of a session folder."""
