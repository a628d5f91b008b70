# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors that are reported to the user in one line, each with the exit status of the command."""


class IrgsppError(Exception):
    """Failure that is reported to the user in one line (exit status 1)."""

    exit_status = 1


class InputError(IrgsppError):
    """Bad input or usage (exit status 2), reported as "where: what; fix".

    Args:
        where: file, folder, option or setting that is wrong; at most 1000 characters are kept.
        what: what is wrong with it; at most 800 characters are kept.
        fix: what the user can do about it; empty where that is plain.
    """

    exit_status = 2

    def __init__(self, where: object, what: str, fix: str = "") -> None:
        self.where, self.what, self.fix = _short(str(where), 1000), _short(what, 800), _short(fix, 2000)
        super().__init__(" ".join(f"{self.where}: {self.what}{'; ' + self.fix if fix else ''}".split()))


def _short(text: str, most: int) -> str:
    """Cut the middle out of a text longer than `most` characters: a value read from a damaged file may be very long."""
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 3 :]}"


class Cancelled(IrgsppError):
    """Stop that the user asked for; everything finished so far has been saved (exit status 130)."""

    exit_status = 130
